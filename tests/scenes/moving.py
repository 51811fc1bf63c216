"""Scenes in which one thing moves, and neither a shadow's nor a lamp's edge with it; in the last ones edges move in view.

So the derivative that the renderer computes is the whole derivative, and finite differences with independent samples must
agree with it in expectation. Textures are smooth, so that finite differences with a moderate step are accurate.

Steps are as small as rare samples allow: where a material chooses between reflection and refraction, a step changes the
choice of a few samples, and a difference in which none changed lacks their part without a standard error that tells.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at, rgb
from tests.scenes.endless import (
    ANGLE,
    HALF,
    MESH_TEXTURE,
    SIZE,
    TILT,
    bowl,
    bright_plane,
    camera,
    envmap,
    flat,
    grid_mesh,
    lamp,
    mesh_of_file,
    plane,
    point,
    projector,
    relief,
    rough_sheet,
    shaded_as,
    shown,
    textured,
    tube,
    wavy,
    window,
)
from tests.scenes.parts import FIELD_OF_VIEW, FISHEYE, THIN_PRISM, blurred, calibrated, parallel
from torch_radbp.io.values.transform import rotate, scale, translate

TWIST = ((0.31, -0.43, 0.24), (0.37, -0.52, 0.29))  # a rotation vector and a translation, both generic
SHIFT, TURN = ((0.0, 0.0, 0.0), TWIST[1]), (TWIST[0], (0.0, 0.0, 0.0))


class MovingScene(NamedTuple):
    """A scene, what moves in it and how."""

    build: Callable[[], rb.Scene]
    name: str  # of the parameter
    direction: Callable[[Tensor], Tensor]  # from the parameter to the tangent
    step: float  # of central differences, in units of the direction
    max_depth: int = 2
    samplings: tuple[str, ...] = ("hybrid", "attached")  # that give the whole derivative

    def tangent(self, scene: rb.Scene) -> Tensor:
        return self.direction(scene.get_parameter(self.name).detach())


def rigid(motion, about=(0.1, 0.15, 0.0)) -> Callable[[Tensor], Tensor]:
    """Tangents of (4, 4) poses that turn about a point and shift: a rotation vector and a translation per unit."""
    (x, y, z), shift = motion
    turn = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    generator = torch.zeros(4, 4, dtype=torch.float64)
    generator[:3, :3] = turn
    generator[:3, 3] = torch.tensor(shift, dtype=torch.float64) - turn @ torch.tensor(about, dtype=torch.float64)
    return lambda pose: generator.to(pose) @ pose


def wave(seed: int = 3, size: float = 1.0) -> Callable[[Tensor], Tensor]:
    """A different smooth motion of every vertex (V, 3): sine waves of their numbers; the same for any tensor."""
    def tangent(value: Tensor) -> Tensor:
        phase = torch.arange(value.numel(), dtype=value.dtype).reshape(value.shape)
        return size * torch.sin(1.7 * phase + seed)

    return tangent


def constant(*value: float) -> Callable[[Tensor], Tensor]:
    return lambda parameter: torch.tensor(value).to(parameter).reshape(parameter.shape)


def scene(**objects: Any) -> Callable[[], rb.Scene]:
    """Called to build the scene, in float64, with the camera if there is no other."""
    return lambda: load(torch.float64, **{"sensor": camera()} | objects)


def of_camera(sensor: dict[str, Any], label: str, steps: dict[str, float], fine: float = 1.0) -> dict[str, MovingScene]:
    """A scene for each of these parameters of a sensor, before a plane whose texture is so many times finer."""
    before = {"plane": plane(bsdf=textured(half=fine * HALF))} | POINT
    return {f"{label}, {name}": MovingScene(
        scene(sensor=sensor, **before), f"sensor.{name}",
        rigid(TWIST, (0.5, -0.4, 2.6)) if name == "to_world" else constant(1), step, samplings=("hybrid",))
        for name, step in steps.items()}


def of_mesh(shape: dict[str, Any], label: str) -> dict[str, MovingScene]:
    """A scene for every parameter of a mesh of a few vertices, which fills the view."""
    build = scene(sheet=shape | {"bsdf": textured()}, **POINT)
    return {f"{label}, {name}": MovingScene(build, f"sheet.{name}", direction, 0.002, samplings=("hybrid",))
            for name, direction in {"to_world": rigid(TWIST), "vertex_positions": wave(size=0.02), "vertex_normals": wave(),
                                    "vertex_texcoords": wave(size=0.05)}.items()}


VIEW = {name: camera()[name] for name in ("to_world", "film")}
MIRROR_WORLD = {"behind": bright_plane(9, (0.3, 0.2, 4.5), (1, 0.2, 0), 168)}
METAL = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.3, "material": "Au"}
LACQUER = {"type": "principled", "base_color": rgb(0.8, 0.4, 0.3), "roughness": 0.5, "metallic": 0.4, "clearcoat": 0.6}
POINT, SKY = {"lamp": point()}, {"sky": {"type": "constant", "radiance": rgb(0.9, 1.1, 1.4)}}
FLOOR = {"plane": plane(bsdf=textured())}
SOLID = {"type": "cube", "to_world": translate((0.1, 0.15, 0)) @ rotate(TWIST[0], 40) @ scale((0.5, 0.4, 0.3)),
         "bsdf": {"type": "twosided", "one": textured(half=2.0)}}
# Two leaves that meet along x = z = 0, seen from between.
BOOK = {"type": "mesh", "bsdf": {"type": "twosided", "one": diffuse(0.7, 0.5, 0.3)}, "faces": torch.tensor([
    [0, 1, 2], [0, 2, 3], [1, 0, 4], [1, 4, 5]]), "vertex_positions": torch.tensor([
        [0, -9.0, 0], [0, 9, 0], [-9, 9, 5], [-9, -9, 5], [9, -9, 4], [9, 9, 4]], dtype=torch.float64)}
ROOM = FLOOR | {"back": plane((0.2, 0.1, 3.4), (1, 0.2, 0.1), 170, bsdf=textured(4)), "lamp": point((0.6, -0.5, 1.6))}
SCENES = {
    # A textured plane.
    "plane shifted": MovingScene(scene(**FLOOR, **POINT), "plane.to_world", rigid(SHIFT), 0.005),
    "plane turned": MovingScene(scene(**FLOOR, **POINT), "plane.to_world", rigid(TURN), 0.005),
    "plane under a sky": MovingScene(scene(**FLOOR, **SKY), "plane.to_world", rigid(TWIST), 0.005),
    "vertices": MovingScene(scene(sheet=grid_mesh(flat, bsdf=MESH_TEXTURE, normals=False), **POINT),
        "sheet.vertex_positions", wave(), 0.005),
    "vertices with their normals": MovingScene(
        scene(sheet=grid_mesh(wavy, bsdf=MESH_TEXTURE, normals=False, recompute_normals=True), **POINT),
        "sheet.vertex_positions", wave(size=0.3), 0.005),
    "mesh turned": MovingScene(scene(sheet=grid_mesh(wavy, bsdf=MESH_TEXTURE), **POINT), "sheet.to_world", rigid(TWIST),
                               0.005),
    "instance turned": MovingScene(scene(**shown(), **POINT), "shown.to_world", rigid(TWIST), 0.005),
    "vertices of an instance": MovingScene(scene(**shown(), **POINT), "group.sheet.vertex_positions", wave(), 0.005),
    # About the middle of the view.
    "texture turned": MovingScene(scene(**FLOOR, **POINT), "plane.bsdf.reflectance.to_uv", rigid(TWIST, (10.1, 10.4, 0)),
                                  0.005, samplings=("hybrid",)),
    "pyramid turned": MovingScene(scene(plane=plane(bsdf=textured(half=2 * HALF, filter_type="trilinear")), **POINT),
                                  "plane.bsdf.reflectance.to_uv", rigid(TWIST, (20.1, 20.4, 0)), 0.005,
                                  samplings=("hybrid",)),
    "cylinder turned": MovingScene(scene(tube=tube(), **POINT), "tube.to_world", rigid(TWIST), 0.005),
    "texture coordinates": MovingScene(scene(sheet=grid_mesh(wavy, bsdf=MESH_TEXTURE), **POINT),
                                       "sheet.vertex_texcoords", wave(size=0.1), 0.005),
    # Its shading normals.
    "normals under a point": MovingScene(scene(sheet=grid_mesh(wavy, bsdf=MESH_TEXTURE), **POINT),
                                         "sheet.vertex_normals", wave(), 0.005),
    # Flat but for its normals: over a sheet with waves attached directions would slide over the waves' outlines.
    "normals under an envmap": MovingScene(scene(sheet=shaded_as(wavy), sky=envmap()),
                                           "sheet.vertex_normals", wave(), 0.005),
    # A surround.
    "plane shifted under an envmap": MovingScene(scene(**FLOOR, sky=envmap()), "plane.to_world", rigid(SHIFT), 0.005),
    "plane turned under an envmap": MovingScene(scene(**FLOOR, sky=envmap()), "plane.to_world", rigid(TURN), 0.005),
    "envmap turned": MovingScene(scene(**FLOOR, sky=envmap()), "sky.to_world", rigid(TURN, (0, 0, 0)), 0.005),
    "envmap seen": MovingScene(scene(speck=plane((0, 0, 9), half=0.01, bsdf=diffuse(0.5, 0.5, 0.5)), sky=envmap()),
                               "sky.to_world", rigid(TURN, (0, 0, 0)), 0.005),
    "metal turned under an envmap": MovingScene(scene(plane=plane(bsdf=METAL), sky=envmap()), "plane.to_world",
                                                rigid(TURN), 0.005),
    "camera before metal under an envmap": MovingScene(scene(plane=plane(bsdf=METAL), sky=envmap()), "sensor.to_world",
                                                       rigid(TWIST, (0.5, -0.4, 2.6)), 0.005),
    # Lights without extent.
    "point light": MovingScene(scene(**FLOOR, **POINT), "lamp.position", constant(*TWIST[1]), 0.005),
    "projector": MovingScene(scene(**FLOOR, lamp=projector()), "lamp.to_world", rigid(TWIST, (-0.8, 0.9, 2.4)), 0.005),
    "plane under a projector": MovingScene(scene(**FLOOR, lamp=projector()), "plane.to_world", rigid(TWIST), 0.005),
    "spot": MovingScene(scene(**FLOOR, lamp={
        "type": "spot", "intensity": rgb(12, 9, 7), "cutoff_angle": 50, "beam_width": 2,
        "to_world": look_at((-0.8, 0.9, 2.4), (0.1, 0.1, 0), (0, 1, 0))}), "lamp.to_world",
        rigid(TWIST, (-0.8, 0.9, 2.4)), 0.005),
    "directional light": MovingScene(scene(**FLOOR, lamp={"type": "directional", "direction": [0.4, -0.5, -1],
                                                           "irradiance": rgb(3, 4, 5)}),
                                     "lamp.to_world", rigid(TURN, (0, 0, 0)), 0.005),
    # Lights with extent.
    "emitter seen": MovingScene(scene(glow=bright_plane(9, (0, 0, 0))), "glow.to_world", rigid(TWIST), 0.005),
    "soft lamp moved": MovingScene(scene(**FLOOR, lamp=lamp(True)), "lamp.to_world", rigid(TWIST, (1.0, 1.3, 1.9)), 0.02),
    "plane under a soft lamp": MovingScene(scene(**FLOOR, lamp=lamp(True)), "plane.to_world", rigid(TWIST), 0.02),
    # Attached BSDF samples slide over a lamp's edge, which is a silhouette to them; glued ones do not.
    "lamp moved": MovingScene(scene(**FLOOR, lamp=lamp(False)), "lamp.to_world", rigid(TWIST, (1.0, 1.3, 1.9)), 0.02,
                              samplings=("hybrid",)),
    "plane under a lamp": MovingScene(scene(**FLOOR, lamp=lamp(False)), "plane.to_world", rigid(TWIST), 0.02,
                                      samplings=("hybrid",)),
    "metal under a soft lamp": MovingScene(scene(plane=plane(bsdf=METAL), lamp=lamp(True)), "plane.to_world",
                                           rigid(TWIST), 0.02),
    # Light that has bounced.
    "wall behind the camera": MovingScene(scene(**ROOM), "back.to_world", rigid(TWIST, (0.2, 0.1, 3.4)), 0.02, 3),
    "plane before a wall": MovingScene(scene(**ROOM), "plane.to_world", rigid(TWIST), 0.02, 3),
    # Rough glass, mirrors and lenses before a textured emitter.
    "rough glass shifted": MovingScene(scene(**rough_sheet()), "sheet.to_world", rigid(SHIFT), 0.02),
    "rough glass turned": MovingScene(scene(**rough_sheet()), "sheet.to_world", rigid(TURN), 0.01),
    # Refraction by GGX facets seen edge-on ends with a jump, which glued directions miss (see `RoughDielectricKind`).
    "ggx glass shifted": MovingScene(scene(**rough_sheet("ggx", -0.7)), "sheet.to_world", rigid(SHIFT), 0.02,
                                     samplings=("attached",)),
    "ggx glass turned": MovingScene(scene(**rough_sheet("ggx")), "sheet.to_world", rigid(TURN), 0.02,
                                     samplings=("attached",)),
    "ggx glass, index": MovingScene(scene(**rough_sheet("ggx", -0.7)), "sheet.bsdf.eta", constant(1), 0.04,
                                     samplings=("attached",)),
    "rough glass, roughness": MovingScene(scene(**rough_sheet()), "sheet.bsdf.alpha.value", constant(1), 0.02),
    "rough glass, index": MovingScene(scene(**rough_sheet()), "sheet.bsdf.eta", constant(1), 0.03),
    "emitter behind rough glass": MovingScene(scene(**rough_sheet()), "behind.to_world", rigid(TWIST), 0.01),
    "mirror, vertices": MovingScene(scene(mirror=grid_mesh(bowl, bsdf={"type": "conductor", "material": "Ag"}),
                                          **MIRROR_WORLD), "mirror.vertex_positions", wave(size=0.5), 0.002),
    "mirror, normals": MovingScene(scene(mirror=grid_mesh(bowl, bsdf={"type": "conductor", "material": "Ag"}),
                                         **MIRROR_WORLD), "mirror.vertex_normals", wave(size=0.2), 0.002),
    "mirror, vertices with their normals": MovingScene(
        scene(mirror=grid_mesh(bowl, bsdf={"type": "conductor", "material": "Ag"}, normals=False, recompute_normals=True),
              **MIRROR_WORLD), "mirror.vertex_positions", wave(size=0.2), 0.002),
    "mirror turned": MovingScene(scene(mirror=plane(bsdf={"type": "conductor", "material": "Ag"}), **MIRROR_WORLD),
                                 "mirror.to_world", rigid(TWIST), 0.002),
    "pane, index": MovingScene(scene(**window({"type": "dielectric", "int_ior": 1.5}, flat, flat)), "glass.eta",
                               constant(1), 0.06, 5),
    "lens, vertices": MovingScene(scene(**window({"type": "dielectric", "int_ior": 1.5}, wavy, wavy)),
                                  "front.vertex_positions", wave(size=0.5), 0.02, 4),
    "lens, normals": MovingScene(scene(**window({"type": "dielectric", "int_ior": 1.5}, wavy, wavy)),
                                 "front.vertex_normals", wave(size=0.3), 0.06, 4),
    "lens, index": MovingScene(scene(**window({"type": "dielectric", "int_ior": 1.5}, wavy, wavy)), "glass.eta",
                               constant(1), 0.06, 4),
    # Burley's material.
    **{f"principled, {name}": MovingScene(scene(plane=plane(bsdf=LACQUER), **POINT), f"plane.bsdf.{name}.value",
                                          constant(1), 0.01) for name in ("roughness", "metallic", "clearcoat")},
    "principled glass, spec_trans": MovingScene(
        scene(sheet=plane((0, 0, 0.3), bsdf=LACQUER | {"spec_trans": 0.6}), behind=bright_plane(9, (0, 0, -4.0), angle=20)),
        "sheet.bsdf.spec_trans.value", constant(1), 0.38),
    # The camera.
    "camera shifted": MovingScene(scene(**FLOOR, **POINT), "sensor.to_world", rigid(SHIFT), 0.005),
    "camera turned": MovingScene(scene(**FLOOR, **POINT), "sensor.to_world", rigid(TURN, (0.5, -0.4, 2.6)), 0.005),
    "camera in a room": MovingScene(scene(**ROOM), "sensor.to_world", rigid(TWIST, (0.5, -0.4, 2.6)), 0.005, 3),
    "camera without perspective": MovingScene(
        scene(sensor=parallel() | {"film": camera()["film"]}, **FLOOR, **POINT), "sensor.to_world",
        rigid(TWIST, (0.5, -0.4, 2.6)), 0.005),
    "principal point x": MovingScene(scene(**FLOOR, **POINT), "sensor.principal_point_offset_x", constant(1), 0.005),
    "principal point y": MovingScene(scene(**FLOOR, **SKY), "sensor.principal_point_offset_y", constant(1), 0.005),
    **of_camera(blurred(SIZE, 40) | VIEW, "thinlens", {"to_world": 0.005, "x_fov": 0.5}),
    **of_camera(blurred(SIZE, 40) | VIEW | {"focus_distance": 1.5, "aperture_radius": 0.2}, "thinlens",
                {"aperture_radius": 0.01, "focus_distance": 0.03}, fine=4.0),
    **of_camera(calibrated(SIZE, 0.8) | VIEW, "calibrated", {
        "to_world": 0.005, "fx": 0.05, "fy": 0.05, "cx": 0.05, "cy": 0.05, "skew": 0.05, "k1": 0.01, "k2": 0.01, "k3": 0.01,
        "k4": 0.01, "k5": 0.01, "k6": 0.01, "p1": 0.003, "p2": 0.003}),
    **of_camera(calibrated(SIZE, 0.6, **FISHEYE) | VIEW, "fisheye", {"fx": 0.05, "k1": 0.01, "k4": 0.01}),
    **of_camera(calibrated(SIZE, 0.6, **THIN_PRISM) | VIEW, "thin prism", {"k1": 0.01, "sx1": 0.003, "sy1": 0.003}),
    **of_camera(calibrated(SIZE, 0.8, **FIELD_OF_VIEW) | VIEW, "field of view", {"omega": 0.02}),
    # Other shapes.
    **of_mesh(plane() | {"type": "cube", "to_world": rotate(TILT, ANGLE) @ translate((0, 0, -1)) @ scale((HALF, HALF, 1))},
              "cube"),
    **{name: moving for suffix in ("obj", "ply", "serialized") for name, moving in of_mesh(
        mesh_of_file(suffix), suffix).items()},
    "disk turned": MovingScene(scene(disk=plane(type="disk", bsdf=diffuse(0.5, 0.6, 0.7)), **POINT), "disk.to_world",
                               rigid(TWIST), 0.005),
    "sphere turned": MovingScene(
        scene(ball={"type": "sphere", "radius": 4.0, "flip_normals": True, "bsdf": diffuse(0.5, 0.6, 0.7),
                    "to_world": rotate(TILT, ANGLE) @ scale((1, 1.3, 0.9))}, **POINT), "ball.to_world", rigid(TWIST), 0.005),
    "distances turned": MovingScene(scene(hills=relief(), **POINT), "hills.to_world", rigid(TWIST), 0.005),
    # By less than what changes the pattern of triangles, which the derivative does not see: it is 0.2% of the slope.
    "distances": MovingScene(scene(hills=relief(), **POINT), "hills.grid", wave(size=0.3), 0.001),
    "field of view": MovingScene(scene(sensor=camera(rfilter="box"), **FLOOR, **POINT), "sensor.x_fov", constant(1), 0.25),
    # Silhouettes and creases in view. Light comes from all around, or from behind the camera, so that no shadow moves.
    "outline of a cube": MovingScene(scene(solid=SOLID, **SKY), "solid.to_world", rigid(TWIST), 0.01),
    "outline of a cube, camera": MovingScene(scene(solid=SOLID, **SKY), "sensor.to_world", rigid(TWIST, (0.5, -0.4, 2.6)),
                                             0.005),
    "outline of a mesh": MovingScene(scene(sheet=grid_mesh(wavy, 6, 0.7, bsdf=diffuse(0.7, 0.5, 0.3)), **SKY),
                                     "sheet.vertex_positions", wave(size=0.3), 0.02),
    "outline of a ball": MovingScene(
        scene(ball={"type": "sphere", "center": [0.1, 0.2, 0.0], "radius": 0.6, "bsdf": METAL}, sky=envmap()),
        "ball.to_world", rigid(TWIST), 0.01, samplings=("hybrid",)),
    "outline of an instance": MovingScene(
        scene(group={"type": "shapegroup", "solid": SOLID}, shown={
            "type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": rotate((0.1, 1, 0.3), 20)}, **SKY),
        "shown.to_world", rigid(TWIST), 0.01),
    "one before another": MovingScene(
        scene(near={"type": "rectangle", "to_world": translate((0.4, 0, 1.0)) @ scale((0.3, 0.4, 1)), "bsdf": diffuse(0.6)},
              far={"type": "rectangle", "to_world": rotate(TILT, ANGLE) @ scale((0.6, 0.5, 1)),
                   "emitter": {"type": "area", "radiance": rgb(2, 3, 4)}}, **SKY), "near.to_world",
        rigid(TWIST, (0.4, 0, 1.0)), 0.005),
    "where walls meet": MovingScene(scene(book=BOOK, **POINT), "sensor.to_world", rigid(TWIST, (0.5, -0.4, 2.6)), 0.005),
    "outline, thinlens": MovingScene(
        scene(sensor=blurred(SIZE, 40) | VIEW | {"focus_distance": 1.5, "aperture_radius": 0.2}, solid=SOLID, **SKY),
        "sensor.aperture_radius", constant(1), 0.02, samplings=("hybrid",)),
    "outline, fisheye": MovingScene(scene(sensor=calibrated(SIZE, 0.6, **FISHEYE) | VIEW, solid=SOLID, **SKY),
                                    "sensor.to_world", rigid(TWIST, (0.5, -0.4, 2.6)), 0.01, samplings=("hybrid",)),
    "outline without perspective": MovingScene(
        scene(sensor=parallel() | {"film": camera()["film"]}, solid=SOLID, **SKY), "sensor.to_world",
        rigid(TWIST, (0.5, -0.4, 2.6)), 0.005),
}
