"""A tiny scene for every plugin, in which each of its parameters matters.

What is called `subject` is examined, with everything in it; the rest lights it and is seen beside it. All is turned by odd
angles: a basis around a normal has a kink where its z is exactly zero.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

import torch_radbp as rb
from tests.io.serialized_files import mesh, serialized
from tests.scenes import diffuse, load, look_at, rectangle, rgb, sensor, texels
from torch_radbp.io.transform import rotate, scale, translate

SUBJECT = "subject"

# A quadrilateral that is not flat, with normals that are not its own.
CORNERS = [[-2.1, -1.9, 0.13], [2.2, -2.0, -0.31], [1.9, 2.3, 0.27], [-2.0, 2.1, -0.22]]
NORMALS = [[-0.31, -0.22, 0.9], [0.33, -0.17, 0.95], [0.21, 0.34, 0.9], [-0.27, 0.19, 1.0]]
TEXCOORDS = [[0.11, 0.23], [1.31, 0.07], [1.17, 1.42], [-0.21, 1.13]]
FACES = [[0, 1, 2], [0, 2, 3]]


def bitmap(height: int = 2, width: int = 3, factor: float = 1.0, seed: int = 1, **attributes: Any) -> dict[str, Any]:
    """An image that is read beyond its border."""
    to_uv = translate((-0.31, 0.17, 0)) @ rotate((0, 0, 1), 20) @ scale((1.7, 1.4, 1))
    return {"type": "bitmap", "data": factor * texels(height, width, seed), "raw": True, "to_uv": to_uv} | attributes


def fine(height: int = 12, width: int = 13, **attributes: Any) -> dict[str, Any]:
    """An image with texels smaller than pixels, read at the level of detail that fits."""
    return bitmap(height, width, filter_type="trilinear", **attributes)


def bumps() -> dict[str, Any]:
    """A normal map of gentle slopes."""
    flat = torch.tensor([0.5, 0.5, 1.0], dtype=torch.float64)
    return bitmap(data=flat + 0.15 * (texels(2, 3, 6) - 0.5))


def heights() -> dict[str, Any]:
    """Bumps of gentle slopes."""
    return bitmap(3, 3, 0.25, 6)


def squares(color0: Any, color1: Any) -> dict[str, Any]:
    """A checkerboard with some squares in view."""
    return {"type": "checkerboard", "color0": color0, "color1": color1,
            "to_uv": translate((0.11, -0.07, 0)) @ rotate((0, 0, 1), 25) @ scale((1.4, 1.7, 1))}


def printed(**attributes: Any) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": bitmap(**attributes)}


def camera(size: int = 2, fov: float = 34, **attributes: Any) -> dict[str, Any]:
    return sensor(size, (0.3, 0.4, 3.5), (0.05, 0.02, 0), fov, **attributes)


def parallel(scaled: float = 0.8, size: int = 2) -> dict[str, Any]:
    """A camera without perspective."""
    pose = look_at((0.3, 0.4, 3.5), (0.05, 0.02, 0), (0, 1, 0)) @ scale((scaled, 1.2 * scaled, 1))
    return {"type": "orthographic", "to_world": pose, "film": camera(size, rfilter="gaussian")["film"]}


def blurred(size: int = 2, fov: float = 34) -> dict[str, Any]:
    """A camera with a lens, in focus before what it sees."""
    return camera(size, fov, type="thinlens", aperture_radius=0.13, focus_distance=2.6, rfilter="gaussian")


def calibrated(size: int = 2, factor: float = 1.0, **attributes: Any) -> dict[str, Any]:
    """A camera with intrinsics and every coefficient of distortion; `factor` scales what it sees."""
    given = {"k1": -0.13, "k2": 0.07, "k3": -0.05, "k4": 0.04, "k5": 0.06, "k6": -0.03, "p1": 0.02, "p2": -0.03} | attributes
    pinhole = camera(size, rfilter="gaussian")
    return {"type": "calibrated", "to_world": pinhole["to_world"], "film": pinhole["film"], "fx": factor * 1.6 * size,
            "fy": factor * 1.7 * size, "cx": 0.47 * size - 0.5, "cy": 0.52 * size - 0.5, "skew": 0.02 * size} | given


FISHEYE = {"distortion": "fisheye", "k1": 0.06, "k2": -0.04, "k3": 0.05, "k4": -0.02, "k5": None, "k6": None, "p1": None,
           "p2": None}


def lamp(**attributes: Any) -> dict[str, Any]:
    """A lamp above that faces down."""
    return rectangle((0.5, 2.6, 1.7), 0.8, (1, 0.13, 0.21), 119, **{
        "bsdf": diffuse(0.3, 0.2, 0.4), "emitter": {"type": "area", "radiance": rgb(9, 7, 8)}} | attributes)


def floor(**attributes: Any) -> dict[str, Any]:
    """A floor without end in view."""
    return rectangle((0.1, -1.3, 0.2), 9.0, (1, 0.27, 0.19), -67, **{"bsdf": diffuse(0.5, 0.6, 0.7)} | attributes)


def plane(at=(0, 0, 0), **attributes: Any) -> dict[str, Any]:
    """A plane that fills the view."""
    return rectangle(at, 3.1, (0.35, 1, 0.23), 24, **attributes)


def sky(factor: float = 1.5) -> dict[str, Any]:
    return {"type": "envmap", "bitmap": factor * texels(4, 5, 3),
            "to_world": rotate((0.4, 1, 0.3), 50) @ rotate((1, 0.2, 0.1), 20)}


def glowing() -> dict[str, Any]:
    """A textured emitter, seen through glass or in a mirror."""
    return rectangle((0.2, -0.1, -2.3), 6.0, (0.3, 1, 0.41), 17, bsdf=diffuse(0.4, 0.5, 0.3),
                     emitter={"type": "area", "radiance": bitmap(factor=3.0, seed=4)})


def shape(**attributes: Any) -> dict[str, Any]:
    """A shape under a lamp, above a floor."""
    return {"sensor": camera(), "lamp": lamp(), "floor": floor(), SUBJECT: attributes}


def quadrilateral(smooth: bool = True, **attributes: Any) -> dict[str, Any]:
    mesh = {"type": "mesh", "vertex_positions": CORNERS, "vertex_texcoords": TEXCOORDS, "faces": FACES}
    return mesh | ({"vertex_normals": NORMALS} if smooth else {}) | attributes


def distances(**attributes: Any) -> dict[str, Any]:
    """A dented ball given by distances on a coarse grid."""
    places = torch.meshgrid(*(torch.linspace(-1, 1, count, dtype=torch.float64) for count in (4, 5, 6)), indexing="ij")
    noise = torch.as_tensor(texels(4, 10, 8)).reshape(4, 5, 6)
    grid = torch.stack(places).norm(dim=0) - 0.8 + 0.3 * (noise - 0.5)
    pose = turned((0.1, -0.05, 0.1), 11, 23, 37, size=2.4)["to_world"] @ translate((-0.5, -0.5, -0.5))
    return {"type": "sdfgrid", "grid": grid[..., None], "to_world": pose, "bsdf": diffuse(0.7, 0.5, 0.3)} | attributes


@functools.cache
def folder() -> tempfile.TemporaryDirectory:
    """Where files of meshes are, until the process ends."""
    return tempfile.TemporaryDirectory()


def coloured_file(faces: bool = True) -> str:
    """The quadrilateral in a PLY file with an attribute of vertices, and perhaps one of faces."""
    path = Path(folder().name) / f"coloured_{faces}.ply"
    columns = "".join(f"property float {name}\n" for name in ("x", "y", "z", "r", "g", "b"))
    header = (f"ply\nformat ascii 1.0\nelement vertex {len(CORNERS)}\n{columns}element face {len(FACES)}\n"
              f"property list uchar int vertex_indices\n{faces * 'property float shine_x'}\nend_header\n")
    colours = 0.2 + 0.6 * texels(1, len(CORNERS), 7)[0]
    rows = [*(p + colour for p, colour in zip(CORNERS, colours.tolist())),
            *([3, *face, 0.3 * face[1]][:4 + faces] for face in FACES)]
    path.write_text(header + "".join(" ".join(map(str, row)) + "\n" for row in rows))
    return str(path)


def mesh_file(suffix: str) -> str:
    """The quadrilateral in a file."""
    path = Path(folder().name) / f"quadrilateral.{suffix}"
    if suffix == "serialized":
        path.write_bytes(serialized(mesh(CORNERS, FACES, double=True, normals=NORMALS, uv=TEXCOORDS)))
        return str(path)

    def lines(prefix: str, rows) -> list[str]:
        return [" ".join([prefix, *map(str, row)]).strip() for row in rows]

    if suffix == "obj":
        text = [*lines("v", CORNERS), *lines("vt", TEXCOORDS), *lines("vn", NORMALS),
                *lines("f", [[f"{k + 1}/{k + 1}/{k + 1}" for k in face] for face in FACES])]
    else:
        columns = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
        header = (f"ply\nformat ascii 1.0\nelement vertex {len(CORNERS)}\n{columns}element face {len(FACES)}\n"
                  "property list uchar int vertex_indices\nend_header")
        text = [header, *lines("", [p + n + uv for p, n, uv in zip(CORNERS, NORMALS, TEXCOORDS)]),
                *lines("", [[3, *face] for face in FACES])]
    path.write_text("\n".join(text) + "\n")
    return str(path)


def metal(**attributes: Any) -> dict[str, Any]:
    """Something that only reflects, under a sky."""
    return {"sensor": camera(), "sky": sky(), "floor": floor(), SUBJECT: attributes,
            "subject_plane": plane(bsdf={"type": "ref", "id": SUBJECT})}


def glass(**attributes: Any) -> dict[str, Any]:
    """A boundary between the camera and a textured emitter, under a sky."""
    return {"sensor": camera(4), "sky": sky(), "glowing": glowing(), SUBJECT: attributes,
            "subject_plane": plane(bsdf={"type": "ref", "id": SUBJECT})}


def light(**attributes: Any) -> dict[str, Any]:
    """A light above a plane and a floor."""
    return {"sensor": camera(), "floor": floor(), "plane": plane(bsdf=diffuse(0.8, 0.6, 0.4)),
            "dark": diffuse(0.1, 0.2, 0.1), SUBJECT: attributes}


def beam(**attributes: Any) -> dict[str, Any]:
    """A panel that throws parallel light on the middle of the view."""
    return {"type": "rectangle", "to_world": AIMED @ scale((0.7, 0.7, 1)),
            "emitter": {"type": "directionalarea", "radiance": bitmap(factor=3.0)}} | attributes


def turned(at, *angles: float, size: float = 1.0, **attributes: Any) -> dict[str, Any]:
    """A shape turned by odd angles about x, y and z."""
    x, y, z = angles
    pose = translate(at) @ rotate((0, 0, 1), z) @ rotate((0, 1, 0), y) @ rotate((1, 0, 0), x) @ scale((size, size, size))
    return {"to_world": pose} | attributes


def lamps() -> dict[str, Any]:
    """More lamps of all kinds than are picked without regard to where they are, in front of the planes of `light`."""
    found = {}
    for number in range(9):
        x, y, z = 1.1 * (number % 3 - 1.1), 1.3 + 0.4 * (number // 3), 2.3 - 0.1 * number
        name, pose = f"lamp_{number}", look_at((x, y, z), (0.1 * x, 0.05, 0), (0.1, 1, 0.2))
        found[name] = ({"type": "rectangle", "to_world": pose @ scale((0.2, 0.3, 1)), "bsdf": {"type": "ref", "id": "dark"},
                        "emitter": {"type": "area", "radiance": bitmap(factor=20.0, seed=number)}},
                       {"type": "point", "position": [x, y, z], "intensity": rgb(0.9, 0.8, 0.7), "sampling_weight": 2.0},
                       {"type": "spot", "to_world": pose, "intensity": rgb(1, 2, 1), "cutoff_angle": 50.0})[number % 3]
    return found


AIMED = look_at((0.9, 1.5, 2.8), (0.1, 0.05, 0), (0.1, 1, 0.2))
METAL = {"eta": rgb(0.2, 0.9, 1.1), "k": rgb(3.9, 2.4, 2.2), "specular_reflectance": rgb(0.9, 0.6, 0.8)}
ROUGH_METAL = {"eta": 0.9, "k": 2.4, "specular_reflectance": 0.8}
TINTED = {"int_ior": 1.5, "specular_reflectance": rgb(0.9, 0.5, 0.7), "specular_transmittance": rgb(0.4, 0.9, 0.6)}
ROUGH_GLASS = {"int_ior": 1.5, "specular_reflectance": 0.7, "specular_transmittance": 0.8}
PLASTIC = {"int_ior": 1.6, "diffuse_reflectance": rgb(0.3, 0.5, 0.7), "specular_reflectance": rgb(0.9, 0.5, 0.7)}
PRINCIPLED = {"type": "principled", "base_color": rgb(0.3, 0.6, 0.4), "roughness": 0.5, "anisotropic": 0.4, "metallic": 0.3,
              "spec_tint": 0.3, "sheen": 0.5, "sheen_tint": 0.4, "clearcoat": 0.6, "clearcoat_gloss": 0.2, "flatness": 0.3}
BRUSHED = {"alpha_u": 0.25, "alpha_v": 0.5}
GROUP = {"type": "ref", "id": SUBJECT}
ATTRIBUTE = {"type": "mesh_attribute", "name": "vertex_color", "scale": 0.9}
TRILINEAR = {"height": 12, "width": 13, "filter_type": "trilinear"}
REGULAR = {"type": "regular", "wavelength_min": 390.0, "wavelength_max": 720.0, "values": [0.2, 0.5, 0.4, 0.7]}
IRREGULAR = {"type": "irregular", "wavelengths": [380.0, 470, 520, 710], "values": [0.6, 0.3, 0.5, 0.4]}

SCENES: dict[str, dict[str, Any] | Callable[[], dict[str, Any]]] = {
    "rectangle": shape(**plane(bsdf=printed())),
    "disk": shape(type="disk", **turned((0.1, -0.2, 0), 21, 17, 31, bsdf=printed(wrap_mode="mirror"))),
    "sphere": {"sensor": camera(fov=16), "sky": sky(),
               SUBJECT: {"type": "sphere", **turned((0.1, -0.05, 0.1), 11, 23, 37), "bsdf": printed()}},
    "cylinder": {"sensor": camera(fov=16), "sky": sky(), SUBJECT: {
        "type": "cylinder", "p0": [0.1, -0.9, -0.2], "p1": [-0.2, 1.0, 0.1], "radius": 0.7,
        **turned((0.1, -0.05, 0.1), 11, 23, 7), "bsdf": printed()}},
    "cube": shape(type="cube", **turned((0.1, -0.1, -1.1), 24, 33, 13), bsdf=printed()) | {"sensor": camera(fov=20)},
    "mesh": shape(**quadrilateral(bsdf=printed(wrap_mode="clamp"))),
    "flat mesh": shape(type="mesh", vertex_positions=CORNERS, faces=FACES, bsdf=diffuse(0.7, 0.5, 0.3)),
    "smooth mesh": shape(**quadrilateral(smooth=False, recompute_normals=True, bsdf=printed())),
    "obj": lambda: shape(type="obj", filename=mesh_file("obj"), bsdf=printed()),
    "ply": lambda: shape(type="ply", filename=mesh_file("ply"), bsdf=printed()),
    "serialized": lambda: shape(type="serialized", filename=mesh_file("serialized"), bsdf=printed()),
    "distances": {"sensor": camera(fov=16), "sky": sky(), SUBJECT: distances()},
    "distances with kinks": {"sensor": camera(fov=16), "sky": sky(), SUBJECT: distances(normals="analytic", bsdf={
        "type": "roughconductor", "alpha": 0.4, **ROUGH_METAL})},
    "instances": shape(type="shapegroup", sheet=quadrilateral(bsdf=printed()), ball=turned(
        (0.4, 0.3, 0.5), 20, -30, 10, size=0.3, type="sphere", bsdf=printed(seed=9))) | {
            f"{SUBJECT}_instance": turned((0.7, -0.5, 1.2), 14, -23, 31, size=0.3, type="instance", group=GROUP),
            f"{SUBJECT}_mirrored": {"type": "instance", "group": GROUP,
                                    "to_world": rotate((1, 2, 0.4), 15) @ scale((-1, 1, 0.8))}},
    "attributes": lambda: shape(type="ply", filename=coloured_file(), bsdf={
        "type": "roughplastic", "distribution": "ggx", "alpha": 0.3, "diffuse_reflectance": ATTRIBUTE,
        "specular_reflectance": {"type": "mesh_attribute", "name": "face_shine"}}),
    "area of attributes": lambda: light(
        type="ply", filename=coloured_file(faces=False), face_normals=True, to_world=AIMED @ scale((0.3, 0.3, 0.3)),
        bsdf={"type": "ref", "id": "dark"}, emitter={"type": "area", "radiance": ATTRIBUTE | {"scale": 9.0}}),
    "diffuse": metal(type="diffuse", reflectance=bitmap(filter_type="nearest")),
    "trilinear": metal(type="roughplastic", distribution="ggx", alpha=0.3, diffuse_reflectance=fine(),
                       specular_reflectance=fine(7, 5, seed=4)),
    "trilinear on a mesh": shape(**quadrilateral(bsdf=printed(**TRILINEAR, wrap_mode="mirror"))),
    "trilinear in squares": metal(type="diffuse", reflectance=squares(fine(), rgb(0.7, 0.2, 0.4))),
    "trilinear bumps": metal(type="bumpmap", heights=fine(factor=0.2, seed=6), scale=0.8, nested={
        "type": "roughplastic", "alpha": 0.4, **PLASTIC}),
    "mirror of trilinear normals": glass(type="normalmap", nested={"type": "conductor", **METAL}, normalmap=bumps() | {
        "filter_type": "trilinear", "wrap_mode": "clamp"}),
    "glass with trilinear tint": glass(type="dielectric", int_ior=1.5, specular_transmittance=fine()),
    "checkerboard": metal(type="diffuse", reflectance=squares(bitmap(), rgb(0.7, 0.2, 0.4))),
    "checkerboard of checkerboards": metal(type="roughplastic", distribution="ggx", alpha=0.3, specular_reflectance=squares(
        0.8, 0.3), diffuse_reflectance=squares(bitmap(seed=5), squares(0.6, rgb(0.2, 0.5, 0.1)) | {
            "to_uv": scale((5, 7, 1))})) | {"sensor": camera(4)},
    "rough checkerboard": metal(type="roughconductor", distribution="ggx", alpha=squares(0.5, bitmap()), **ROUGH_METAL),
    "conductor": metal(type="conductor", **METAL),
    "spectra": metal(type="roughplastic", distribution="ggx", alpha=0.3, diffuse_reflectance=REGULAR,
                     specular_reflectance=IRREGULAR),
    "metal by spectra": metal(type="conductor", eta=REGULAR, k=IRREGULAR),
    "named constants": metal(type="conductor", eta={"type": "d65", "color": [0.2, 0.9, 1.1], "scale": 1.1},
                             k={"type": "srgb", "color": [3.9, 2.4, 2.2], "unbounded": True},
                             specular_reflectance={"type": "uniform", "value": 0.7}),
    "raw constant": metal(type="diffuse", reflectance={"type": "rawconstant", "value": [0.7, 0.4, 0.6]}),
    "rough metal beckmann": metal(type="roughconductor", distribution="beckmann", alpha=0.3, **ROUGH_METAL),
    "rough metal ggx": metal(type="roughconductor", distribution="ggx", alpha=0.3, **ROUGH_METAL),
    "brushed metal beckmann": metal(type="roughconductor", distribution="beckmann", **BRUSHED, **ROUGH_METAL),
    "brushed metal ggx": metal(type="roughconductor", distribution="ggx", **BRUSHED, **ROUGH_METAL),
    "plastic": metal(type="plastic", **PLASTIC),
    "nonlinear plastic": metal(type="plastic", nonlinear=True, **PLASTIC),
    "rough plastic beckmann": metal(type="roughplastic", distribution="beckmann", alpha=0.3, **PLASTIC),
    "rough plastic ggx": metal(type="roughplastic", distribution="ggx", alpha=0.3, nonlinear=True, **PLASTIC),
    "principled": metal(**PRINCIPLED, specular=0.6),
    "principled glass": glass(**PRINCIPLED, eta=1.5, spec_trans=0.6),
    "principled sheet": glass(
        type="principledthin", base_color=rgb(0.2, 0.8, 0.3), roughness=0.5, anisotropic=0.4, spec_trans=0.4, eta=1.4,
        spec_tint=0.3, sheen=1.0, sheen_tint=0.4, flatness=0.3, diff_trans=0.6),
    "blend": glass(type="blendbsdf", weight=bitmap(), bsdf_0={"type": "roughconductor", "alpha": 0.3, **ROUGH_METAL},
                   bsdf_1={"type": "plastic", **PLASTIC}),
    "blend of deltas": glass(type="blendbsdf", weight=0.4, bsdf_0={"type": "dielectric", **TINTED},
                             bsdf_1={"type": "conductor", **METAL}),
    "mask": glass(type="mask", opacity=bitmap(), leaf={"type": "twosided", "both": diffuse(0.8, 0.3, 0.1)}),
    "normal map": metal(type="normalmap", normalmap=bumps(), nested={"type": "roughplastic", "alpha": 0.4, **PLASTIC}),
    "mirror with a normal map": glass(type="normalmap", normalmap=bumps(), nested={"type": "conductor", **METAL}),
    "bump map": metal(type="bumpmap", heights=heights(), scale=0.7, nested={
        "type": "roughplastic", "alpha": 0.4, **PLASTIC}),
    "mirror with a bump map": glass(type="bumpmap", heights=heights(), nested={"type": "conductor", **METAL}),
    "bump map on a mesh": shape(**quadrilateral(bsdf={
        "type": "bumpmap", "heights": heights(), "scale": 0.6, "nested": {"type": "roughconductor", "alpha": 0.4,
                                                                          **ROUGH_METAL}})),
    "bump map of attributes": lambda: shape(type="ply", filename=coloured_file(faces=False), bsdf={
        "type": "bumpmap", "heights": ATTRIBUTE, "nested": diffuse(0.8, 0.5, 0.6)}),
    "dielectric": glass(type="dielectric", **TINTED),
    "pane": glass(type="thindielectric", **TINTED),
    "rough glass beckmann": glass(type="roughdielectric", distribution="beckmann", alpha=0.3, **ROUGH_GLASS),
    "rough glass ggx": glass(type="roughdielectric", distribution="ggx", alpha=0.3, **ROUGH_GLASS),
    "blend of glasses": glass(type="blendbsdf", weight=0.4, bsdf_0={"type": "roughdielectric", "alpha": 0.3, **ROUGH_GLASS},
                              bsdf_1={"type": "roughdielectric", "distribution": "ggx", "alpha": 0.5, **ROUGH_GLASS}),
    "frosted leaf": glass(type="mask", opacity=0.6, pane={"type": "roughdielectric", "alpha": 0.3, **ROUGH_GLASS}),
    "glass with bumps": glass(type="normalmap", normalmap=bumps(), nested={
        "type": "roughdielectric", "alpha": 0.3, **ROUGH_GLASS}),
    "moving rough glass": {"sensor": camera(4), "sky": sky(), "glowing": glowing(), SUBJECT: plane(
        bsdf={"type": "roughdielectric", "alpha": 0.3, **ROUGH_GLASS}), "floor": floor(), "lamp": lamp()},
    "brushed glass beckmann": glass(type="roughdielectric", distribution="beckmann", **BRUSHED, **ROUGH_GLASS),
    "brushed glass ggx": glass(type="roughdielectric", distribution="ggx", **BRUSHED, **ROUGH_GLASS),
    "twosided": {"sensor": camera(), "sky": sky(), "glowing": glowing(),
                 SUBJECT: {"type": "twosided", "front": {"type": "roughconductor", "alpha": 0.4, **ROUGH_METAL},
                           "behind": diffuse(0.8, 0.3, 0.1)},
                 "sheet": plane((-3.0, 0, 0.2), bsdf={"type": "ref", "id": SUBJECT}),
                 "reversed": rectangle((3.1, 0, 0.1), 3.1, (0.23, 1, 0.17), 163, bsdf={"type": "ref", "id": SUBJECT})},
    "area": light(**lamp(emitter={"type": "area", "radiance": bitmap(factor=9.0)}, bsdf={"type": "ref", "id": "dark"})),
    "area with squares": light(**lamp(emitter={"type": "area", "radiance": squares(rgb(9, 8, 5), bitmap(factor=9.0))},
                                      bsdf={"type": "ref", "id": "dark"})),
    "area of a mesh": light(**quadrilateral(
        smooth=False, vertex_positions=[[-0.6, 1.9, 1.6], [0.9, 2.3, 1.5], [0.8, 2.2, 2.7], [-0.7, 2.0, 2.8]],
        emitter={"type": "area", "radiance": bitmap(factor=9.0)}, bsdf={"type": "ref", "id": "dark"})),
    "directionalarea": light(**beam(bsdf={"type": "ref", "id": "dark"})),
    "one of many lamps": light(**lamp(emitter={"type": "area", "radiance": bitmap(factor=9.0)}, bsdf={
        "type": "ref", "id": "dark"})) | lamps(),
    "many lamps and a sky": light(**sky()) | lamps(),
    "constant": light(type="constant", radiance=rgb(0.6, 0.9, 1.4)),
    "sunsky": light(type="sunsky", sun_direction=[0.3, 0.9, 0.7], turbidity=3.3, albedo=rgb(0.2, 0.4, 0.3), sky_scale=0.04,
                    sun_scale=0.01, sun_aperture=9.0, to_world=rotate((1, 0.1, 0.2), -80)),
    "directional": light(type="directional", direction=[-0.3, -1.0, -0.9], irradiance=rgb(2.8, 2.7, 2.4)),
    "envmap": light(**sky()),
    "glowing body": light(type="point", position=[0.7, 0.9, 1.9], intensity={"type": "blackbody", "temperature": 2000.0}),
    "light by a spectrum": light(type="point", position=[0.7, 0.9, 1.9], intensity=IRREGULAR | {"values": [3, 9, 6, 9]}),
    "point": light(type="point", position=[0.7, 0.9, 1.9], intensity=rgb(9, 8, 7)),
    "projector": light(type="projector", to_world=AIMED, irradiance=bitmap(factor=2.0), scale=2.0, fov=80.0),
    "spot with squares": light(type="spot", to_world=AIMED, intensity=rgb(9, 8, 7), cutoff_angle=58.0, beam_width=4.0,
                               texture=squares(0.9, rgb(0.2, 0.5, 0.4))),
    "spot": light(type="spot", to_world=AIMED, intensity=rgb(9, 8, 7), cutoff_angle=58.0, beam_width=4.0,
                  texture=bitmap()),
    "perspective": {SUBJECT: camera(principal_point_offset_x=0.03, principal_point_offset_y=-0.02, rfilter="gaussian"),
                    "plane": plane(bsdf=printed()), "lamp": lamp(), "floor": floor()},
    "perspective on trilinear": {SUBJECT: camera(rfilter="gaussian"), "plane": plane(bsdf=printed(**TRILINEAR)),
                                 "lamp": lamp(), "floor": floor()},
    "orthographic on trilinear": {SUBJECT: parallel(), "plane": plane(bsdf=printed(**TRILINEAR)), "lamp": lamp(),
                                  "floor": floor()},
    "lens on trilinear": {SUBJECT: blurred(), "plane": plane(bsdf=printed(**TRILINEAR)), "lamp": lamp(), "floor": floor()},
    "fisheye on trilinear": {SUBJECT: calibrated(factor=0.4, **FISHEYE), "lamp": lamp(), "floor": floor(),
                             "plane": rectangle((0, 0, 0), 8.0, (0.35, 1, 0.23), 24, bsdf=printed(**TRILINEAR))},
    "thinlens": {SUBJECT: blurred(), "plane": plane(bsdf=printed()), "lamp": lamp(), "floor": floor()},
    "calibrated": {SUBJECT: calibrated(factor=0.55), "plane": plane(bsdf=printed()), "lamp": lamp(), "floor": floor()},
    "calibrated fisheye": {SUBJECT: calibrated(factor=0.4, **FISHEYE), "lamp": lamp(), "floor": floor(),
                           "plane": rectangle((0, 0, 0), 8.0, (0.35, 1, 0.23), 24, bsdf=printed())},
    "batch": {SUBJECT: {"type": "batch", "film": {"type": "hdrfilm", "width": 4, "height": 2}, "left": camera(),
                        "right": parallel()}, "plane": plane(bsdf=printed()), "lamp": lamp(), "floor": floor()},
    "orthographic": {SUBJECT: parallel(), "plane": plane(bsdf=printed()), "lamp": lamp(), "floor": floor()},
}


def build(name: str, dtype: torch.dtype = torch.float64, **more: Any) -> rb.Scene:
    """A new scene of `SCENES`; `more` objects in it, or instead of its own."""
    objects = SCENES[name]
    return load(dtype, **(objects() if callable(objects) else objects) | more)


def subjects(scene: rb.Scene) -> list[str]:
    """The parameters that are examined."""
    return [name for name, _ in scene.named_parameters() if name.startswith(SUBJECT)]
