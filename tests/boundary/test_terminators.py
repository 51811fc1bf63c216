"""Inside of a smooth ball, the light of a lamp ends at edges between triangles that face it and triangles that do not.

Seen so that no silhouette is in view, these edges are all that jumps in the image.
"""

from __future__ import annotations

import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at
from tests.scenes.distant_lamps import LAMPS
from tests.scenes.meshes import icosphere
from torch_radbp.io.values.transform import rotate

SIZE, STEP, SPP = 16, 0.01, 64
SENSORS = {"perspective": {}, "thinlens": {"aperture_radius": 0.05, "focus_distance": 3.0}}


def side_lit_ball(lamp: str, sensor: str = "perspective") -> rb.Scene:
    """The middle of a ball of 320 triangles, half of which is dark."""
    view = {"type": sensor, "fov": 14, "to_world": look_at((0, 0, 3.5), (0, 0, 0), (0, 1, 0)),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}} | SENSORS[sensor]
    vertices, faces = icosphere(2)
    turn = torch.as_tensor(rotate((1, 2, 3), 40), dtype=torch.float64)[:3, :3]
    ball = {"type": "mesh", "vertex_positions": 0.6 * vertices @ turn.T, "faces": faces, "recompute_normals": True,
            "bsdf": diffuse(0.8, 0.6, 0.4)}
    return load(torch.float32, sensor=view, lamp=LAMPS[lamp], ball=ball)


def sideways(vertices: torch.Tensor) -> torch.Tensor:
    return torch.tensor([1.0, 0.3, 0.0]).expand_as(vertices).contiguous()


def difference(scene: rb.Scene) -> torch.Tensor:
    """(1, 3, H, W) central difference of images with the same samples."""
    vertices = scene.ball.vertex_positions
    home, images = vertices.detach().clone(), []
    for side in (1, -1):
        vertices.data = home + side * STEP * sideways(home)
        images.append(rb.render(scene, spp=4 * SPP, seed=5, max_depth=2).detach())
    vertices.data = home
    return (images[0] - images[1]) / (2 * STEP)


@pytest.mark.parametrize(("lamp", "sensor", "bound"), [
    ("directional", "perspective", 0.01), ("point", "perspective", 0.01), ("directional", "thinlens", 0.02),
    ("surface", "perspective", 0.03)])
def test_the_edge_of_light_on_a_smooth_ball_moves_with_the_ball(lamp, sensor, bound):
    """Without these edges derivatives are off by 5 to 6 %."""
    scene = side_lit_ball(lamp, sensor)
    reference = difference(scene)
    assert reference.isfinite().all()
    found = rb.jvp(scene, {"ball.vertex_positions": sideways(scene.ball.vertex_positions.detach())}, spp=SPP, seed=0,
                   max_depth=2)
    expected = float(reference.abs().sum())
    assert expected > 0
    weights = reference.sign()
    assert abs(float((found * weights).sum()) - expected) <= bound * expected


def test_the_backward_pass_has_these_edges():
    scene = side_lit_ball("directional")
    reference = difference(scene)
    vertices = scene.ball.vertex_positions.requires_grad_()
    image = rb.render(scene, spp=SPP, seed=0, max_depth=2)
    gradient, = torch.autograd.grad((image * reference.sign()).sum(), vertices)
    expected = float(reference.abs().sum())
    assert expected > 0
    assert abs(float((gradient * sideways(vertices.detach())).sum()) - expected) <= 0.01 * expected
