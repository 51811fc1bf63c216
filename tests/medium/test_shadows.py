"""Shadows in media, and what is seen there by surfaces: derivatives of what moves are those of differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes import rgb
from tests.scenes.media_rows import cells, even, sensor, smoke
from torch_radbp.io.values.transform import scale

SIZE, STEP = 12, 0.02
BLACK, GREY = {"type": "diffuse", "reflectance": rgb(0, 0, 0)}, {"type": "diffuse", "reflectance": rgb(0.6, 0.5, 0.4)}
FOG, FORWARDS = even((0.3, 0.4, 0.5), (0.9, 0.8, 0.9)), {"phase_function": {"type": "hg", "g": 0.5}}
MEDIA = {"fog": FOG, "haze": even((0.3, 0.4, 0.5), (0.9, 0.8, 0.9)) | FORWARDS, "smoke": smoke(cells(largest=3.0)),
         "dye": even((0.3, 0.6, 1.2), (0.0, 0.0, 0.0)), "clear": even(0.0)}
DEEP = pytest.mark.deep


class Case(NamedTuple):
    """What moves where in which medium."""

    medium: str
    place: str  # of the medium: around everything, or in a cube
    lamp: str
    ground: bool  # a floor that scatters; else there is none
    depth: int
    moves: str = "ball"
    spp: int = 256
    batches: int = 12  # of gradients, and half of those of differences

    def __str__(self) -> str:
        return "-".join(map(str, self))


def lamp_of(kind: str) -> dict[str, Any]:
    """A light from above, or all around."""
    if kind == "sky":
        return {"type": "constant", "radiance": rgb(0.6, 0.8, 1.0)}
    if kind == "bulb":
        return {"type": "point", "position": [0.1, 0.95, 0.0], "intensity": rgb(3, 3, 3)}
    if kind == "sun":
        return {"type": "directional", "direction": [0.3, -1.0, -0.2], "irradiance": rgb(3, 3, 3)}
    pose = torch.tensor([[0.4, 0, 0, 0.1], [0, 0, -1.0, 0.95], [0, 0.4, 0, 0], [0, 0, 0, 1]])
    return {"type": "rectangle", "to_world": pose, "bsdf": BLACK, "emitter": {"type": "area", "radiance": rgb(6, 5, 4)}}


def scene_of(case: Case) -> rb.Scene:
    """A black ball before a lamp, in a medium."""
    camera = sensor(SIZE, (0.0, 0.1, 2.2), (0.0, 0.0, 0.0), 50)
    camera["film"] = camera["film"] | {"rfilter": {"type": "gaussian"}}
    medium = MEDIA[case.medium]
    scene = {"type": "scene", "integrator": {"type": "volpath", "max_depth": case.depth},
             "camera": camera | ({"medium": medium} if case.place == "around" else {}), "lamp": lamp_of(case.lamp),
             "ball": {"type": "sphere", "center": [0.1, 0.25, 0.0], "radius": 0.25, "bsdf": BLACK}}
    if case.place == "cube":
        scene["cube"] = {"type": "cube", "to_world": scale((0.7,) * 3), "bsdf": {"type": "null"}, "interior": medium}
    if case.ground:
        pose = torch.tensor([[1.0, 0, 0, 0], [0, 0, 1.0, -0.5], [0, -1.0, 0, 0], [0, 0, 0, 1]])
        scene["floor"] = {"type": "rectangle", "to_world": pose, "bsdf": GREY}
    return rb.load_dict(scene)


def functional(image: Tensor) -> Tensor:
    """() the mean, weighted from left to right."""
    return (image[0].double() * torch.linspace(0, 8, SIZE)).mean()


def with_errors(batches: list[Tensor]) -> tuple[float, float]:
    """The mean of batches, and its standard error."""
    values = torch.stack(batches)
    return float(values.mean()), float(values.std()) / len(values)**0.5


@torch.no_grad()
def difference(render: Callable[[int], Tensor], pose: Tensor, seed: int) -> Tensor:
    """() by two renderings with the same samples."""
    found = []
    for step in (STEP, -STEP):
        pose[0, 3] += step
        found.append(functional(render(seed)))
        pose[0, 3] -= step
    return (found[0] - found[1]) / (2 * STEP)


@pytest.mark.parametrize("case", [
    Case("fog", "around", "panel", False, 2, spp=128),
    Case("fog", "cube", "bulb", True, 2, spp=32, batches=8),
    *(pytest.param(case, marks=DEEP) for case in [
        Case("fog", "around", "bulb", False, 2), Case("fog", "cube", "sun", False, 2),
        Case("fog", "cube", "panel", False, 2, spp=4096), Case("smoke", "cube", "bulb", True, 3, spp=3072),
        Case("dye", "cube", "panel", True, 2, spp=1024), Case("dye", "cube", "bulb", True, 3, spp=2048),
        Case("clear", "cube", "panel", True, 2, spp=1024), Case("haze", "around", "panel", True, 4, spp=2048),
        Case("haze", "cube", "panel", True, 4, spp=2048), Case("fog", "cube", "sky", True, 3, spp=2048),
        Case("fog", "around", "bulb", False, 3, spp=1024), Case("haze", "cube", "bulb", True, 3, spp=4096),
        Case("fog", "cube", "panel", False, 3, "lamp"), Case("fog", "cube", "panel", False, 3, "camera"),
        Case("smoke", "cube", "panel", True, 3, "camera")])], ids=str)
def test_shadows_in_media_have_the_derivatives_of_differences(case):
    scene = scene_of(case)
    pose, renderer = getattr(scene, case.moves).to_world.requires_grad_(), rb.Renderer(scene, spp=case.spp)
    found, error = with_errors([torch.autograd.grad(functional(renderer(seed=seed)), pose)[0][0, 3].double()
                                for seed in range(case.batches)])
    expected, of_difference = with_errors([difference(lambda seed: renderer(seed=seed, spp=4 * case.spp), pose, seed)
                                           for seed in range(case.batches, 3 * case.batches)])
    assert abs(expected) > 8 * of_difference and error < 0.15 * abs(expected)
    assert abs(found - expected) < 3.5 * (error**2 + of_difference**2)**0.5
