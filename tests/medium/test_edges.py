"""Edges that the camera sees through media: derivatives of what moves there are those of differences."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes import rgb
from tests.scenes.media_rows import cells, even, sensor, smoke
from torch_radbp.io.values.transform import scale

SIZE, BATCHES, STEP = 12, 10, 0.02
BLACK = {"type": "diffuse", "reflectance": rgb(0, 0, 0)}
MEDIA = {"even": even((0.5, 1.0, 2.0), (0.0, 0.0, 0.0)), "smoke": smoke(cells(largest=1.0), (0.0, 0.0, 0.0)),
         "scattering": even((0.5, 1.0, 2.0))}
CENTERS = {"within": [0.15, 0.1, 0.2], "behind": [0.15, 0.1, -1.2], "before the camera": [0.1, 0.0, -0.4]}
DEEP = pytest.mark.deep
CASES = [("smoke", "within", 2, 24), ("scattering", "within", 1, 24),  # medium, where the ball is, depth, samples
         pytest.param("even", "within", 2, 256, marks=DEEP),
         pytest.param("even", "behind", 2, 256, marks=DEEP), pytest.param("even", "before the camera", 2, 256, marks=DEEP)]


def scene_of(medium: str, place: str, depth: int) -> rb.Scene:
    """A glowing ball in or behind a cube of a medium, or before a camera in it, under an even sky."""
    inside = place == "before the camera"
    camera = sensor(SIZE, (0.0, 0.1, 0.5), (0.2, 0.0, -1.5), 60) if inside else sensor(SIZE)
    camera["film"] = camera["film"] | {"rfilter": {"type": "gaussian"}}
    return rb.load_dict({
        "type": "scene", "integrator": {"type": "volpath", "max_depth": depth},
        "camera": camera | ({"medium": MEDIA[medium]} if inside else {}),
        "sky": {"type": "constant", "radiance": rgb(0.6, 0.8, 1.0)},
        "cube": {"type": "cube", "to_world": scale((0.75,) * 3), "bsdf": {"type": "null"}, "interior": MEDIA[medium]},
        "ball": {"type": "sphere", "center": CENTERS[place], "radius": 0.3, "bsdf": BLACK,
                 "emitter": {"type": "area", "radiance": rgb(20, 20, 20)}}})


def functional(image: Tensor, medium: str) -> Tensor:
    """(C,) the mean of each colour, weighted from left to right; of smoke, which is the same to all colours, of one."""
    return (image[0, :1 if medium == "smoke" else 3].double() * torch.linspace(0, 8, SIZE)).mean((1, 2))


def gradient(renderer: rb.Renderer, medium: str, pose: Tensor, seed: int) -> Tensor:
    """(C,) by the place of the ball along x."""
    colours = functional(renderer(seed=seed), medium)
    return torch.stack([torch.autograd.grad(colour, pose, retain_graph=True)[0][0, 3] for colour in colours])


@torch.no_grad()
def difference(renderer: rb.Renderer, medium: str, pose: Tensor, seed: int) -> Tensor:
    """(C,) the same by two renderings, with the same samples."""
    pose[0, 3] += STEP
    ahead = functional(renderer(seed=seed, spp=4 * renderer.spp), medium)
    pose[0, 3] -= 2 * STEP
    behind = functional(renderer(seed=seed, spp=4 * renderer.spp), medium)
    pose[0, 3] += STEP
    return (ahead - behind) / (2 * STEP)


@pytest.mark.parametrize(("medium", "place", "depth", "spp"), CASES)
def test_what_moves_behind_media_has_the_derivatives_of_differences(medium, place, depth, spp):
    scene = scene_of(medium, place, depth)
    pose, renderer = scene.ball.to_world.requires_grad_(), rb.Renderer(scene, spp=spp)
    found = [gradient(renderer, medium, pose, seed) for seed in range(BATCHES)]
    expected = [difference(renderer, medium, pose, seed) for seed in range(BATCHES, 3 * BATCHES)]
    (found, error), (expected, of_difference) = ((values.mean(0), values.std(0) / len(values)**0.5)
                                                 for values in map(torch.stack, (found, expected)))
    assert expected.isfinite().all() and (expected > 5 * of_difference).all()
    assert (error < 0.15 * expected).all()
    apart = (found - expected).abs() / torch.hypot(error, of_difference)
    assert (apart < 3.5).all(), (found, expected, apart)
