"""Materials that hold others: sums of what they hold, whatever the weight; and normals that are turned."""

import itertools

import pytest
import torch

import torch_radbp as rb
from tests.bsdf.lanes import LaneNumbers, direction, directions, light, material, random_numbers, sampled, values_of
from tests.deep import deep
from tests.scenes import load, rectangle, rgb, sensor
from tests.scenes.materials import MATERIALS
from torch_radbp.check.finite import Lanes
from torch_radbp.tensors.vec import Vec3, where

COUNT = 80_000
DIFFUSE = {"type": "diffuse", "reflectance": [0.2, 0.8, 0.3]}
HOLDERS = {
    "blend of diffuse and mirror": {"type": "blendbsdf", "bsdf": [DIFFUSE, MATERIALS["conductor"]]},
    "blend of glass and plastic": {"type": "blendbsdf", "bsdf": [MATERIALS["glass ggx"], MATERIALS["plastic"]]},
    "blend of plastics": {"type": "blendbsdf", "bsdf": [MATERIALS["plastic"], MATERIALS["rough plastic beckmann"]]},
    "mask": {"type": "mask", "nested_bsdf": MATERIALS["metal ggx"]},
}


def holder(holds: str, weight: float, moving: bool = True):
    description = HOLDERS[holds]
    name = "weight" if description["type"] == "blendbsdf" else "opacity"
    return material(description | {name: weight}).requires_grad_(moving)


def reflected(kind, values, wi: Vec3, random: LaneNumbers) -> torch.Tensor:
    """(N,) estimates of the light that a material scatters towards wi, by its own samples, attached to the values."""
    fixed = tuple(value.detach() for value in values)
    choice, wo = sampled(kind, fixed, wi, random)
    value, pdf = kind.eval_pdf(values, wi, wo)
    pdf = pdf.detach()
    estimate = value.y / torch.where(pdf > 0, pdf, 1.0) * (pdf > 0)
    if kind.delta:
        estimate = torch.where(choice.is_delta(kind), kind.specular(values, wi, choice).y / choice.probability, estimate)
    return estimate * light(wo)


@pytest.mark.parametrize("z", [0.8, deep(0.5)])
@pytest.mark.parametrize("name", HOLDERS)
def test_the_derivative_by_the_weight_is_the_difference_of_the_parts(name, z):
    """What is scattered is linear in the weight, so that the difference of its ends is the derivative everywhere."""
    wi, random = direction(z, 0.4, COUNT), random_numbers(COUNT)
    ends = []
    for end in (0.0, 1.0):
        bsdf = holder(name, end)
        ends.append(reflected(bsdf.kind(), values_of(bsdf, wi.z), wi, random).detach())
    for weight in (0.0, 0.3, 1.0):
        bsdf = holder(name, weight)
        values = list(values_of(bsdf, wi.z))
        moved = values[0].x.detach().requires_grad_()
        values[0] = values[0]._replace(x=moved)
        estimate = reflected(bsdf.kind(), tuple(values), wi, random)
        slope, = torch.autograd.grad(estimate.sum(), moved)
        expected = ends[1].mean() - ends[0].mean()
        error = sum(part.var() / COUNT for part in (*ends, slope)).sqrt()
        assert abs(slope.mean() - expected) < 4.5 * error and abs(expected) > 6 * error, weight
        mixed = (1 - weight) * ends[0].mean() + weight * ends[1].mean()
        spread = sum(part.var() / COUNT for part in (*ends, estimate.detach())).sqrt()
        assert abs(estimate.mean() - mixed) < 4.5 * spread, weight


NORMALS = [(0.5, 0.5, 1.0), (0.5, 0.5, 0.5), (1.0, 0.5, 0.5), (0.5, 0.0, 0.5), (0.5, 0.5, 0.0), (0.0, 1.0, 0.2),
           (1.0, 1.0, 1.0)]
COSINES = (1.0, 0.6, 1e-3, 1e-7, 0.0, -1e-7, -0.5, -1.0)
EXTREMES = {  # materials of one kind
    **{f"{name}{moving}": lambda name=name, moving=moving: [holder(name, weight, bool(moving)) for weight in (0.0, 0.5, 1.0)]
       for name in HOLDERS for moving in (", moving", "")},
    **{name: lambda name=name: [material({"type": "normalmap", "normalmap": list(normal), "nested_bsdf": MATERIALS[name]})
                                for normal in NORMALS]
       for name in ("rough plastic ggx", "conductor", "glass beckmann", "brushed metal ggx")},
}


@pytest.mark.parametrize("dtype", [torch.float32, deep(torch.float64)], ids=str)
@pytest.mark.parametrize("name", EXTREMES)
def test_values_and_derivatives_stay_finite(name, dtype):
    materials = [each.to(dtype) for each in EXTREMES[name]()]
    kind = materials[0].kind()
    assert all(each.kind() == kind for each in materials)
    cosines = torch.tensor(COSINES, dtype=dtype)
    z = cosines.repeat_interleave(len(COSINES)).repeat(len(materials))
    r = torch.sqrt(1 - z * z)
    wi = Vec3(0.6 * r, 0.8 * r, z).map(lambda c: c.clone().requires_grad_())
    lanes = [values_of(each, z[:len(COSINES)**2]) for each in materials]
    values = tuple(Vec3(*map(torch.cat, zip(*parts))).map(lambda c: c.detach().clone().requires_grad_())
                   for parts in zip(*lanes))
    other = cosines.repeat(len(COSINES)).repeat(len(materials))
    wo = Vec3(-torch.sqrt(1 - other * other), torch.zeros_like(other), other).map(lambda c: c.clone().requires_grad_())
    value, pdf = kind.eval_pdf(values, wi, wo)
    assert not list(Lanes(values, wi, wo).troubles({"eval": value, "pdf": pdf}))
    for number in itertools.product((0.0, 0.019, 0.5, 1 - 2.0**-24), (0.0, 0.7), (0.3,)):
        random = LaneNumbers(*(torch.full_like(z, x) for x in number))
        choice = kind.choose(values, wi, *random)
        assert (choice.probability > 0).all() and (choice.probability <= 1).all()
        wo = kind.sample(values, wi, choice, random.u, random.v)
        assert ((wo.x**2 + wo.y**2 + wo.z**2) - 1).abs().max() < 300 * torch.finfo(dtype).eps
        value, pdf = kind.eval_pdf(values, wi, wo)
        outputs = {"sample": wo, "eval at the sample": value, "pdf at the sample": pdf}
        if kind.delta:
            outputs["specular"] = kind.specular(values, wi, choice)
        assert not list(Lanes(values, wi, random).troubles(outputs))


def test_a_normal_map_that_turns_nothing_changes_nothing():
    nested = material(MATERIALS["brushed metal ggx"])
    bumps = material({"type": "normalmap", "normalmap": [0.5, 0.5, 1.0], "nested_bsdf": MATERIALS["brushed metal ggx"]})
    wi, wo = directions(1000, 1), directions(1000, 2)
    results = [bsdf.kind().eval_pdf(values_of(bsdf, wi.z), wi, wo) for bsdf in (nested, bumps)]
    torch.testing.assert_close(results[0][0].stack(), results[1][0].stack(), rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(results[0][1], results[1][1], rtol=1e-9, atol=1e-12)


def test_a_two_sided_material_inside_of_another_is_mirrored_from_behind():
    both = material({"type": "twosided", "brdf": [MATERIALS["plastic"], DIFFUSE]})
    wi, wo = directions(1000, 1), directions(1000, 2)
    found = both.kind().eval_pdf(values_of(both, wi.z), wi, wo)
    flipped = [w._replace(z=-w.z) for w in (wi, wo)]
    sides = [side.kind().eval_pdf(values_of(side, wi.z), *ws) for side, ws in zip(both.brdf, ((wi, wo), flipped))]
    front = wi.z > 0
    assert torch.equal(found[0].stack(), where(front, sides[0][0], sides[1][0]).stack()) and (found[1] > 0).any()
    assert torch.equal(found[1], torch.where(front, sides[0][1], sides[1][1]))


@pytest.mark.parametrize("opacity", [0.0, 0.3, 1.0])
def test_what_lies_behind_a_mask_is_seen_by_the_part_that_it_lets_through(opacity):
    """A black sheet before a lamp: the image is (1 - opacity) times the lamp, and the derivative minus the lamp."""
    scene = load(torch.float64, sensor=sensor(2), lamp=rectangle((0, 0, -1), 9.0, emitter={
        "type": "area", "radiance": rgb(2.0, 3.0, 4.0)}), sheet=rectangle((0, 0, 0), 9.0, bsdf={
            "type": "mask", "opacity": opacity, "black": {"type": "diffuse", "reflectance": 0.0}}))
    parameter = scene.get_parameter("sheet.bsdf.opacity.value").requires_grad_()
    image = rb.render(scene, spp=4000, max_depth=2, seed=1)
    expected = torch.tensor([2.0, 3.0, 4.0], dtype=torch.float64)
    torch.testing.assert_close(image.mean((0, 2, 3)), (1 - opacity) * expected, rtol=0.03, atol=1e-12)
    gradient, = torch.autograd.grad(image.mean((0, 2, 3)).sum(), parameter)
    torch.testing.assert_close(gradient, -expected.sum(), rtol=0.12, atol=0)


def test_a_two_sided_normal_map_is_mirrored_from_behind():
    """As in Mitsuba: x and y of the map stay where they are on the surface, only z turns to the viewer."""
    bumps = {"type": "normalmap", "normalmap": rgb(0.7, 0.8, 0.9), "nested": {"type": "roughconductor", "alpha": 0.4}}
    images = [rb.render(load(torch.float64, sensor=sensor(1, (0.3, 0.4, 3.5 * side), fov=0.01), plate=rectangle(
        (0, 0, 0), bsdf={"type": "twosided", "both": bumps}), lamp={
            "type": "point", "position": [0.5, 1.5, 2.0 * side], "intensity": rgb(5, 5, 5)}), spp=1, max_depth=2, seed=0)
        for side in (1, -1)]
    assert images[0].min() > 0.1
    torch.testing.assert_close(*images, rtol=1e-3, atol=0)
