"""The image of the recipe `camera_intrinsics`, whose rays `assets/make_distorted_target.py` made without this package."""

from pathlib import Path

import pytest
import torch

import torch_radbp as rb
from torch_radbp.formats.image import read_image

ROOM = Path(__file__).parents[2] / "assets" / "calibrated_room"
PASSES, SPP, BLOCK = 8, 8, 8  # pixels along a side of a block


def chi_square(scene: rb.Scene) -> float:
    """The mean square of the distances between means of blocks of pixels, by the standard errors of our passes.

    That is 7 / 5 where the images agree, the variance of Student's t of 7 degrees of freedom, and a little for the target's
    noise.
    """
    target = read_image(ROOM / "target.exr").movedim(-1, 0)
    assert target.isfinite().all() and target.mean() > 0.05
    with torch.no_grad():
        images = torch.stack([rb.render(scene, spp=SPP, seed=seed)[0] for seed in range(PASSES)])
    images, target = torch.nn.functional.avg_pool2d(images, BLOCK), torch.nn.functional.avg_pool2d(target, BLOCK)
    error = (images.var(0) / PASSES).sqrt()
    return ((images.mean(0) - target) / error).square().mean().item()


@pytest.fixture
def room() -> rb.Scene:
    return rb.load(ROOM / "scene.xml")


def test_our_camera_sees_what_the_formulas_of_opencv_say(room):
    assert chi_square(room) < 1.8


CHANGES = {"fx": 0.5, "cy": 0.2, "k1": 0.01, "k2": 0.03, "p1": -0.002, "p2": 0.002}


@pytest.mark.parametrize(("name", "change"), CHANGES.items())
def test_the_target_tells_every_kind_of_intrinsic(name, change, room):
    with torch.no_grad():
        getattr(room.sensor, name).add_(change)
    assert chi_square(room) > 3.0
