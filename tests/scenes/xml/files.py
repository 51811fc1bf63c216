"""What the scenes of the comparison are made of: files in a folder, pieces of XML, meshes and pictures from formulas."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR
import trimesh
from PIL import Image

from tests.formats.serialized_files import mesh, serialized
from torch_radbp.formats.volume import write_volume


class Folder:
    """Where a scene's files go. Remembers a digest of their contents before encoding, which varies with codecs."""

    def __init__(self, path: Path):
        self.path = Path(path)
        self.contents = hashlib.sha256()

    def text(self, name: str, text: str) -> Path:
        self.contents.update(f"{name}\0{text}\0".encode())
        (self.path / name).write_text(text)
        return self.path / name

    def serialized(self, name: str, *meshes: dict[str, Any]) -> Path:
        """Serialized meshes, of which each is the arguments of `serialized_files.mesh`: lists of rounded numbers."""
        self.contents.update(f"{name}\0{meshes!r}\0".encode())
        (self.path / name).write_bytes(serialized(*(mesh(**arguments) for arguments in meshes)))
        return self.path / name

    def volume(self, name: str, values: np.ndarray) -> Path:
        """A volume of (Z, Y, X) or (Z, Y, X, C) values, rounded to 1 / 4096."""
        values = np.round(values * 4096)
        self.contents.update(f"{name}\0{values.shape}\0".encode() + values.astype(np.int32).tobytes())
        write_volume(self.path / name, (values if values.ndim == 4 else values[..., None]) / 4096)
        return self.path / name

    def pixels(self, name: str, values: np.ndarray, **options) -> Path:
        """An image from (H, W, 3) values: EXR linear (half for compression PIZ), PNG and JPEG as given, 8 bits."""
        values = np.ascontiguousarray(values, dtype=np.float32)
        self.contents.update(f"{name}\0".encode() + np.round(values * 4096).astype(np.int32).tobytes())
        if name.endswith(".exr"):
            piz = options.get("compression") == "piz"
            header = {"compression": OpenEXR.PIZ_COMPRESSION if piz else OpenEXR.ZIP_COMPRESSION,
                      "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, {"RGB": values.astype(np.float16) if piz else values}).write(str(self.path / name))
        else:
            Image.fromarray((values.clip(0, 1) * 255 + 0.5).astype(np.uint8)).save(self.path / name, **options)
        return self.path / name


class Case(NamedTuple):
    """A scene and how to render it; variables go to both loaders."""

    build: Callable[[Folder], Path]
    variables: dict = {}
    spp: int = 64
    """Samples per pixel of one of our batches."""
    peer_spp: int = 64
    peer_batches: int = 64
    thin: int = 1
    """Pixels between independent ones: more than 1 where Mitsuba's filter is wider than a pixel."""
    peer_integrator: str = "path"


def scene_xml(film: str, sensor: str, body: str, integrator: str = '<integer name="max_depth" value="4"/>',
              rfilter: str = '<rfilter type="box"/>', camera: str = "perspective") -> str:
    """A scene file with one sensor, of type `camera`; every part is XML."""
    return f"""<scene version="3.0.0">
  <integrator type="path">{integrator}</integrator>
  <sensor type="{camera}" id="sensor">
    {sensor}
    <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
    <film type="hdrfilm">{film}<string name="pixel_format" value="rgb"/>{rfilter}</film>
  </sensor>
  {body}
</scene>
"""


def size(width: int, height: int) -> str:
    return f'<integer name="width" value="{width}"/><integer name="height" value="{height}"/>'


def look(origin: str, target: str, fov: float = 45) -> str:
    return (f'<float name="fov" value="{fov}"/><transform name="to_world">'
            f'<lookat origin="{origin}" target="{target}" up="0, 1, 0"/></transform>')


def picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    """(height, width, 3) colours in [0.05, 0.95] without any symmetry: a flip, a transpose or a shift shows."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    tone = np.random.default_rng(seed).uniform(0.05, 0.95, (height, width, 3))
    ramp = np.stack([x / width, y / height, (x + 2 * y) / (width + 2 * height)], axis=-1)
    return 0.05 + 0.9 * (0.5 * ramp + 0.5 * tone)


def diffuse(colour: str) -> str:
    return f'<bsdf type="diffuse"><rgb name="reflectance" value="{colour}"/></bsdf>'


def textured(filename: str) -> str:
    return f'<bsdf type="diffuse">{bitmap("reflectance", filename)}</bsdf>'


def bitmap(name: str, filename: str, more: str = "") -> str:
    return f'<texture type="bitmap" name="{name}"><string name="filename" value="{filename}"/>{more}</texture>'


def placed(*steps: str) -> str:
    """A to_world transform from steps such as 'rotate x="1" angle="90"', the first applied first."""
    return f'<transform name="to_world">{"".join(f"<{step}/>" for step in steps)}</transform>'


def lamp(radiance: str) -> str:
    return f'<emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter>'


def shape(kind: str, name: str, *parts: str) -> str:
    inside = "".join(f"\n    {part}" for part in parts)
    return f'\n  <shape type="{kind}" id="{name}">{inside}\n  </shape>'


def bumpy_ball(folder: Folder, name: str, normals: bool) -> None:
    """A ball with bumps as OBJ with texture coordinates, with or without vertex normals."""
    columns, rows = 24, 13
    theta = np.linspace(0.02, np.pi - 0.02, rows)[:, None]
    phi = np.linspace(0, 2 * np.pi, columns + 1)[None, :]
    radius = 1 + 0.12 * np.sin(4 * phi) * np.sin(theta) ** 2
    points = np.stack([radius * np.sin(theta) * np.cos(phi), radius * np.cos(theta) + 0 * phi,
                       -radius * np.sin(theta) * np.sin(phi)], -1).reshape(-1, 3)
    uv = np.stack(np.broadcast_arrays(phi / (2 * np.pi), 1 - theta / np.pi), -1).reshape(-1, 2)
    smooth = points / np.linalg.norm(points, axis=1, keepdims=True)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points] + [f"vt {u:.6f} {v:.6f}" for u, v in uv]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in smooth] if normals else []
    for row in range(rows - 1):
        for column in range(columns):
            a = row * (columns + 1) + column + 1
            for corners in ((a, a + columns + 1, a + columns + 2), (a, a + columns + 2, a + 1)):
                lines.append("f " + " ".join(f"{i}/{i}/{i}" if normals else f"{i}/{i}" for i in corners))
    folder.text(name, "\n".join(lines) + "\n")


def octahedron(folder: Folder, name: str) -> None:
    """A flat-shaded PLY without normals: every face has vertices of its own."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1.4, 0], [0, -1.4, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
    faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    mesh = trimesh.Trimesh(corners[np.array(faces).ravel()], np.arange(24).reshape(-1, 3), process=False)
    folder.text(name, mesh.export(file_type="ply", encoding="ascii", vertex_normal=False).decode())
