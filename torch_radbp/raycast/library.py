"""Embree 4 as a C library: where the `embreex` wheel keeps it, its prototypes, its errors."""

import ctypes
import functools
import importlib.util
from ctypes import c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p
from pathlib import Path

# Values of rtcore_device.h, rtcore_geometry.h, rtcore_buffer.h, rtcore_common.h and rtcore_scene.h.
PROPERTY_VERSION, PROPERTY_NATIVE_RAY8_SUPPORTED, PROPERTY_TRIANGLES_SUPPORTED = 0, 33, 96
GEOMETRY_TYPE_TRIANGLE, GEOMETRY_TYPE_INSTANCE_ARRAY = 0, 122
BUFFER_TYPE_INDEX, BUFFER_TYPE_VERTEX, BUFFER_TYPE_TRANSFORM = 0, 1, 23
FORMAT_UINT3, FORMAT_FLOAT3, FORMAT_FLOAT3X4_ROW_MAJOR = 0x5003, 0x9003, 0x9134
SCENE_FLAG_ROBUST = 1 << 2
# A robust scene's watertight triangle test in a hierarchy with plain boxes instead of widened ones: a quarter faster on
# closest hits, and as tight as the robust scene in 60 million rays at edges and along axes. Needs AVX.
FAST_AND_WATERTIGHT = b"tri_accel=bvh8.triangle4v"
ERRORS = ("none", "unknown", "invalid argument", "invalid operation", "out of memory", "unsupported CPU", "cancelled")

PROTOTYPES = {
    "rtcNewDevice": (c_void_p, [c_char_p]),
    "rtcReleaseDevice": (None, [c_void_p]),
    "rtcGetDeviceProperty": (c_ssize_t, [c_void_p, c_int]),
    "rtcGetDeviceError": (c_int, [c_void_p]),
    "rtcGetDeviceLastErrorMessage": (c_char_p, [c_void_p]),
    "rtcNewScene": (c_void_p, [c_void_p]),
    "rtcReleaseScene": (None, [c_void_p]),
    "rtcSetSceneFlags": (None, [c_void_p, c_int]),
    "rtcCommitScene": (None, [c_void_p]),
    "rtcNewGeometry": (c_void_p, [c_void_p, c_int]),
    "rtcReleaseGeometry": (None, [c_void_p]),
    "rtcSetSharedGeometryBuffer": (
        None,  # geometry, type, slot, format, pointer, byte offset, byte stride, item count
        [c_void_p, c_int, c_uint, c_int, c_void_p, c_size_t, c_size_t, c_size_t],
    ),
    "rtcSetGeometryInstancedScene": (None, [c_void_p, c_void_p]),
    "rtcCommitGeometry": (None, [c_void_p]),
    "rtcAttachGeometry": (c_uint, [c_void_p, c_void_p]),
    "rtcIntersect8": (None, [c_void_p] * 4),
    "rtcOccluded8": (None, [c_void_p] * 4),
}


def library_path() -> Path:
    """The shared library inside the installed `embreex` wheel.

    Raises:
        RuntimeError: embreex is not installed, or is not one that carries Embree 4.
    """
    spec = importlib.util.find_spec("embreex")
    if spec is None:
        raise RuntimeError("the embree ray caster needs the embreex package: pip install 'embreex>=4.4'")
    package = Path(spec.submodule_search_locations[0])
    places = (
        (package.parent / "embreex.libs", "libembree4*.so*"),  # Linux
        (package / ".dylibs", "libembree4*.dylib"),  # macOS
        (package.parent / "embreex.libs", "embree4*.dll"),  # Windows
    )
    for folder, pattern in places:
        for path in sorted(folder.glob(pattern)):
            return path
    raise RuntimeError(
        f"found no Embree 4 library in {', '.join(str(folder / pattern) for folder, pattern in places)}; "
        "install a wheel of version 4: pip install 'embreex>=4.4'"
    )


@functools.cache
def load_embree() -> ctypes.CDLL:
    """Loads Embree with typed entry points. Its own dependencies (TBB) lie beside it, where the loader looks first."""
    library = ctypes.CDLL(str(library_path()))
    for name, (result, arguments) in PROTOTYPES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def address(function) -> int:
    """The address of a C function, for callers that are compiled code."""
    return ctypes.cast(function, c_void_p).value


def check_for_error(device: int | None, doing: str) -> None:
    """Raises RuntimeError if calls of this thread on this device left an error, and clears it.

    Args:
        device: None for an error of making the device.
        doing: what to say in the message: "Embree failed while ..."
    """
    error = load_embree().rtcGetDeviceError(device)
    if error:
        name = ERRORS[error] if error < len(ERRORS) else f"error {error}"
        detail = (load_embree().rtcGetDeviceLastErrorMessage(device) or b"no details").decode()
        raise RuntimeError(f"Embree failed while {doing}: {name} ({detail})")


def new_device() -> int:
    """A new Embree device, to be released by rtcReleaseDevice.

    Raises:
        RuntimeError: Embree cannot start, is not version 4, or was built without triangles.
    """
    embree = load_embree()
    device = _device(b"")
    version = embree.rtcGetDeviceProperty(device, PROPERTY_VERSION)  # 40401 is 4.4.1
    triangles = embree.rtcGetDeviceProperty(device, PROPERTY_TRIANGLES_SUPPORTED)
    eight_wide = embree.rtcGetDeviceProperty(device, PROPERTY_NATIVE_RAY8_SUPPORTED)
    if version // 10000 == 4 and triangles and not eight_wide:
        return device
    embree.rtcReleaseDevice(device)
    if version // 10000 != 4 or not triangles:
        raise RuntimeError(f"expected Embree 4 with triangles, got version number {version} from {library_path()}")
    return _device(FAST_AND_WATERTIGHT)


def _device(configuration: bytes) -> int:
    device = load_embree().rtcNewDevice(configuration)
    if not device:
        check_for_error(None, "creating a device")
        raise RuntimeError("Embree created no device and gave no reason")
    return device
