"""Quotients that a path hardly ever meets, one by one: their derivatives are finite in float32, too."""

import pytest
import torch

from tests.scenes import load, rectangle, rgb, sensor
from torch_radbp.bsdf.diffuse import DiffuseKind
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.packing.pack import pack
from torch_radbp.scene.tables.triangle_corners import at_corners
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.vertex.interaction import corner_rows, surface_interaction
from torch_radbp.vertex.material import Material, sample
from torch_radbp.vertex.outgoing_ray import glued_direction

LAMP = {"type": "area", "radiance": rgb(1, 2, 3)}


class Unlikely(DiffuseKind):
    """A material that draws directions of nearly no density, where it reflects as little."""

    def eval_pdf(self, values, wi, wo, fixed_lobes=False):
        pdf = values[0].x * 1e-22
        return values[0] * pdf, pdf


@pytest.mark.parametrize("sampling", ["detached", "attached"])
def test_the_weight_of_a_direction_of_nearly_no_density(sampling):
    value = torch.full((3,), 0.5, requires_grad=True)
    zero, one = torch.zeros(3), torch.ones(3)
    values = (Vec3(value, value, value),)
    drawn = sample(Material(Unlikely(), values), Vec3(zero, zero, one), None, 0.3 * one, 0.4 * one, sampling)
    gradient, = torch.autograd.grad(drawn.weight.x.sum(), value)
    assert torch.isfinite(drawn.weight.stack()).all() and torch.isfinite(gradient).all()


def vec(*values: float) -> Vec3:
    """A lane whose components require grad."""
    return Vec3(*(torch.tensor([value], requires_grad=True) for value in values))


def square():
    """A square in the plane z = 0."""
    return pack(load(torch.float32, camera=sensor(2), lamp=rectangle((0, 0, 0), emitter=LAMP)))


def a_hit() -> Hit:
    third = torch.tensor([0.25])
    return Hit(torch.zeros(1, dtype=torch.int32), third, third, torch.ones(1))


def test_the_change_of_solid_angle_of_a_triangle_seen_edge_on():
    o = vec(3.0, 0.0, 0.0)
    scene = square()
    there = at_corners(scene.triangles.vertices.p, corner_rows(scene, a_hit()))
    d, change = glued_direction(there, o, vec(-1.0, 0.0, 0.0).detach(), a_hit(), torch.ones(1, dtype=torch.bool))
    assert change == 1
    assert all(torch.isfinite(gradient).all() for gradient in torch.autograd.grad(change.sum() + d.x.sum(), list(o)))


def test_the_point_that_slides_over_a_triangle_seen_edge_on():
    ray = Ray(vec(3.0, 0.0, 0.0), vec(-1.0, 0.0, 0.0))
    si = surface_interaction(square(), ray, a_hit(), slides=torch.ones(1, dtype=torch.bool))
    gradients = torch.autograd.grad(si.p.x.sum() + si.p.y.sum(), [*ray.o, *ray.d], allow_unused=True)
    assert torch.isfinite(si.p.stack()).all()
    assert all(torch.isfinite(gradient).all() for gradient in gradients if gradient is not None)


def test_a_lamp_with_a_triangle_whose_inverse_area_has_no_derivative_that_float32_holds():
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1e-11, 0, 0], [0, 1e-11, 0]])
    scene = load(torch.float32, camera=sensor(2), lamp={
        "type": "mesh", "vertex_positions": vertices, "faces": torch.tensor([[0, 1, 2], [0, 3, 4]]), "emitter": LAMP})
    positions = scene.get_parameter("lamp.vertex_positions").requires_grad_()
    surfaces, = pack(scene).lights.tables
    assert surfaces.inverse_area[0] == 2 and surfaces.inverse_area[1] == 0
    gradient, = torch.autograd.grad(surfaces.inverse_area[0] + surfaces.n.z.sum(), positions)
    assert torch.isfinite(gradient).all() and (gradient != 0).any()
