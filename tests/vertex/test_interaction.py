"""The point where a ray meets a surface: normals of flat and of smooth shapes in one scene."""

import torch

from tests.scenes import load, sensor
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.packing.pack import pack
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.vertex.interaction import surface_interaction

TENT = {"type": "mesh", "vertex_positions": torch.tensor([[0.0, 0, 0], [1, 0, 0.3], [1, 1, 0], [0, 1, 0.2]]),
        "faces": torch.tensor([[0, 1, 2], [0, 2, 3]])}
BALL = {"type": "sphere", "center": [0, 0, -9]}


def interaction(triangle: int, slides: torch.Tensor | None, **shapes):
    """What a ray along -z meets in the middle of a triangle, and the first shape's vertices."""
    scene = load(camera=sensor(2), sky={"type": "constant"}, **shapes)
    positions = scene.get_parameter("tent.vertex_positions").requires_grad_()
    number = torch.ones(1, dtype=torch.float64)
    ray = Ray(Vec3(0.3 * number, 0.4 * number, 2 * number), Vec3(0 * number, 0 * number, -number))
    hit = Hit(torch.tensor([triangle], dtype=torch.int32), number / 3, number / 3, 2 * number)
    return surface_interaction(pack(scene), ray, hit, slides=slides), positions


def test_flat_shapes_stay_flat_beside_smooth_ones():
    for triangle in (0, 1):
        si, _ = interaction(triangle, None, tent=TENT, ball=BALL)
        torch.testing.assert_close(si.frame.n.stack(), si.n.stack(), rtol=0, atol=0)
    smooth, _ = interaction(2, None, tent=TENT, ball=BALL)
    assert (smooth.frame.n.stack() - smooth.n.stack()).abs().max() > 1e-3


def test_normals_of_flat_shapes_beside_smooth_ones_follow_their_vertices():
    glued = torch.zeros(1, dtype=torch.bool)
    gradients = []
    for shapes in ({"tent": TENT, "ball": BALL}, {"tent": TENT}):
        si, positions = interaction(1, glued, **shapes)
        gradients.append(torch.autograd.grad((si.frame.n.stack() * torch.tensor([0.3, 0.5, 0.7])).sum(), positions)[0])
    assert (gradients[0] != 0).any()
    torch.testing.assert_close(*gradients, rtol=1e-14, atol=0)
