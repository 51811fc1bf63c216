"""Derivatives of light samples and of emission with respect to everything that lights are made of, decisions frozen.

`torch.autograd.gradcheck` in float64, slow mode: poses, positions and texels move in `scene`, `proposal` stays. All
entries of a parameter move at once, in a few random directions, and of each result two random sums over its lanes and
components are differentiated: all derivatives are in them. And in expectation: irradiance from glued samples against
finite differences of independent estimates, which move both.

Reference: Zhang et al. 2020; Worchel et al. 2025, on what is missed without the area and the geometry term.
"""

import pytest
import torch
from torch import nn
from torch.func import functional_call

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.emitter.lanes import cast, detached, light_numbers, on_the_floor, uniform
from tests.gradients import assert_informative, image_and_gradients, relative_error
from tests.scenes import load, look_at, rgb, sensor
from tests.scenes.lights import EMITTERS, FLOOR, SQUARE, scene_of, slide
from torch_radbp.connection.light import sample_light
from torch_radbp.scene.packing.pack import pack
from torch_radbp.tensors.vec import Ray, Vec3, normalize
from torch_radbp.vertex.emission import emitted, emitted_pdf
from torch_radbp.vertex.interaction import surface_interaction

LANES = 24
DIRECTIONS = 3  # in which each parameter moves
MESH = {"lamp": SQUARE | {"emitter": {"type": "area", "radiance": slide()}}}
SCENES = {**EMITTERS, "area_mesh": MESH}
del SCENES["area_sphere"], SCENES["constant"], SCENES["envmap_compensated"]
SCENES["area_sphere"] = {"lamp": {"type": "disk", "to_world": look_at((0.2, 1.1, 0.1), (0, 0, 0), (1, 0, 0)),
                                  "emitter": {"type": "area", "radiance": rgb(3, 2, 1)}}}
# What may move, besides the surface point.
PARAMETERS = {
    "area": ["lamp.to_world", "lamp.emitter.radiance.data"],
    "area_mesh": ["lamp.vertex_positions", "lamp.vertex_texcoords", "lamp.emitter.radiance.data"],
    "area_sphere": ["lamp.to_world"],
    "envmap": ["lamp.data", "lamp.scale", "lamp.to_world"],
    "point": ["lamp.position", "lamp.intensity.value"],
    "spot": ["lamp.to_world", "lamp.intensity.value", "lamp.cutoff_angle", "lamp.beam_width"],
    "spot_image": ["lamp.to_world", "lamp.intensity.value", "lamp.texture.data", "lamp.cutoff_angle", "lamp.beam_width"],
    "projector": ["lamp.to_world", "lamp.irradiance.data", "lamp.scale"],
    "directional": ["lamp.to_world", "lamp.irradiance.value"],
    "all": ["area_lamp.to_world", "envmap_lamp.to_world", "spot_image_lamp.to_world", "projector_lamp.to_world",
            "point_lamp.position", "directional_lamp.to_world", "envmap_lamp.data", "area_lamp.emitter.radiance.data"],
}


class Sampled(nn.Module):
    """What next-event estimation finds, as a function of a scene's parameters and of the surface points."""

    def __init__(self, scene, seed: int = 1, count: int = LANES):
        super().__init__()
        self.scene, self.proposal = scene, detached(scene)
        self.si = on_the_floor(scene, self.proposal, count, seed).si
        self.numbers = light_numbers(count, seed + 100)

    def forward(self, p=None):
        p = self.si.p.stack() if p is None else p
        light = sample_light(pack(self.scene), self.proposal, Vec3.of(p), self.numbers)
        usable = (light.pdf > 0).to(light.pdf.dtype)
        return light.d.stack() * usable[:, None], light.radiance.stack() * usable[:, None], light.pdf, 1 / (
            light.pdf + 1 - usable)


class Hit(nn.Module):
    """What a ray sees of the lights, as a function of a scene's parameters and of the ray."""

    def __init__(self, scene, seed: int = 2, count: int = LANES):
        super().__init__()
        self.scene, self.proposal = scene, detached(scene)
        x, y, z = uniform(count, seed)
        o = Vec3(x - 0.5, torch.full_like(x, -0.3), y - 0.5)
        s, t, _ = uniform(count, seed + 1)
        towards = Vec3(0.3 + 1.6 * (s - 0.5), torch.full_like(x, 1.1), 1.6 * (t - 0.5))  # where the lamps are
        self.view = cast(scene, self.proposal, Ray(o, normalize(towards - o)))

    def forward(self, *given):
        o, d = given if len(given) == 2 else (self.o, *given)
        scene, ray = pack(self.scene), Ray(Vec3.of(o), normalize(Vec3.of(d)))
        hit = cast(self.scene, detached(self.scene), Ray(ray.o.detach(), ray.d.detach())).hit
        si = surface_interaction(scene, ray, hit, slides=torch.ones_like(hit.prim, dtype=torch.bool))
        return emitted(scene, ray, si).stack(), emitted_pdf(scene, ray, si, self.proposal)


def check(module: nn.Module, name: str, inputs: tuple, gradients_of: list[str]) -> None:
    """gradcheck with respect to parameters and inputs; each of them must have a derivative that is not zero."""
    values = [module.scene.get_parameter(parameter).detach().clone().requires_grad_() for parameter in gradients_of]
    inputs = [value.detach().clone().requires_grad_() for value in inputs]

    def outputs(*arguments):
        given = {f"scene.{parameter}": value for parameter, value in zip(gradients_of, arguments)}
        return tuple(out for out in functional_call(module, given, tuple(arguments[len(values):])) if out.requires_grad)

    found = outputs(*values, *inputs)
    gradients = torch.autograd.grad(sum((out * torch.randn_like(out)).sum() for out in found), values + inputs)
    for parameter, gradient in zip([*gradients_of, *(f"input {k}" for k in range(len(inputs)))], gradients):
        assert torch.isfinite(gradient).all() and gradient.abs().max() > 0, parameter
    weights = [torch.randn(2, out.numel(), dtype=out.dtype) for out in found]

    starts = [value.detach() for value in values + inputs]
    directions = [torch.randn(DIRECTIONS, start.numel(), dtype=start.dtype) for start in starts]
    steps = [torch.zeros(DIRECTIONS, dtype=start.dtype, requires_grad=True) for start in starts]

    def sums(*steps):
        moved = [start + (step @ ways).view_as(start) for start, step, ways in zip(starts, steps, directions)]
        return tuple(weight @ out.flatten() for weight, out in zip(weights, outputs(*moved), strict=True))

    assert torch.autograd.gradcheck(sums, steps, eps=1e-6, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("name", [
    deep(name) if name in ("all", "area", "spot") else name for name in PARAMETERS])  # others have what these have
def test_a_light_sample_has_the_right_derivatives(name):
    torch.manual_seed(0)
    module = Sampled(load(sensor=sensor(2), **FLOOR, **SCENES[name]))
    inputs = (module.si.p.stack(),)
    if name in ("envmap", "directional"):  # do not depend on where they are seen from
        inputs = ()
    check(module, name, inputs, PARAMETERS[name])


@pytest.mark.parametrize("name", deep_but(["area_sphere"], ["area", "area_mesh", "area_sphere", "envmap", "all"]))
def test_emission_and_its_density_have_the_right_derivatives(name):
    torch.manual_seed(0)
    module = Hit(load(sensor=sensor(2), **FLOOR, **SCENES[name]))
    emits = emitted(module.proposal, module.view.ray, module.view.si).x > 0
    assert emits.sum() >= 3
    names = [parameter for parameter in PARAMETERS[name]
             if not parameter.startswith(("point", "spot", "projector", "directional"))]
    rays = [module.view.ray.o.stack(), module.view.ray.d.stack()]
    if name == "envmap":  # does not depend on where it is seen from
        module.o = rays.pop(0)
    check(module, name, tuple(rays), names)


EMISSION = {
    "envmap": ["lamp.data"], "envmap_compensated": ["lamp.data"],
    "spot_image": ["lamp.intensity.value", "lamp.texture.data"],
    "projector": ["lamp.irradiance.data"], "directional": ["lamp.irradiance.value"],
    "all": ["envmap_lamp.data", "area_lamp.emitter.radiance.data", "spot_image_lamp.texture.data",
            "projector_lamp.irradiance.data", "point_lamp.intensity.value", "directional_lamp.irradiance.value"],
}


@pytest.mark.parametrize("name, adjoint", [
    (name, adjoint) if name == "all" or adjoint == rb.MemoizedAdjoint() else deep(name, adjoint) for name in EMISSION
    for adjoint in (rb.MemoizedAdjoint(), rb.MemoizedAdjoint("log", False), rb.ReplayAdjoint())], ids=str)
def test_every_strategy_gives_the_gradient_of_plain_autograd(name, adjoint):
    names = [*EMISSION[name], "floor.bsdf.reflectance.value"]
    settings = {"spp": 8, "max_depth": 4, "rr_depth": 2}
    image, expected = image_and_gradients(scene_of(name), names, adjoint=rb.TapeAdjoint(), **settings)
    assert_informative(image, expected)
    _, found = image_and_gradients(scene_of(name), names, adjoint=adjoint, **settings)
    for parameter, gradient, reference in zip(names, found, expected):
        assert relative_error(gradient, reference) < 1e-10, parameter


# -- In expectation --------------------------------------------------------------------------------------------------------

COUNT = 200_000


def irradiance(scene, seed: int) -> torch.Tensor:
    """(N, 3) estimates of the irradiance of the floor by light samples, attached."""
    tensors, proposal = pack(scene), detached(scene)
    si = on_the_floor(scene, proposal, COUNT, seed).si
    light = sample_light(tensors, proposal, si.p, light_numbers(COUNT, seed + 50))
    cosine = si.frame.to_local(light.d).z
    usable = (light.pdf > 0) & (cosine > 0)
    return (light.radiance * (cosine * usable / torch.where(usable, light.pdf, 1.0))).stack()


def moved(scene, parameter: str, by: torch.Tensor, step: torch.Tensor) -> None:
    """Replaces a parameter by a function of `step`."""
    module, leaf = scene.get_submodule(parameter.rpartition(".")[0]), parameter.rpartition(".")[2]
    start = getattr(module, leaf).detach().clone()
    del module._parameters[leaf]
    setattr(module, leaf, start + step * by.to(start))


def along(scene, parameter: str) -> torch.Tensor:
    """A direction in which a parameter can move: poses turn, shear, scale and shift at once."""
    shape = scene.get_parameter(parameter).shape
    direction = torch.rand(shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64) - 0.3
    if parameter.endswith("to_world"):
        direction[3] = 0
    return direction


@pytest.mark.parametrize("name, parameter", [
    ("area", "lamp.to_world"), ("area_mesh", "lamp.vertex_positions"), ("envmap", "lamp.to_world"), ("envmap", "lamp.data"),
    ("all", "area_lamp.to_world"), deep("all", "envmap_lamp.to_world"), ("area", "lamp.emitter.radiance.data")])
def test_the_derivative_of_irradiance_is_that_of_independent_finite_differences(name, parameter):
    """Shear and scale change the area of the light; the differences draw samples of their own, where the light now is."""

    def at(step: float | torch.Tensor, seed: int) -> torch.Tensor:
        scene = load(sensor=sensor(2), **FLOOR, **SCENES[name])
        by = along(scene, parameter)
        moved(scene, parameter, by, torch.as_tensor(step, dtype=torch.float64))
        return irradiance(scene, seed)

    # Forward mode: one derivative per lane.
    with torch.autograd.forward_ad.dual_level():
        step = torch.autograd.forward_ad.make_dual(torch.zeros((), dtype=torch.float64), torch.ones((), dtype=torch.float64))
        found = torch.autograd.forward_ad.unpack_dual(at(step, 1)).tangent
    h = 0.02
    difference = (at(h, 2) - at(-h, 2)) / (2 * h)  # the same numbers on both sides: less noise
    errors = [values.std(0) / len(values) ** 0.5 for values in (found, difference)]
    z = (found.mean(0) - difference.mean(0)) / torch.hypot(*errors)
    assert (found.mean(0).abs() > 10 * errors[0]).any()  # there is something to be found
    assert z.abs().max() < 4.5, (found.mean(0), difference.mean(0), errors)


def test_without_the_terms_of_the_moving_light_the_derivative_is_biased():
    """The ablation: a density that does not follow the light misses its area and its geometry term."""
    scene = load(sensor=sensor(2), **FLOOR, **SCENES["area"])
    by = along(scene, "lamp.to_world")
    step = torch.zeros((), dtype=torch.float64, requires_grad=True)
    moved(scene, "lamp.to_world", by, step)
    tensors, proposal = pack(scene), detached(scene)
    si = on_the_floor(scene, proposal, COUNT, 1).si
    light = sample_light(tensors, proposal, si.p, light_numbers(COUNT, 51))
    cosine = si.frame.to_local(light.d).z
    usable = (light.pdf > 0) & (cosine > 0)

    def derivative(pdf):
        value = (light.radiance * (cosine * usable / torch.where(usable, pdf, 1.0))).x.mean()
        return torch.autograd.grad(value, step, retain_graph=True)[0]

    complete, lacking = derivative(light.pdf), derivative(light.pdf.detach())
    assert (lacking - complete).abs() > 0.2 * complete.abs()
