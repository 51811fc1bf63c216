"""Values and derivatives stay finite over the whole range of every parameter and direction, in both precisions."""

import itertools

import pytest
import torch

from tests.bsdf.lanes import LaneNumbers
from tests.deep import deep, deep_but
from torch_radbp.bsdf.conductor import ConductorKind
from torch_radbp.bsdf.dielectric import DielectricKind
from torch_radbp.bsdf.diffuse import DiffuseKind
from torch_radbp.bsdf.plastic import PlasticKind
from torch_radbp.bsdf.principled import FEATURES
from torch_radbp.bsdf.principled_lobes import PrincipledKind
from torch_radbp.bsdf.principledthin import FEATURES as SHEET
from torch_radbp.bsdf.principledthin import PrincipledThinKind
from torch_radbp.bsdf.rough_coat import coat_of
from torch_radbp.bsdf.roughconductor import RoughConductorKind
from torch_radbp.bsdf.roughdielectric import RoughDielectricKind
from torch_radbp.bsdf.roughplastic import RoughPlasticKind
from torch_radbp.bsdf.thindielectric import ThinDielectricKind
from torch_radbp.check.finite import COSINE, partners, random_corners, troubles_of_evaluation, troubles_of_samples, viewers
from torch_radbp.tensors.vec import Vec3

ALPHA = (0.0, 1e-4, 1e-3, 0.1, 1.0)
ETA = (0.3, 0.66, 1 - 1e-7, 1.0, 1 + 1e-7, 1.5, 3.0)
INDEX = ((0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (0.5, 0.0), (1.5, 0.0), (0.14, 4.0), (1e-6, 1e-6), (9.0, 9.0))
COLOUR = (0.0, 1.0)
SPECULAR = (0.0, 0.5, 1.0)
KINDS = {
    "diffuse": DiffuseKind(), "conductor": ConductorKind(), "dielectric": DielectricKind(),
    "pane": ThinDielectricKind(),
    **{f"{'brushed ' * a}{name} {d}": kind(d, a) for d in ("beckmann", "ggx") for a in (False, True)
       for name, kind in (("metal", RoughConductorKind), ("glass", RoughDielectricKind))},
    **{f"{'nonlinear ' * n}plastic": PlasticKind(nonlinear=n) for n in (False, True)},
    **{f"{'nonlinear ' * n}rough plastic {d}": RoughPlasticKind(d, nonlinear=n) for d in ("beckmann", "ggx")
       for n in (False, True)},
    "principled": PrincipledKind(FEATURES, True, (1.0, 1.0, 1.0)),
    "principled glass": PrincipledKind(("metallic", "spec_trans"), False, (1.0, 1.0, 1.0)),
    "principled plastic": PrincipledKind((), True, (1.0, 1.0, 1.0)),
    "principled sheet": PrincipledThinKind(SHEET, (1.0, 1.0, 1.0, 1.0)),
    "principled film": PrincipledThinKind(("eta", "spec_trans"), (1.0, 1.0, 1.0, 1.0)),
}
SOME = ("diffuse", "dielectric", "brushed metal beckmann", "glass ggx", "plastic", "rough plastic beckmann", "principled",
        "principled film")  # which are sampled quickly
TOGETHER = 15  # random numbers that are tested at once


def grid(kind, dtype):
    """Values and directions: every combination of the extremes, and the random numbers 0.3."""
    rough = [ALPHA] * getattr(kind, "anisotropic", False) + [ALPHA] if hasattr(kind, "distribution") else []
    if isinstance(kind, DiffuseKind):
        optics = [[(c,) for c in COLOUR]]
    elif isinstance(kind, (ConductorKind, RoughConductorKind)):
        optics = [[(eta, k, c) for (eta, k), c in itertools.product(INDEX, COLOUR)]]
    elif isinstance(kind, (PrincipledKind, PrincipledThinKind)):
        count = len(kind.features) - kind.has("eta")  # eta is not a share; its place is the first
        shares = [(0,) * count, (1,) * count, *(tuple(int(k != other) for k in range(count)) for other in range(count))]
        optics = [[(c, rough, index, *share) for c, rough, index, share in itertools.product(
            COLOUR, COLOUR, SPECULAR if getattr(kind, "by_specular", False) else ETA, shares)]]
    elif isinstance(kind, (PlasticKind, RoughPlasticKind)):
        optics = [list(itertools.product(ETA, COLOUR, COLOUR))]
    else:
        optics = [[(eta, c, c) for eta, c in itertools.product(ETA, COLOUR)]]
    rows = [(*row[:-2], *row[-2], row[-1]) for row in itertools.product(*rough, *optics, COSINE)]
    columns = torch.tensor(rows, dtype=torch.float64).to(dtype).unbind(1)
    values = tuple(Vec3(c.clone(), c.clone(), c.clone()) for c in columns[:-1])
    if isinstance(kind, RoughPlasticKind):
        values = (*values[:2], *coats(kind.distribution, values[0].x, values[1].x), *values[2:])
    assert len(values) == kind.slots
    return values, viewers(columns[-1])


def coats(distribution: str, alpha, eta) -> list[Vec3]:
    """The numbers that describe the coats of a rough plastic, three at a time."""
    rows = [coat_of(distribution, *pair).numbers for pair in zip(alpha.double().tolist(), eta.double().tolist())]
    return [Vec3.of(part) for part in torch.stack(rows).to(alpha).split(3, 1)]


@pytest.mark.parametrize("dtype", [torch.float32, deep(torch.float64)], ids=str)
@pytest.mark.parametrize("name", deep_but(SOME, KINDS))
def test_sampling_stays_finite(name, dtype):
    kind = KINDS[name]
    values, wi = grid(kind, dtype)
    corners = random_corners(kind)
    for first in range(0, len(corners), TOGETHER):
        assert not list(troubles_of_samples(kind, values, wi, corners[first:first + TOGETHER]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", KINDS)
def test_evaluation_stays_finite(name, dtype):
    kind = KINDS[name]
    values, wi = grid(kind, dtype)
    assert not list(troubles_of_evaluation(kind, values, wi))
    assert any((kind.pdf(values, wi, wo) > 0).any() for wo in partners(wi)) or not kind.smooth


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_rough_glass_between_nearly_equal_indices_still_samples_what_it_evaluates(distribution):
    """Equal indices bend nothing: all light goes straight through, and the weight of a sample stays near one."""
    kind, count = RoughDielectricKind(distribution), 1000
    generator = torch.Generator().manual_seed(0)
    for dtype, eta in itertools.product((torch.float32, torch.float64), (1.0, 1.0 + 1e-7, 0.9999)):
        full = [torch.full((count,), value, dtype=dtype) for value in (0.3, eta, 1.0, 1.0)]
        values = tuple(Vec3(c, c, c) for c in full)
        wi = Vec3(*(torch.full((count,), c, dtype=dtype) for c in (0.6, 0.0, 0.8)))
        random = LaneNumbers(*torch.rand(3, count, generator=generator).to(dtype).unbind())
        choice = kind.choose(values, wi, *random)
        wo = kind.sample(values, wi, choice, random.u, random.v)
        assert (choice.lobe == 1).all()
        assert (wo.x + wi.x).abs().mean() < 0.01 and (wo.z + wi.z).abs().mean() < 0.01
        weight = kind.eval(values, wi, wo).x / kind.pdf(values, wi, wo)
        assert (weight.median() - 1).abs() < 0.05 and (weight > 0).double().mean() > 0.98
