"""Phase functions integrate to one, are sampled by their density, and have the moments that they are known for."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from tests.scenes.phase_functions import BY_COSINE, CASES, OTHERS
from torch_radbp.check.chi_square import SIGNIFICANCE, p_value
from torch_radbp.interface.emitter import stacked
from torch_radbp.io.build import build_plugin
from torch_radbp.plugin import REGISTRY
from torch_radbp.tensors.vec import Vec3, dot


def made(name):
    return build_plugin({"type": name.split()[0]} | CASES[name], "phase").double()


def table_of(phase):
    """The columns that lanes read."""
    return stacked([phase.row()], torch.empty(0, dtype=torch.float64))


def place(count: int) -> Vec3:
    return Vec3(*(torch.full((count,), number, dtype=torch.float64) for number in (0.4, 0.7, 0.55)))


def sphere(heights: int = 400, turns: int = 400) -> tuple[Vec3, float]:
    """The middles of cells of equal area, and their solid angle."""
    z = (torch.arange(heights, dtype=torch.float64) + 0.5) / heights * 2 - 1
    phi = (torch.arange(turns, dtype=torch.float64) + 0.5) / turns * 2 * math.pi
    z, phi = (part.flatten() for part in torch.meshgrid(z, phi, indexing="ij"))
    return Vec3((1 - z * z).sqrt() * phi.cos(), (1 - z * z).sqrt() * phi.sin(), z), 4 * math.pi / (heights * turns)


WI = torch.nn.functional.normalize(torch.tensor([0.3, -0.5, 0.7], dtype=torch.float64), dim=0)


def test_every_phase_function_has_a_row():
    assert {name.split()[0] for name in CASES} == set(REGISTRY["phase"])


@pytest.mark.parametrize("name", BY_COSINE)
def test_it_has_the_moments_that_it_is_known_for(name):
    phase = made(name)
    cosine = torch.linspace(-1, 1, 400001, dtype=torch.float64)
    value, pdf = phase.kind().of_cosine(table_of(phase), cosine)
    assert (value >= 0).all() and (pdf > 0).all()
    for power, expected in enumerate((1.0, *BY_COSINE[name][1:])):
        assert float(torch.trapezoid(2 * math.pi * value * cosine**power, cosine)) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", [*BY_COSINE, "tabphase"])
def test_cosines_are_sampled_by_the_density(name):
    """The sampled cosine at u is where the cumulative distribution is u, or 1 - u."""
    phase = made(name)
    kind, table = phase.kind(), table_of(phase)
    u = torch.linspace(0.001, 0.999, 997, dtype=torch.float64)
    found = kind.sample_cosine(table, u)
    grid = torch.linspace(-1, 1, 400001, dtype=torch.float64)
    below = torch.cumulative_trapezoid(2 * math.pi * kind.of_cosine(table, grid)[1], grid)
    reached = torch.from_numpy(np.interp(found, grid[1:], below))
    falls = bool(found[0] > found[-1])
    torch.testing.assert_close(reached, 1 - u if falls else u, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", CASES)
def test_directions_are_sampled_by_the_density_and_it_integrates_to_one(name):
    """Over 20 x 20 cells of the sphere; samples weigh little more than 1."""
    phase = made(name)
    kind, table = phase.kind(), table_of(phase)
    wo, solid_angle = sphere()
    wi, count = Vec3(*(torch.full_like(wo.x, float(number)) for number in WI)), 200_000
    value, pdf = kind.eval_pdf(table, place(len(wo.x)), wi, wo)
    assert (value >= 0).all() and float((value / pdf).max()) < 1.03
    assert float(value.sum()) * solid_angle == pytest.approx(1.0, abs=2e-3)
    assert float(pdf.sum()) * solid_angle == pytest.approx(1.0, abs=2e-3)
    u, v = torch.rand(2, count, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    d = kind.sample(table, place(count), Vec3(*(part[:1].expand(count) for part in wi)), u, v)
    torch.testing.assert_close(dot(d, d), torch.ones_like(u))
    row = ((d.z + 1) * 10).long().clamp(0, 19)
    column = ((torch.atan2(d.y, d.x) / (2 * math.pi)).remainder(1.0) * 20).long().clamp(0, 19)
    observed = torch.bincount(row * 20 + column, minlength=400)
    expected = pdf.reshape(20, 20, 20, 20).mean((1, 3)).flatten() * (4 * math.pi / 400) * count
    assert p_value(observed, expected) > SIGNIFICANCE


@pytest.mark.parametrize("name", [name for name in CASES if made(name).row() != ()])
def test_its_parameters_and_its_place_have_derivatives(name):
    """Of the value, all against differences."""
    phase, u = made(name), torch.linspace(0.05, 0.95, 12, dtype=torch.float64)
    wi = Vec3(*(torch.full_like(u, float(number)) for number in WI))
    wo = phase.kind().sample(table_of(phase), place(12), wi, u, u.flip(0) * 0.83).detach()
    p = place(12).stack().requires_grad_()

    def value():
        return (phase.kind().eval_pdf(table_of(phase), Vec3.of(p), wi, wo)[0] * u).sum()

    inputs = {"p": p} | {key: parameter.requires_grad_() for key, parameter in phase.named_parameters()}
    found = torch.autograd.grad(value(), list(inputs.values()), allow_unused=True)
    for key, part, gradient in zip(inputs, inputs.values(), found):
        gradient = torch.zeros_like(part) if gradient is None else gradient
        flat, step = part.data.view(-1), 1e-5
        for number, kept in enumerate(flat.tolist()):
            least = kept if kept == 0.0 and key != "S.data" else kept - step  # at the end of a range on one side
            ends = []
            for flat[number] in (least, kept + step):
                ends.append(float(value().detach()))
            flat[number] = kept
            slope = (ends[1] - ends[0]) / (kept + step - least)
            assert slope == pytest.approx(float(gradient.view(-1)[number]), rel=1e-4, abs=1e-4), key


def test_flakes_are_seen_by_the_area_of_their_ellipsoid():
    """The root of w . S w along w, of a mixture the mean; of others there is none."""
    wo, _ = sphere(40, 40)
    matrix = torch.tensor([[0.9, 0.2, -0.1], [0.2, 0.3, 0.15], [-0.1, 0.15, 0.5]], dtype=torch.float64)
    wanted = torch.einsum("ni,ij,nj->n", wo.stack(), matrix, wo.stack()).sqrt()
    for name, area in (("sggx", wanted), ("blendphase", 0.7 + 0.3 * wanted), ("sggx of a ball", torch.ones_like(wanted))):
        phase = made(name)
        torch.testing.assert_close(phase.kind().projected_area(table_of(phase), place(1600), wo), area)
    assert made("hg").kind().projected_area(table_of(made("hg")), place(1600), wo) is None


@pytest.mark.parametrize("name", OTHERS)
def test_values_are_those_of_mitsuba(name, mi):
    def grid(values, *shape):
        values = torch.as_tensor(values, dtype=torch.float32).reshape(shape).numpy()
        return {"type": "gridvolume", "grid": mi.VolumeGrid(values)}

    def theirs(described):
        if not isinstance(described, dict):
            return described
        described = {key: theirs(value) for key, value in described.items()}
        if described["type"] == "gridvolume":
            return grid(described["data"], 2, 2, 2, 1)
        if described["type"] == "sggx":
            described["S"] = grid(described["S"], 1, 1, 1, 6)
        if described["type"] == "tabphase":
            described["values"] = ", ".join(map(str, described["values"]))
        return described

    phase, wanted = made(name), mi.load_dict(theirs({"type": name.split()[0]} | CASES[name]))
    wo = torch.randn(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    wo = torch.nn.functional.normalize(wo, dim=1)
    wi = Vec3(*(torch.full((50,), float(number), dtype=torch.float64) for number in WI))
    value, _ = phase.kind().eval_pdf(table_of(phase), place(50), wi, Vec3.of(wo))
    interaction = mi.MediumInteraction3f()
    interaction.p, interaction.wi = mi.Point3f(0.4, 0.7, 0.55), mi.Vector3f(*WI.tolist())
    interaction.sh_frame = mi.Frame3f(interaction.wi)
    for number in range(50):
        expected, _ = wanted.eval_pdf(mi.PhaseFunctionContext(None), interaction, mi.Vector3f(*wo[number].tolist()))
        assert float(value[number]) == pytest.approx(float(expected[0]), rel=2e-4, abs=1e-6)


@pytest.mark.parametrize("described, message", [
    ({"type": "hg", "g": 1.0}, "g must be"),
    ({"type": "tabphase", "values": "1"}, "values of tabphase must be at least two, got 1"),
    ({"type": "tabphase", "values": "1, -1"}, "values must be at least 0, got -1"),
    ({"type": "tabphase", "values": "0, 0"}, "values of tabphase must not all be 0"),
    ({"type": "tabphase", "values": "1, x"}, "values must be made of numbers"),
    ({"type": "tabphase", "values": [1.0, float("inf")]}, "values must be finite"),
    ({"type": "sggx", "S": [1.0, 1.0, 1.0, 2.0, 0.0, 0.0]}, "S of sggx must be positive definite, .* eigenvalue -1"),
    ({"type": "sggx", "S": [1.0, 1.0, 1.0]}, r"S must have shape \(6,\), got \(3,\)"),
    ({"type": "sggx", "S": {"type": "constvolume"}}, "S of sggx must have 6 channels, got a constvolume of 3"),
    ({"type": "blendphase", "weight": 0.5, "a": {"type": "hg"}}, "blendphase takes two phase functions, got .'hg'."),
    ({"type": "blendphase", "weight": 1.5, "a": {"type": "hg"}, "b": {"type": "hg"}},
     r"weight must be in \[0, 1\], got 1.5"),
])
def test_what_makes_no_sense_is_refused_by_name(described, message):
    with pytest.raises(ValueError, match=message):
        build_plugin(described, "phase")
