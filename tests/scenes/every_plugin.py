"""A tiny scene for every plugin, in which each of its parameters matters.

What is called `subject` is examined, with everything in it; the rest lights it and is seen beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, rgb
from tests.scenes.parts import (
    AIMED,
    FIELD_OF_VIEW,
    FISHEYE,
    THIN_PRISM,
    beam,
    bitmap,
    blurred,
    bumps,
    calibrated,
    camera,
    distances,
    fine,
    floor,
    glowing,
    heights,
    lamp,
    lamps,
    parallel,
    plane,
    printed,
    sky,
    squares,
    turned,
)
from tests.scenes.quadrilateral import CORNERS, FACES, coloured_file, mesh_file, quadrilateral
from torch_radbp.io.values.transform import rotate, scale, translate

SUBJECT = "subject"


def shape(**attributes: Any) -> dict[str, Any]:
    """A shape under a lamp, above a floor."""
    return {"sensor": camera(), "lamp": lamp(), "floor": floor(), SUBJECT: attributes}


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


def fog(**attributes: Any) -> dict[str, Any]:
    """A medium around a camera, in which a lamp lights a floor."""
    return {"sensor": camera(medium={"type": "ref", "id": SUBJECT}), "lamp": lamp(), "floor": floor(), SUBJECT: attributes}


def grid(channels: int = 1, seed: int = 3, **attributes: Any) -> dict[str, Any]:
    """A grid of positive values around everything, turned, and read beyond its border as well."""
    data = 0.1 + 0.8 * torch.rand(2, 3, 2, channels, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    to_world = rotate((1, 2, 0.4), 15) @ scale((2.6, 3.0, 4.0)) @ translate((-0.5, -0.5, -0.5))
    return {"type": "gridvolume", "data": data, "to_world": to_world} | attributes


def smoke(g: float, channels: int = 1, **more: Any) -> dict[str, Any]:
    """A medium that varies in an invisible box, between a lamp and a floor."""
    box = {"type": "cube", "to_world": translate((0, 0, 1)) @ scale((0.8, 0.8, 0.8)), "bsdf": {"type": "null"},
           "interior": {"type": "ref", "id": SUBJECT}}
    dark = grid(3, seed=5)
    dark["data"] = dark["data"] * 0.3  # of which little noise comes
    return {"sensor": camera(), "lamp": lamp(), "floor": floor(), "box": box, SUBJECT: {
        "type": "heterogeneous", "scale": 1.5, "sigma_t": grid(channels), "albedo": dark,
        "phase": {"type": "hg", "g": g}} | more}


HAZE = {"type": "homogeneous", "sigma_t": rgb(0.2, 0.3, 0.4), "albedo": rgb(0.9, 0.6, 0.3)}
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
    "homogeneous": fog(type="homogeneous", sigma_t=rgb(0.2, 0.3, 0.4), albedo=rgb(0.9, 0.6, 0.3), scale=1.5,
                       phase={"type": "hg", "g": 0.4}),
    "heterogeneous": lambda: smoke(0.4),
    "smoke of three colours": lambda: smoke(0.4, 3),
    "flame": lambda: smoke(0.4, emission=grid(3, seed=7)),
    "glowing fog": fog(**HAZE, emission=rgb(0.3, 0.2, 0.4)),
    "fog by a table": fog(**HAZE, phase={"type": "tabphase", "values": "0.3, 0.2, 0.5, 1.1"}),
    "fog of flakes": fog(**HAZE, phase={"type": "sggx", "S": [0.9, 0.3, 0.5, 0.2, -0.1, 0.15]}),
    "fog of two kinds": fog(**HAZE, phase={
        "type": "blendphase", "weight": grid(), "phase_0": {"type": "hg", "g": 0.5}, "phase_1": {"type": "hg", "g": -0.3}}),
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
    "volume": metal(type="roughplastic", distribution="ggx", alpha=0.3, diffuse_reflectance=squares(
        {"type": "volume", "volume": grid(3)}, {"type": "volume", "volume": grid(3, 4, wrap_mode="mirror")}),
        specular_reflectance={"type": "volume", "volume": 0.7}),
    "volume of roughness": metal(type="roughconductor", alpha={"type": "volume", "volume": grid(3)}, **ROUGH_METAL),
    "volume on a mesh": shape(**quadrilateral(bsdf={
        "type": "roughplastic", "alpha": 0.4, "diffuse_reflectance": {"type": "volume", "volume": grid(3)},
        "specular_reflectance": bitmap()})),
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
    "calibrated thin prism": {SUBJECT: calibrated(factor=0.4, **THIN_PRISM), "lamp": lamp(), "floor": floor(),
                              "plane": rectangle((0, 0, 0), 8.0, (0.35, 1, 0.23), 24, bsdf=printed())},
    "calibrated field of view": {SUBJECT: calibrated(factor=0.55, **FIELD_OF_VIEW), "lamp": lamp(), "floor": floor(),
                                 "plane": plane(bsdf=printed())},
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
