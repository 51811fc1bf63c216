"""What is said of a glossy ball that moves before a floor, once: what of edges seen by reflection is missing; no more."""

import warnings

import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from torch_radbp.io.values.transform import scale, translate


def said(bsdf: dict, max_depth: int = 4) -> list[warnings.WarningMessage]:
    """Everything that is warned of while three steps are rendered and differentiated."""
    lamp = {"type": "sphere", "to_world": translate((1, 2, 1)) @ scale((0.1, 0.1, 0.1)),
            "emitter": {"type": "area", "radiance": rgb(40, 40, 40)}}
    scene = load(torch.float32, sensor=sensor(8, (0, 1, 4), rfilter="gaussian"), lamp=lamp,
                 floor=rectangle((0, -0.5, 0), 3, angle=-90, bsdf=diffuse(0.5, 0.5, 0.5)),
                 ball={"type": "sphere", "to_world": scale((0.5, 0.5, 0.5)), "bsdf": bsdf})
    pose = scene.ball.to_world.requires_grad_()
    renderer = rb.Renderer(scene, spp=4, max_depth=max_depth)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for step in range(3):
            renderer(seed=step).mean().backward()
    assert pose.grad.abs().max() > 0
    return caught


def test_a_plastic_ball_that_moves_is_told_to_lack_edges_seen_by_reflection():
    in_mirrors, of_lamps = said({"type": "plastic"})
    for warning in (in_mirrors, of_lamps):
        assert warning.category is rb.SilhouetteWarning and warning.filename == __file__
    assert str(in_mirrors.message).startswith(
        "derivatives with respect to `ball.to_world` lack the contribution of edges seen by surfaces, not by the camera, by "
        "reflection or refraction: scattered directions follow the parameter and slide over the edges of shapes")
    assert "Edges of lamps are not among them" in str(in_mirrors.message)
    assert "paths from lamps bring caustics" in str(of_lamps.message)


@pytest.mark.parametrize("bsdf, max_depth", [(diffuse(0.5, 0.5, 0.5), 4), ({"type": "plastic"}, 2)],
                         ids=["diffuse", "direct light alone"])
def test_nothing_is_said_where_nothing_is_missing(bsdf, max_depth):
    assert [str(warning.message) for warning in said(bsdf, max_depth)] == []
