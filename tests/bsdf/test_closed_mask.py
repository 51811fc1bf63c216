"""Direct light on a closed surface with holes: a closed form, where Mitsuba's path tracer is too dark.

Mitsuba 3.9.1, `path`: a path that meets only surfaces with a null lobe, and ends before the last of them is sampled, counts
as one that meets nothing, and what was found at the others is dropped with it. So a ball of opacity a, seen by a path of two
vertices, keeps a of its light. `direct` is right. Where an emitter surrounds the scene, every path counts, and both are.
"""

from __future__ import annotations

import math

import pytest
import torch

import torch_radbp as rb
from tests.scenes import look_at, rgb

OPACITY, REFLECTANCE, DISTANCE = 0.4, 0.7, 3.0


def scene(pose) -> dict:
    """A small patch of a ball, seen from the place of a point light."""
    return {
        "type": "scene", "light": {"type": "point", "position": [0.0, 0.0, 1.0 + DISTANCE], "intensity": rgb(5, 5, 5)},
        "sensor": {"type": "perspective", "fov": 1.0, "to_world": pose,
                   "film": {"type": "hdrfilm", "width": 2, "height": 2, "pixel_format": "rgb", "rfilter": {"type": "box"}}},
        "ball": {"type": "sphere", "bsdf": {"type": "mask", "opacity": OPACITY, "nested": {
            "type": "twosided", "side": {"type": "diffuse", "reflectance": REFLECTANCE}}}},
    }


POSE = look_at((0, 0, 1 + DISTANCE), (0, 0, 0), (0, 1, 0))
EXPECTED = OPACITY * REFLECTANCE / math.pi * 5.0 / DISTANCE**2


@pytest.mark.parametrize("max_depth", [2, 6])
def test_holes_take_their_share_of_direct_light_once(max_depth):
    image = rb.render(rb.load_dict(scene(POSE)), spp=256, max_depth=max_depth)
    assert image.mean() == pytest.approx(EXPECTED, rel=2e-3)


def test_direct_light_agrees_with_mitsuba_and_paths_are_too_dark(mi):
    theirs = mi.load_dict(scene(mi.ScalarTransform4f(torch.as_tensor(POSE).numpy())))

    def mean(**integrator) -> float:
        return float(torch.tensor(mi.render(theirs, spp=2048, integrator=mi.load_dict(integrator)).numpy()).mean())

    assert mean(type="direct") == pytest.approx(EXPECTED, rel=2e-3)
    assert mean(type="path", max_depth=2) == pytest.approx(OPACITY * EXPECTED, rel=0.1)
