"""What surfaces see of curves along which others pass through each other, against closed forms."""

from __future__ import annotations

import math

import pytest
import torch

from tests.boundary.closed_forms import along, assert_close, derivative
from tests.scenes import diffuse, load, look_at, overhead, rectangle, rgb
from torch_radbp.io.values.transform import scale

LIGHT = torch.tensor([3.0, 2.0, 1.0], dtype=torch.float64)
PIXELS = 2
VIEW = overhead(PIXELS, 1.5, 0.01)


def flux_at_the_origin(height: float) -> torch.Tensor:
    """What a lamp one wide, in the plane y = 1, sends to a level surface at the origin from one unit of height."""
    x = torch.linspace(-0.5, 0.5, 100001, dtype=torch.float64)
    return torch.trapezoid(height / (x * x + 1 + height * height) ** 2, x) * LIGHT


@pytest.mark.parametrize("nee", [True, False])
def test_a_lamp_shines_as_far_up_as_the_ceiling_that_it_passes_through(nee):
    """Raised, the ceiling hides less of the lamp; nothing else ends where the floor sees it."""
    lamp = {"type": "rectangle", "to_world": look_at((0, 1, 2), (0, 0, 2), (0, 0, 1)) @ scale((0.5, 1, 1)),
            "bsdf": diffuse(0.0), "emitter": {"type": "area", "radiance": rgb(*LIGHT.tolist())}}
    scene = load(torch.float64, camera=VIEW, lamp=lamp, floor=rectangle((0, 0, 0), 0.5, bsdf=diffuse(0.7)),
                 ceiling=rectangle((0, 0, 2), 9, bsdf={"type": "twosided", "one": diffuse(0.0)}))
    found = derivative(scene, "ceiling.to_world", along(2), spp=8192, max_depth=2, nee=nee)
    assert_close(found, 0.7 / math.pi * flux_at_the_origin(2.0) * PIXELS**2, 0.03)
