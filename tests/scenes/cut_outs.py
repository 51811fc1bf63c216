"""Scenes in which light of lamps reaches a floor through holes, panes and surfaces that are not there, from below which the
camera looks at the floor."""

from __future__ import annotations

from typing import Any

import torch

from tests.scenes import rgb, sensor
from tests.scenes.inner_jumps import noise
from tests.scenes.moving import TWIST, MovingScene, rigid, wave
from tests.scenes.shadows import BALL, LAMPS, PUSH, SIZE, TWO_SIDED, WALL, lit, moved
from torch_radbp.io.values.transform import rotate, scale, translate

VIEWED = sensor(SIZE, (0.3, -1.0, 0.7), (0.05, 0.1, 0.0), 50, rfilter="box")
LAMP = {"type": "rectangle", "to_world": translate((0.2, 0.15, 1.6)) @ rotate((1, 0.2, 0.1), 170) @ scale((0.6, 0.5, 1)),
        "emitter": {"type": "area", "radiance": rgb(8, 7, 9)}}
OPAQUE = noise(4, 6, 1)[..., 0] > 0.5
TEXELS = {"type": "bitmap", "bitmap": OPAQUE[..., None].float(), "filter_type": "nearest", "raw": True}
SQUARES = {"type": "checkerboard", "color0": 0.0, "color1": 1.0, "to_uv": rotate((0, 0, 1), 20) @ scale((2.3, 1.7, 1))}
POSE = translate((0.1, 0.05, 0.9)) @ rotate((1, 0.3, 0.2), 10) @ scale((1.2, 1.0, 1))
PUSHED = {"sheet": rigid(TWIST, (0.1, 0.05, 0.9)), "lamp": rigid(TWIST, (0.2, 0.15, 1.6)), "floor": PUSH["floor"],
          "sensor": rigid(TWIST, (0.3, -1.0, 0.7))}


def masked(opacity: dict[str, Any]) -> dict[str, Any]:
    """A material with holes."""
    return {"type": "mask", "opacity": opacity, "nested_bsdf": TWO_SIDED}


def sheet(bsdf: dict[str, Any], height: float = 0.9) -> dict[str, Any]:
    """Between the lamp and the floor."""
    return {"type": "rectangle", "to_world": translate((0, 0, height - 0.9)) @ POSE, "bsdf": bsdf}


def sheet_with_holes() -> dict[str, Any]:
    """The same as one of `TEXELS`, as a mesh of the opaque ones."""
    y, x = (place.flatten() for place in torch.meshgrid(torch.linspace(-1, 1, 5), torch.linspace(-1, 1, 7), indexing="ij"))
    corners = [7 * row + column for row, column in OPAQUE.nonzero().tolist()]
    faces = [face for a in corners for face in ([a, a + 1, a + 8], [a, a + 8, a + 7])]
    return {"type": "mesh", "vertex_positions": torch.stack([x, y, torch.zeros_like(x)], 1).double(), "to_world": POSE,
            "faces": torch.tensor(faces), "bsdf": TWO_SIDED}


def seen(lamp: dict[str, Any] | str, **objects: Any):
    """What hangs between a lamp and a floor, from below."""
    return lit(lamp, sensor=VIEWED, **objects)


def of_everything(label: str, build) -> dict[str, MovingScene]:
    """Everything in a scene moves in turn."""
    return {f"{name}, {label}": moved(build, f"{name}.to_world", push, 3) for name, push in PUSHED.items()}


LEAF_OF_MESH = {"type": "mesh", "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]), "bsdf": masked(TEXELS), "vertex_positions":
                torch.tensor([[-1.1, -0.9, 0.85], [1.2, -1.0, 0.95], [1.1, 1.1, 0.9], [-1.0, 1.0, 1.0]]).double(),
                "vertex_texcoords": torch.tensor([[0, 0], [1, 0], [1, 1], [0, 1]]).double()}
GROUP = {"group": {"type": "shapegroup", "solid": {"type": "rectangle", "bsdf": masked(TEXELS)}},
         "shown": {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": POSE}}
PANE = {"type": "thindielectric", "int_ior": 1.5}
ABOVE = BALL | {"to_world": translate((0.2, 0.1, 1.7)) @ scale((0.5, 0.5, 0.5))}
CUT_OUTS: dict[str, MovingScene] = {
    **of_everything("texels", seen(LAMP, sheet=sheet(masked(TEXELS)))),
    "sheet, squares": moved(seen(LAMP, sheet=sheet(masked(SQUARES))), "sheet.to_world", PUSHED["sheet"], 3),
    "lamp, squares": moved(seen(LAMP, sheet=sheet(masked(SQUARES))), "lamp.to_world", PUSHED["lamp"], 3),
    "lamp behind a pane": moved(seen(LAMP, sheet=sheet(PANE)),
                                "lamp.to_world", PUSHED["lamp"], 3),
    "vertices of a sheet": moved(seen(LAMP, sheet=LEAF_OF_MESH), "sheet.vertex_positions", wave(size=0.5), 3),
    "instance": moved(seen(LAMP, **GROUP), "shown.to_world", PUSHED["sheet"], 3),
    "ball before a sky": moved(seen(LAMPS["constant"], sheet=sheet(masked(TEXELS)), ball=ABOVE), "ball.to_world",
                               rigid(TWIST, (0.2, 0.1, 1.7)), 3),
    "sheet, four bounces": moved(seen(LAMP, sheet=sheet(masked(TEXELS)), wall=WALL), "sheet.to_world", PUSHED["sheet"], 4),
    "lamp behind two sheets": moved(seen(LAMP, sheet=sheet(masked(TEXELS)), other=sheet({"type": "null"}, 1.1)),
                                    "lamp.to_world", PUSHED["lamp"], 4),
}
