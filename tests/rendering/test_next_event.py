"""Next-event estimation counts every light sample that the material reflects, sampled or not."""

from dataclasses import dataclass

import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from torch_radbp.bsdf.diffuse import Diffuse, DiffuseKind
from torch_radbp.sampling.warp import square_to_cosine_hemisphere
from torch_radbp.tensors.vec import Vec3


@dataclass(frozen=True)
class HalfSampledKind(DiffuseKind):
    """Diffuse reflection, of which only the half x > 0 is sampled: the other lobe is evaluated only."""

    def eval_pdf(self, values, wi, wo):
        value, pdf = super().eval_pdf(values, wi, wo)
        return value, 2 * pdf * (wo.x > 0).to(pdf.dtype)

    def sample(self, values, wi, choice, u, v):
        wo = square_to_cosine_hemisphere(u, v)
        return Vec3(wo.x.abs(), wo.y, wo.z)


def lit_floor() -> rb.Scene:
    lamp = {"type": "area", "radiance": rgb(3, 4, 5)}
    return load(sensor=sensor(6, (0, 2, 2), (0, -0.5, 0), 30),
                floor=rectangle((0, -0.5, 0), 1.5, angle=-90, bsdf=diffuse(0.5, 0.6, 0.7)),
                left=rectangle((-1, 1, 0), 0.4, angle=90, emitter=lamp),
                right=rectangle((1, 1, 0), 0.4, angle=90, emitter=lamp))


def test_a_lobe_that_is_evaluated_but_never_sampled_loses_no_light(monkeypatch):
    settings = {"spp": 4096, "max_depth": 2}
    expected = rb.render(lit_floor(), **settings)
    assert expected.min() > 0
    monkeypatch.setattr(Diffuse, "kind", lambda self: HalfSampledKind())
    image = rb.render(lit_floor(), **settings)
    assert abs(float(image.mean() / expected.mean()) - 1) < 0.01
    only_sampled = rb.render(lit_floor(), nee=False, **settings)
    assert float(only_sampled.mean() / expected.mean()) < 0.8


def test_a_reflectance_of_zero_still_has_the_derivative_of_its_light_samples():
    scene = lit_floor()
    reflectance = scene.get_parameter("floor.bsdf.reflectance.value").requires_grad_()
    at_half, = torch.autograd.grad(rb.render(scene, spp=64, max_depth=2).sum(), [reflectance])
    with torch.no_grad():
        reflectance.zero_()
    at_zero, = torch.autograd.grad(rb.render(scene, spp=64, max_depth=2).sum(), [reflectance])
    assert at_half.min() > 0
    torch.testing.assert_close(at_zero, at_half, rtol=1e-9, atol=0)
