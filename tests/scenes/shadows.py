"""Scenes in which borders of shadows move: lights, what casts them, what they fall on, cameras; direct and indirect.

Everything is turned by odd angles, and meets nothing else.
"""

from __future__ import annotations

from typing import Any

import torch

from tests.scenes import diffuse, look_at, rgb, sensor
from tests.scenes.endless import envmap, smooth_noise, textured
from tests.scenes.moving import METAL, TWIST, MovingScene, constant, rigid, scene, wave
from tests.scenes.parts import FISHEYE, blurred, calibrated, parallel
from torch_radbp.io.values.transform import rotate, scale, translate

SIZE = 16
FINE, MIDDLE, COARSE = 0.005, 0.01, 0.02  # steps of differences; where much moves in view, or sharply, they bend sooner
ABOVE, ASIDE = (0.3, 0.1, 2.0), (0.3, -2.1, 2.5)  # places of lamps
VIEWED = sensor(SIZE, (0.3, -3.0, 2.6), (0.05, 0.1, 0.1), 40, rfilter="box")
FLOOR = {"type": "rectangle", "to_world": rotate((0.2, 1, 0.1), 4) @ scale((6, 6, 1)), "bsdf": textured(half=6.0)}
WALL = {"type": "rectangle", "to_world": translate((0, 1.6, 1.2)) @ rotate((1, 0.05, 0.02), 85) @ scale((1.5, 1.2, 1)),
        "bsdf": diffuse(0.8, 0.7, 0.9)}
FLOOR_MIRROR = {"type": "rectangle", "bsdf": {"type": "conductor"},
                "to_world": translate((0, 2.2, 0.9)) @ rotate((1, 0.03, 0.02), 88) @ scale((3, 1.4, 1))}
TWO_SIDED = {"type": "twosided", "one": diffuse(0.5, 0.6, 0.4)}
PLATE_POSE = translate((0.1, 0.05, 0.6)) @ rotate((1, 0.3, 0.2), 25) @ scale((0.35, 0.2, 1))
PLATE = {"type": "rectangle", "to_world": PLATE_POSE, "bsdf": TWO_SIDED}
CUBE = {"type": "cube", "to_world": translate((0.1, 0.1, 0.5)) @ rotate((1, 0.7, 0.4), 35) @ scale((0.25, 0.2, 0.15)),
        "bsdf": diffuse(0.5, 0.6, 0.4)}
BALL = {"type": "sphere", "to_world": translate((0.1, 0.1, 0.5)) @ scale((0.3, 0.3, 0.3)), "bsdf": diffuse(0.5, 0.6, 0.4)}
LAMPS: dict[str, dict[str, Any]] = {
    "rectangle": {"type": "rectangle", "to_world": translate(ABOVE) @ rotate((1, 0.1, 0), 175) @ scale((0.3, 0.25, 1)),
                  "emitter": {"type": "area", "radiance": rgb(8, 7, 9)}},
    "ball": {"type": "sphere", "to_world": translate(ABOVE) @ scale((0.2, 0.2, 0.2)),
             "emitter": {"type": "area", "radiance": rgb(8, 7, 9)}},
    "point": {"type": "point", "position": list(ABOVE), "intensity": rgb(8, 7, 9)},
    "spot": {"type": "spot", "to_world": look_at(ABOVE, (0.1, 0.05, 0), (0, 1, 0)), "cutoff_angle": 40,
             "intensity": rgb(8, 7, 9)},
    "directional": {"type": "directional", "to_world": look_at((0, 0, 0), (0.15, 0.2, -1.0), (0, 1, 0)),
                    "irradiance": rgb(3, 2, 4)},
    "constant": {"type": "constant", "radiance": rgb(0.9, 1.1, 1.4)},
    "envmap": envmap() | {"bitmap": 0.3 * smooth_noise(5, 0.05, 3.0, (24, 48), 2.5), "to_world": rotate((1, 0, 0), 90)},
}
PUSH = {"plate": rigid(TWIST, (0.1, 0.05, 0.6)), "cube": rigid(TWIST, (0.1, 0.1, 0.5)), "lamp": rigid(TWIST, ABOVE),
        "camera": rigid(TWIST, (0.3, -3.0, 2.6)), "floor": rigid(TWIST, (0.0, 0.0, 0.0))}


def bend(size: float):
    """Tangents of vertex positions (V, 3): sine waves of the positions, so that vertices at one place stay together."""
    def direction(value: torch.Tensor) -> torch.Tensor:
        phase = torch.arange(3, dtype=value.dtype)
        return size * torch.sin(3.1 * value.roll(1, 1) + 2.3 * value.roll(2, 1) + 1.7 * phase)

    return direction


def lit(lamp: str | dict[str, Any], max_depth: int = 2, **objects: Any):
    """A floor under a lamp, and what stands between."""
    lamp = LAMPS[lamp] if isinstance(lamp, str) else lamp
    return scene(**{"sensor": VIEWED, "floor": FLOOR, "lamp": lamp} | objects)


def moved(build, name: str, direction, max_depth: int = 2) -> MovingScene:
    """With the samplings that have shadows."""
    sharp = any(emitter.kind().delta for emitter in build().emitters)
    step = FINE if name.startswith(("sensor", "floor", "wall", "mirror")) else MIDDLE if sharp else COARSE
    return MovingScene(build, name, direction, step, max_depth, ("hybrid",))


def under_each_lamp() -> dict[str, MovingScene]:
    """A plate between each lamp and a floor; each of them moves, and the camera."""
    found = {}
    for lamp in LAMPS:
        build = lit(lamp, plate=PLATE)
        found[f"plate, {lamp}"] = moved(build, "plate.to_world", PUSH["plate"])
        found[f"floor, {lamp}"] = moved(build, "floor.to_world", PUSH["floor"])
        found[f"camera, {lamp}"] = moved(build, "sensor.to_world", PUSH["camera"])
        if lamp == "point":
            found[f"lamp, {lamp}"] = moved(build, "lamp.position", constant(0.4, 0.3, 0.5))
        elif lamp not in ("constant", "envmap"):
            found[f"lamp, {lamp}"] = moved(build, "lamp.to_world", PUSH["lamp"])
    return found


def before_a_wall(lamp: dict[str, Any], label: str, depth: int = 3) -> dict[str, MovingScene]:
    """A wall that lights a floor, a plate before it: shadows of light that has been scattered before, or is again."""
    plate = PLATE | {"to_world": translate((0.1, 0.65, 0.6)) @ rotate((1, 0.3, 0.2), 65) @ scale((0.4, 0.3, 1))}
    build = lit(lamp, wall=WALL, plate=plate)
    moving = {"plate": ("plate.to_world", PUSH["plate"]), "wall": ("wall.to_world", rigid(TWIST, (0, 1.6, 1.2))),
              "camera": ("sensor.to_world", PUSH["camera"]), "lamp": ("lamp.to_world", rigid(TWIST, ASIDE)),
              "floor": ("floor.to_world", PUSH["floor"])}
    return {f"{name} before a wall, {label}": moved(build, *given, max_depth=depth) for name, given in moving.items()}


def in_a_mirror() -> dict[str, MovingScene]:
    """A floor under a lamp, seen in a mirror alone, which shows the shadow of a plate, but not the plate: its edges jump."""
    view = sensor(SIZE, (0.3, 0.6, 2.2), (0.15, 2.2, 0.95), 24, rfilter="box")
    build = lit("rectangle", sensor=view, mirror=FLOOR_MIRROR, plate=PLATE)
    moving = {"plate": ("plate.to_world", PUSH["plate"]), "lamp": ("lamp.to_world", PUSH["lamp"]),
              "floor": ("floor.to_world", PUSH["floor"]), "mirror": ("mirror.to_world", rigid(TWIST, (0, 2.2, 0.9))),
              "camera": ("sensor.to_world", rigid(TWIST, (0.3, 0.6, 2.2)))}
    return {f"{name}, shadow in a mirror": moved(build, *given, max_depth=3) for name, given in moving.items()}


SPOT_ASIDE = {"type": "spot", "to_world": look_at(ASIDE, (0.2, 1.6, 1.3), (0, 0, 1)), "cutoff_angle": 20,
              "intensity": rgb(60, 50, 55)}
LAMP_ASIDE = {"type": "rectangle", "to_world": look_at((0.3, -1.1, 2.5), (0.2, 1.6, 1.0), (0, 0, 1)) @ scale((0.3, 0.3, 1)),
              "emitter": {"type": "area", "radiance": rgb(12, 11, 13)}}
GROUP = {"group": {"type": "shapegroup", "solid": CUBE | {"to_world": scale((0.25, 0.2, 0.15))}}, "shown": {
    "type": "instance", "group": {"type": "ref", "id": "group"},
    "to_world": translate((0.1, 0.1, 0.5)) @ rotate((1, 0.7, 0.4), 35)}}
PANE = {"type": "rectangle", "to_world": translate((0.1, -0.3, 1.0)) @ rotate((1, 0, 0.1), 20) @ scale((1.0, 0.9, 1)),
        "bsdf": {"type": "roughdielectric", "alpha": 0.3, "int_ior": 1.3}}
UNSAMPLED = LAMPS["rectangle"] | {"emitter": LAMPS["rectangle"]["emitter"] | {"sampling_weight": 0.0}}
MANY = {f"lamp_{k}": {"type": "point", "position": [0.6 * k - 2.0, 0.3 * (k % 3), 2.0 + 0.1 * k],
                      "intensity": rgb(2 + k % 2, 2, 1 + k % 3)} for k in range(9)}
MESH_PLATE = {"type": "mesh", "bsdf": TWO_SIDED, "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]), "vertex_positions":
              torch.tensor([[-0.2, -0.2, 0.5], [0.5, -0.1, 0.6], [0.4, 0.3, 0.7], [-0.3, 0.2, 0.8]], dtype=torch.float64)}
SHADOWS: dict[str, MovingScene] = {
    **under_each_lamp(),
    **before_a_wall(SPOT_ASIDE, "spot"), **before_a_wall(LAMP_ASIDE, "rectangle"),
    **{f"{name}, four bounces": found for name, found in before_a_wall(LAMP_ASIDE, "rectangle", 4).items()},
    "vertices of a plate, rectangle": moved(lit("rectangle", plate=MESH_PLATE), "plate.vertex_positions", wave(size=0.5)),
    "vertices of a plate, point": moved(lit("point", plate=MESH_PLATE), "plate.vertex_positions", wave(size=0.5)),
    "cube, rectangle": moved(lit("rectangle", cube=CUBE), "cube.to_world", PUSH["cube"]),
    "vertices of a cube, directional": moved(lit("directional", cube=CUBE), "cube.vertex_positions", bend(0.4)),
    "instance, rectangle": moved(lit("rectangle", **GROUP), "shown.to_world", PUSH["cube"]),
    "instance, point": moved(lit("point", **GROUP), "shown.to_world", PUSH["cube"])._replace(step=FINE),
    "floor under an instance, spot": moved(lit("spot", **GROUP), "floor.to_world", PUSH["floor"]),
    "ball, rectangle": moved(lit("rectangle", ball=BALL), "ball.to_world", PUSH["cube"]),
    "plate of metal, point": moved(lit("point", plate=PLATE | {"bsdf": {"type": "twosided", "one": METAL}}),
                                   "plate.to_world", PUSH["plate"]),
    "floor of metal, rectangle": moved(lit("rectangle", plate=PLATE, floor=FLOOR | {"bsdf": METAL | {"alpha": 0.4}}),
                                       "plate.to_world", PUSH["plate"]),
    "camera without perspective, point": moved(lit("point", plate=PLATE, sensor=parallel() | {
        "film": VIEWED["film"], "to_world": VIEWED["to_world"] @ scale((1.2, 1.2, 1))}), "sensor.to_world", PUSH["camera"]),
    "thin lens, point": moved(lit("point", plate=PLATE, sensor=blurred(SIZE, 40) | {
        name: VIEWED[name] for name in ("to_world", "film")} | {"focus_distance": 3.9, "aperture_radius": 0.1}),
        "sensor.to_world", PUSH["camera"]),
    "fisheye, directional": moved(lit("directional", plate=PLATE, sensor=calibrated(SIZE, 0.8, **FISHEYE) | {
        name: VIEWED[name] for name in ("to_world", "film")}), "plate.to_world", PUSH["plate"]),
    "a window of a film, gaussian": moved(lit("point", plate=PLATE, sensor=VIEWED | {"film": {
        "type": "hdrfilm", "width": 24, "height": 24, "crop_width": SIZE, "crop_height": SIZE, "crop_offset_x": 4,
        "crop_offset_y": 5, "rfilter": {"type": "gaussian"}}}), "plate.to_world", PUSH["plate"]),
    "many lamps": moved(scene(sensor=VIEWED, floor=FLOOR, plate=PLATE, **MANY), "plate.to_world", PUSH["plate"]),
    "two lamps of different kinds": moved(lit("rectangle", plate=PLATE, other=LAMPS["point"] | {
        "position": [-0.8, 0.5, 1.8], "intensity": rgb(4, 3, 2)}), "plate.to_world", PUSH["plate"]),

    **in_a_mirror(),
    # Light that no light sample finds.
    "plate, compensated envmap": moved(lit(LAMPS["envmap"] | {"mis_compensation": True}, plate=PLATE), "plate.to_world",
                                       PUSH["plate"]),
    "plate, rectangle of weight 0": moved(lit(UNSAMPLED, plate=PLATE, sky=LAMPS["constant"] | {"radiance": rgb(0, 0, 0)}),
                                          "plate.to_world", PUSH["plate"]),
    "attached, point": moved(lit("point", plate=PLATE), "plate.to_world", PUSH["plate"])._replace(
        samplings=("hybrid", "attached", "detached")),
    # Directions that carry derivatives slide over edges.
    **{f"attached, {name}": found._replace(samplings=("attached",)) for name, found in {
        "plate under a rectangle": moved(lit("rectangle", plate=PLATE), "plate.to_world", PUSH["plate"]),
        "lamp": moved(lit("rectangle", plate=PLATE), "lamp.to_world", PUSH["lamp"]),
        "camera": moved(lit("rectangle", plate=PLATE), "sensor.to_world", PUSH["camera"]),
        "plate under a sky": moved(lit("constant", plate=PLATE), "plate.to_world", PUSH["plate"]),
        "floor under a sky": moved(lit("constant", plate=PLATE), "floor.to_world", PUSH["floor"]),
        "plate under an environment": moved(lit("envmap", plate=PLATE), "plate.to_world", PUSH["plate"]),
        "floor of metal": moved(lit("envmap", plate=PLATE, floor=FLOOR | {"bsdf": METAL | {"alpha": 0.2}}), "plate.to_world",
                                PUSH["plate"]),
        "plate of metal": moved(lit("envmap", plate=PLATE | {"bsdf": {"type": "twosided", "one": METAL}}), "floor.to_world",
                                PUSH["floor"]),
        "plate before a wall under a spot": before_a_wall(SPOT_ASIDE, "spot")["plate before a wall, spot"],
        "lamp before a wall": before_a_wall(LAMP_ASIDE, "rectangle")["lamp before a wall, rectangle"],
        "camera before a wall": before_a_wall(LAMP_ASIDE, "rectangle")["camera before a wall, rectangle"],
        "roughness of a floor": moved(lit("envmap", plate=PLATE, floor=FLOOR | {"bsdf": {
            "type": "roughconductor", "alpha": 0.3}}), "floor.bsdf.alpha.value", constant(1.0)),
    }.items()},
    "plate, through rough glass": moved(lit("constant", plate=PLATE, pane=PANE), "plate.to_world", PUSH["plate"], 3),
    "pane, of rough glass": moved(lit("constant", plate=PLATE, pane=PANE), "pane.to_world", PUSH["plate"], 3),
    "roughness of a pane": moved(lit("constant", plate=PLATE, pane=PANE), "pane.bsdf.alpha.value", constant(1.0), 3),
}
