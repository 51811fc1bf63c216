"""One crowded scene with every plugin in it, and what is extreme about its variants."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

import torch_radbp as rb
from tests.scenes import GLOW, diffuse, look_at, rectangle, rgb, sensor, texels
from tests.scenes.parts import FISHEYE, blurred, calibrated, parallel
from torch_radbp.io.values.transform import rotate, scale, translate

SIZE = 6


def picture(height: int, width: int, seed: int) -> dict[str, Any]:
    return {"type": "bitmap", "data": texels(height, width, seed)}


def tent() -> dict[str, Any]:
    """A small closed mesh with its own normals and texture coordinates."""
    vertices = torch.tensor([[0.0, 0.9, 0], [-0.5, 0, -0.4], [0.6, 0, -0.3], [0.1, 0, 0.6]])
    faces = torch.tensor([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]])
    return {"type": "mesh", "vertex_positions": vertices, "faces": faces,
            "vertex_normals": torch.nn.functional.normalize(vertices - torch.tensor([0.05, 0.3, 0]), dim=1),
            "vertex_texcoords": torch.tensor([[0.1, 0.2], [0.9, 0.1], [0.4, 0.8], [0.7, 0.6]])}


def crowd(material: dict[str, Any], dtype: torch.dtype, view: np.ndarray | None = None, **changes: Any) -> rb.Scene:
    """A panel, a tent, a cube and others of a material above a floor, between all kinds of light; `changes` by name."""
    own = {"type": "ref", "id": "material"}
    up, down = look_at((1.2, 2.5, 1.6), (0, 0, 0), (0, 1, 0)), look_at((-1.5, 2, 1), (0.1, 0, 0.2), (0, 1, 0))
    objects = {
        "camera": sensor(SIZE, (0.2, 1.1, 3.3), (0, 0.4, 0), 50, **({} if view is None else {"to_world": view})),
        "material": material,
        "panel": rectangle((-0.8, 0.6, -0.4), 0.6, (0.2, 1, 0.1), 25, bsdf=own),
        "tent": tent() | {"to_world": translate((0.9, 0, 0.2)), "bsdf": own},
        "cube": {"type": "cube", "to_world": translate((0.1, 0.3, 0.3)) @ rotate((1, 2, 3), 33) @ scale((0.3, 0.25, 0.3)),
                 "bsdf": own},
        "lump": lump() | {"bsdf": own},
        "disk": {"type": "disk", "to_world": translate((0.4, 1.3, -0.7)) @ rotate((1, 1, 0), 20) @ scale((0.4, 0.4, 0.4)),
                 "bsdf": {"type": "twosided", "front": own}
                 if not any(name in material["type"] for name in ("electric", "mask", "null", "thin"))
                 else diffuse(0.4, 0.3, 0.2)},
        "floor": rectangle((0, -0.1, 0), 2, (1, 0.02, 0.01), -89, bsdf={"type": "diffuse", "reflectance": picture(3, 4, 1)}),
        "lamp": rectangle((0.3, 2.1, -0.5), 0.4, (1, 0.1, 0), 100,
                          emitter={"type": "area", "radiance": picture(2, 3, 2)}),
        "sky": {"type": "envmap", "bitmap": texels(4, 7, 3), "to_world": rotate((1, 2, 0.5), 40)},
        "point": {"type": "point", "position": [0.4, 1.9, 1.2], "intensity": rgb(1, 0.8, 0.6)},
        "spot": {"type": "spot", "to_world": up, "intensity": rgb(3, 2, 1), "texture": picture(3, 3, 4), "cutoff_angle": 40},
        "beamer": {"type": "projector", "to_world": down, "irradiance": picture(4, 3, 5), "fov": 60},
        "sun": {"type": "directional", "direction": [0.3, -1, -0.4], "irradiance": rgb(0.3, 0.2, 0.1)},
    }
    objects |= changes
    return rb.load_dict({"type": "scene", **{name: value for name, value in objects.items() if value is not None}}).to(dtype)


def lump(factor: float = 1.0) -> dict[str, Any]:
    """A ball given by distances, times a factor, and cut off by the cube that they are given in; some are exactly 0."""
    places = torch.meshgrid(*(torch.linspace(-1, 1, count) for count in (4, 5, 6)), indexing="ij")
    grid = torch.stack(places).norm(dim=0) - 1.1
    grid[1, 2, 3] = grid[2, 4, 3] = 0.0
    return {"type": "sdfgrid", "grid": factor * grid[..., None],
            "to_world": translate((-0.6, 0.1, 0.5)) @ scale((0.4, 0.4, 0.4))}


def put(scene: rb.Scene, **values: Any) -> rb.Scene:
    """Sets parameters to values that a constructor would refuse; `__` in a name stands for a dot."""
    for name, value in values.items():
        parameter = scene.get_parameter(name.replace("__", "."))
        with torch.no_grad():
            parameter.copy_(torch.as_tensor(value, dtype=parameter.dtype).expand(parameter.shape))
    return scene


BRUSHED = {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.1, "alpha_v": picture(2, 2, 6),
           "eta": rgb(0.4, 1, 2), "k": rgb(3, 2, 1)}
POLISHED = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.1, "material": "Au"}
GLASS = {"type": "dielectric", "int_ior": 1.5}


def of(material: dict[str, Any], **values: Any) -> Callable[[torch.dtype], rb.Scene]:
    """The crowd of a material whose parameters are set to extremes."""
    return lambda dtype: put(crowd(material, dtype), **{f"material__{name}": value for name, value in values.items()})


def spectra(share: float) -> Callable[[torch.dtype], rb.Scene]:
    """The crowd with all textures that are no image, at the ends of their ranges."""
    dark = {"type": "regular", "wavelength_min": 400.0, "wavelength_max": 700.0, "values": [share] * 3}
    light = {"type": "irregular", "wavelengths": [300.0, 555.0, 900.0], "values": [1 - share] * 3}
    ends = {"type": "volume", "volume": {"type": "gridvolume", "data": torch.tensor([0.0, share]).reshape(1, 1, 2)}}
    metal = {"type": "conductor", "eta": {"type": "rawconstant", "value": 1.0 + share},
             "k": {"type": "srgb", "color": share}, "specular_reflectance": {"type": "checkerboard", "color0": {
                 "type": "uniform", "value": 1.0 - share}, "color1": ends}}
    glow = {"type": "blackbody", "temperature": 100.0 if share else 1e6}
    shared = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_share"}}

    def build(dtype: torch.dtype) -> rb.Scene:
        scene = crowd(
            {"type": "plastic", "diffuse_reflectance": dark, "specular_reflectance": light}, dtype,
            tent=tent() | {"to_world": translate((0.9, 0, 0.2)), "bsdf": shared},
            metal=metal, mirror=rectangle((0.8, 0.6, -0.4), 0.6, (0.2, 1, 0.1), 15, bsdf={"type": "ref", "id": "metal"}),
            point={"type": "point", "position": [0.4, 1.9, 1.2], "intensity": glow},
            sun={"type": "directional", "direction": [0.3, -1, -0.4], "irradiance": {"type": "d65", "scale": share}})
        scene.tent.add_attribute("vertex_share", torch.full((4, 1), share))
        return scene

    return build


def materials() -> dict[str, Callable[[torch.dtype], rb.Scene]]:
    """By name, every material at the ends of the range of its parameters."""
    found = {f"diffuse {value}": of(diffuse(0.5, 0.5, 0.5), reflectance__value=value) for value in (0.0, 1.0)}
    metal = {"type": "conductor", "eta": 0.5, "k": 1.0}
    for eta, k in ((0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (1e-6, 1e-6), (9.0, 9.0)):
        found[f"conductor {eta} {k}"] = of(metal, eta__value=eta, k__value=k)
    found["conductor black"] = of(metal, specular_reflectance__value=0.0)
    for eta in (0.3, 1 - 1e-7, 1.0, 1 + 1e-7, 3.0):
        found[f"dielectric {eta}"] = of(GLASS, eta=eta)
        found[f"thindielectric {eta}"] = of({"type": "thindielectric"}, eta=eta)
    found["dielectric black"] = of(GLASS, specular_reflectance__value=0.0, specular_transmittance__value=0.0)
    for distribution in ("beckmann", "ggx"):
        rough = {"type": "roughconductor", "distribution": distribution, "material": "Au"}
        for alpha in (0.0, 1e-4, 1e-3, 1.0):
            found[f"roughconductor {distribution} {alpha}"] = of(rough | {"alpha": 0.1}, alpha__value=alpha)
        found[f"roughconductor {distribution} brushed"] = of(rough | {"alpha_u": 0.1, "alpha_v": 0.1}, alpha_u__value=0.0,
                                                             alpha_v__value=1.0)
        rough = {"type": "roughdielectric", "distribution": distribution}
        for alpha, eta in ((0.0, 1.5), (1e-3, 0.66), (1.0, 3.0), (0.1, 1.0), (0.0, 1.0), (1e-3, 1 + 1e-7)):
            found[f"roughdielectric {distribution} {alpha} {eta}"] = of(rough | {"alpha": 0.1}, alpha__value=alpha, eta=eta)
        found[f"roughdielectric {distribution} brushed"] = of(rough | {"alpha_u": 0.1, "alpha_v": 0.1}, alpha_u__value=1.0,
                                                              alpha_v__value=0.0)
        rough = {"type": "roughplastic", "distribution": distribution}
        for alpha, eta in ((0.0, 1.5), (1e-3, 0.66), (1.0, 3.0), (0.1, 1.0), (0.0, 1.0), (1e-3, 1 + 1e-7)):
            found[f"roughplastic {distribution} {alpha} {eta}"] = of(rough, alpha=alpha, eta=eta)
    for eta in (0.66, 1.0, 1 + 1e-7, 3.0):
        found[f"plastic {eta}"] = of({"type": "plastic", "nonlinear": True}, eta=eta)
    found["plastic black"] = of({"type": "plastic"}, diffuse_reflectance__value=0.0, specular_reflectance__value=0.0)
    found["roughplastic black"] = of({"type": "roughplastic"}, diffuse_reflectance__value=0.0,
                                     specular_reflectance__value=0.0)
    shares = ("anisotropic", "metallic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "clearcoat", "clearcoat_gloss",
              "flatness")
    for colour, roughness, specular, share in ((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0),
                                               (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 1.0, 0.5)):
        found[f"principled {colour} {roughness} {specular} {share}"] = of(
            {"type": "principled"}, base_color__value=colour, roughness__value=roughness, specular=specular,
            **{f"{name}__value": share for name in shares})
    for colour, roughness, eta, share in ((0.0, 0.0, 1.0, 0.0), (1.0, 1.0, 3.0, 1.0), (0.0, 0.0, 0.3, 1.0),
                                          (1.0, 0.0, 1.0, 0.5)):
        found[f"principledthin {colour} {roughness} {eta} {share}"] = of(
            {"type": "principledthin"}, base_color__value=colour, roughness__value=roughness, eta__value=eta,
            **{f"{name}__value": share for name in shares if name not in ("metallic", "clearcoat", "clearcoat_gloss")},
            diff_trans__value=2 * share)
    for share in (0.0, 1.0):
        found[f"principled glass {share}"] = of({"type": "principled", "eta": 1.5}, eta=1.0, spec_trans__value=share)
    for weight in (0.0, 1.0):
        found[f"blendbsdf {weight}"] = of({"type": "blendbsdf", "weight": 0.5, "metal": {"type": "conductor"},
                                           "plastic": {"type": "plastic"}}, weight__value=weight)
        found[f"mask {weight}"] = of({"type": "mask", "leaf": {"type": "roughplastic"}}, opacity__value=weight)
        found[f"normalmap {weight}"] = of({"type": "normalmap", "normalmap": rgb(0.5, 0.5, 1.0), "nested": {
            "type": "roughconductor"}}, normalmap__value=weight)
    hills = {"type": "bumpmap", "heights": picture(3, 3, 7) | {"raw": True}, "nested": {"type": "roughconductor"}}
    for factor in (0.0, 1e6, -3.0):
        found[f"bumpmap {factor}"] = of(hills, scale=factor)
    found["null"] = of({"type": "null"})
    found |= {f"spectra {value}": spectra(value) for value in (0.0, 1.0)}
    return found




def view(origin, target, up=(0, 1, 0)) -> np.ndarray:
    return look_at(origin, target, up)


def ragged(scale_: float = 1.0) -> dict[str, Any]:
    """A mesh with a triangle without area, a sliver, a tiny one, and one of the common kind."""
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0.1], [0.1, 1, 0], [0.5, 0, 0.05], [0.3, 0.3, 0.2], [0.3, 0.3, 0.2],
                             [0.3 + 1e-6, 0.3, 0.2], [0.3, 0.3 + 1e-6, 0.2]]) * scale_
    faces = torch.tensor([[0, 1, 2], [0, 1, 3], [4, 5, 2], [4, 6, 7], [0, 1, 1]])
    return {"type": "mesh", "vertex_positions": vertices, "faces": faces, "to_world": translate((-0.3, 0.5, 0.6))}


def scaled(factor: float) -> Callable[[torch.dtype], rb.Scene]:
    """The whole scene smaller or larger."""
    def build(dtype: torch.dtype) -> rb.Scene:
        scene = crowd(BRUSHED, dtype)
        scene.camera.near_clip, scene.camera.far_clip = 0.01 * factor, 1e4 * factor
        with torch.no_grad():
            for name, parameter in scene.named_parameters():
                if name.endswith("to_world") and name != "sky.to_world":
                    parameter[:3, 3] *= factor
                    if scene.get_submodule(name.rpartition(".")[0]).category == "shape":
                        parameter[:3, :3] *= factor
                elif name.endswith(("vertex_positions", "position")):
                    parameter *= factor
        return scene
    return build


def places() -> dict[str, Callable[[torch.dtype], rb.Scene]]:
    """By name, extremes of where things are."""
    flat = rectangle((0, 0, 0), 2, (1, 0, 0), -90, bsdf=BRUSHED)
    facing = torch.tensor([[0.0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 0, 0]])
    return {
        "grazing view": lambda dtype: crowd(BRUSHED, dtype, view((0, 1e-6, 3), (0, 0, 0)), floor=flat),
        "view from inside of a surface": lambda dtype: crowd(BRUSHED, dtype, view((0, 0, 1), (0, 0, 0)), floor=flat),
        "view from inside of glass": lambda dtype: crowd(GLASS, dtype, view((0.1, 0.3, 0.3), (1, 0.3, 0))),
        "view to the pole": lambda dtype: put(crowd(BRUSHED, dtype, view((0, 1.5, 0), (0, 9, 0), (0, 0, 1)), lamp=None,
                                                    disk=None), sky__to_world=torch.eye(4)),
        "triangles without area": lambda dtype: crowd(BRUSHED, dtype, tent=ragged() | {"bsdf": BRUSHED}),
        "lamp with triangles without area": lambda dtype: crowd(
            BRUSHED, dtype, lamp=ragged() | {"emitter": {"type": "area", "radiance": rgb(1, 2, 3)}}),
        "tiny distances": lambda dtype: crowd(BRUSHED, dtype, lump=lump(1e-30)),
        "huge distances": lambda dtype: crowd(BRUSHED, dtype, lump=lump(1e17) | {"normals": "analytic"}),
        "small": scaled(1e-2), "large": scaled(1e4),
        "coordinates in one point": lambda dtype: put(crowd(BRUSHED, dtype), tent__vertex_texcoords=0.3),
        "coordinates on a line": lambda dtype: put(crowd(BRUSHED, dtype), tent__vertex_texcoords=torch.tensor(
            [[0.1, 0.1], [0.2, 0.2], [0.5, 0.5], [0.9, 0.9]])),
        "normals that cancel": lambda dtype: put(crowd(BRUSHED, dtype), tent__vertex_normals=facing),
        "normals along u": lambda dtype: put(crowd(BRUSHED, dtype, floor=flat), tent__vertex_normals=torch.tensor(
            [1.0, 0, 0])),
        "light in a surface": lambda dtype: crowd(
            BRUSHED, dtype, floor=flat, point={"type": "point", "position": [0.3, 0, 0.9], "intensity": rgb(1, 1, 1)},
            lamp=rectangle((0.3, 0, 0.9), 0.4, (1, 0, 0), 90, emitter=GLOW)),
        "lamp that stands on a floor": lambda dtype: crowd(
            BRUSHED, dtype, floor=flat, lamp=rectangle((0, 0.4, -0.5), 0.4, emitter=GLOW)),
        "tiny lamp": lambda dtype: crowd(BRUSHED, dtype, lamp=rectangle(
            (0.3, 2, -0.5), 1e-5, (1, 0, 0), 90, emitter={"type": "area", "radiance": rgb(1e10, 1e10, 1e10)})),
        "black surfaces, and no light but the lamp": lambda dtype: put(
            crowd(diffuse(0, 0, 0), dtype, lamp=rectangle((0.3, 1.2, -0.5), 0.4, emitter=GLOW)), sky__data=0.0,
            sun__irradiance__value=0.0, spot__texture__data=0.0, beamer__irradiance__data=0.0,
            floor__bsdf__reflectance__data=0.0, point__intensity__value=0.0),
        "grazing view of a mirror that is hardly rough": lambda dtype: put(
            crowd(POLISHED, dtype, view((0, 0.02, 3), (0, 0, 0)),
                  floor=rectangle((0, 0, 0), 9, (1, 0, 0), -90, bsdf={"type": "ref", "id": "material"})),
            material__alpha__value=1e-4),
        "axes": lambda dtype: crowd(
            BRUSHED, dtype, view((0, 0.5, 3), (0, 0.5, 0)), panel=rectangle((0, 0.5, -1), 0.7, bsdf=BRUSHED),
            cube={"type": "cube", "to_world": scale((0.3, 0.3, 0.3)), "bsdf": GLASS}, floor=flat,
            lamp=rectangle((0, 2, 0), 0.4, (1, 0, 0), 90, emitter=GLOW)),
        "open lens": lambda dtype: put(crowd(BRUSHED, dtype, camera=blurred(SIZE)), camera__aperture_radius=3.0,
                                       camera__focus_distance=1e-3),
        "folded lens": lambda dtype: put(crowd(BRUSHED, dtype, camera=calibrated(SIZE)), camera__k1=-3.0, camera__k4=9.0),
        "fisheye that sees behind itself": lambda dtype: crowd(BRUSHED, dtype, camera=calibrated(SIZE, 0.1, **FISHEYE)),
        "two cameras in one place": lambda dtype: crowd(BRUSHED, dtype, camera={
            "type": "batch", "film": {"type": "hdrfilm", "width": 2 * SIZE, "height": SIZE}, "a": parallel(),
            "b": parallel()}),
        "hazy sky": lambda dtype: put(crowd(BRUSHED, dtype, sky={"type": "sunsky", "sun_direction": [1, 1e-3, 0]}),
                                      sky__turbidity=10.0, sky__albedo__value=1.0),
        "sphere, constant sky": lambda dtype: crowd(
            BRUSHED, dtype, sky={"type": "constant", "radiance": rgb(1, 1, 1)}, tent=None, cube=None,
            camera=parallel(2.0), ball={"type": "sphere", "radius": 0.5, "bsdf": BRUSHED},
            pipe={"type": "cylinder", "p0": [-0.7, 0.1, 0.2], "p1": [-0.7, 0.1001, 0.2], "radius": 0.3, "bsdf": BRUSHED},
            group={"type": "shapegroup", "ball": {"type": "sphere", "bsdf": BRUSHED}, "sheet": ragged() | {"bsdf": GLASS}},
            dust={"type": "instance", "to_world": translate((0.4, 0.2, 1)) @ scale((1e-5, 1e-5, 1e-5)),
                  "group": {"type": "ref", "id": "group"}},
            flattened={"type": "instance", "to_world": translate((-0.3, 0.9, 0.5)) @ scale((-0.3, 0.3, 1e-5)),
                       "group": {"type": "ref", "id": "group"}},
            needle={"type": "cylinder", "p0": [0.7, -9, 0.2], "p1": [0.7, 9, 0.2], "radius": 1e-4, "bsdf": BRUSHED},
            beam=rectangle((0.2, 2.2, 0.3), 0.9, (1, 0.1, 0.2), 100, emitter=GLOW | {"type": "directionalarea"})),
    }


CASES = materials() | places()
