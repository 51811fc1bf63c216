"""Edges that are hidden just inside of other bodies do not count, and what lies just outside of them does, however far the
camera: derivatives are those of differences with samples of their own."""

from __future__ import annotations

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but
from tests.scenes.crossings import CROSSING, SIZE, Crossing

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

SPP, SEEDS, STEP = 256, 8, 0.004  # with three times the step differences are the same but for their noise
QUICK = ("glowing plate through a cube, from 40", "card above a table, from 4")
OFF = 0.01  # of the whole derivative: two curves whose places on the film are as near as rays pass by them are one


def weights() -> torch.Tensor:
    """(H, W) smooth weights of pixels, so that nothing cancels by symmetry."""
    y, x = torch.meshgrid(*(torch.linspace(-1, 1, SIZE, dtype=torch.float64),) * 2, indexing="ij")
    return torch.cos(2 * x + y)


def difference(crossing: Crossing, scene: rb.Scene, seed: int) -> float:
    """The central difference of weighted sums of two images with the same samples."""
    pose = scene.get_parameter(crossing.parameter)
    home, found = pose.detach().clone(), []
    for side in (1, -1):
        pose.data = home + side * STEP * crossing.direction(home)
        found.append(float((rb.render(scene, spp=SPP, seed=seed, max_depth=crossing.depth).detach() * weights()).sum()))
    pose.data = home
    return (found[0] - found[1]) / (2 * STEP)


def derivative(crossing: Crossing, scene: rb.Scene, seed: int) -> torch.Tensor:
    """(H, W) of the image, weighted, the sum over channels."""
    tangent = crossing.direction(scene.get_parameter(crossing.parameter).detach())
    image = rb.jvp(scene, {crossing.parameter: tangent}, spp=SPP, seed=seed, max_depth=crossing.depth)
    return image.sum((0, 1)) * weights()


@pytest.mark.parametrize("name", deep_but(QUICK, CROSSING))
def test_a_body_that_moves_through_another_has_the_derivative_of_differences(name):
    crossing = CROSSING[name]
    scene = crossing.load()
    expected = torch.tensor([difference(crossing, scene, 100 + seed) for seed in range(3 * SEEDS)])
    images = torch.stack([derivative(crossing, scene, seed) for seed in range(SEEDS)])
    found, whole = images.sum((1, 2)), float(images.mean(0).abs().sum())
    noise = float((expected.var() / len(expected) + found.var() / len(found)).sqrt())
    assert noise < 0.01 * whole
    off = abs(float(found.mean() - expected.mean()))
    assert off < 3 * noise + OFF * whole, (found.mean(), expected.mean(), noise, whole)


def test_borders_of_shadows_on_the_surface_of_a_vertex_itself_do_not_count():
    """Where bodies meet, vertices of paths are connected to borders on their own plane: seen edge-on by rounding, one of
    millions made a pixel 20,000 times as large as the largest of other seeds."""
    crossing = CROSSING["plate through a cube over a floor, from 4"]
    scene = crossing.load(torch.float32, 16)
    tangent = crossing.direction(scene.get_parameter(crossing.parameter).detach())
    largest = [float(rb.jvp(scene, {crossing.parameter: tangent}, spp=256, max_depth=4, rr_depth=100, seed=seed).abs().max())
               for seed in (25, 27, 29)]
    assert max(largest) < 2 * min(largest)
