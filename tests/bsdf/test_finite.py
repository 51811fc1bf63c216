"""Values and derivatives stay finite over the whole range of every parameter and direction, in both precisions."""

import itertools
import math

import pytest
import torch

from tests.bsdf.lanes import Numbers
from tests.deep import deep, deep_but_every
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
from torch_radbp.tensors.vec import Vec3

ALPHA = (0.0, 1e-4, 1e-3, 0.1, 1.0)
ETA = (0.3, 0.66, 1 - 1e-7, 1.0, 1 + 1e-7, 1.5, 3.0)
INDEX = ((0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (0.5, 0.0), (1.5, 0.0), (0.14, 4.0), (1e-6, 1e-6), (9.0, 9.0))
COLOUR = (0.0, 1.0)
SPECULAR = (0.0, 0.5, 1.0)
COSINE = (1.0, 1 - 1e-7, 0.75**0.5, 0.5, 1e-3, 1e-7, 0.0, -1e-7, -1e-3, -0.5, -1.0)
NUMBER = (0.0, 2.0**-24, 0.3, 0.75, 1 - 2.0**-24)
ACROSS = (math.cos(0.9), math.sin(0.9))  # azimuth of wi

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
    z = columns[-1]
    r = torch.sqrt((1 - z.double()**2).clamp_min(0)).to(dtype)
    wi = Vec3(r * ACROSS[0], r * ACROSS[1], z.clone())
    assert len(values) == kind.slots
    return values, wi


def coats(distribution: str, alpha, eta) -> list[Vec3]:
    """The numbers that describe the coats of a rough plastic, three at a time."""
    rows = [coat_of(distribution, *pair).numbers for pair in zip(alpha.double().tolist(), eta.double().tolist())]
    return [Vec3.of(part) for part in torch.stack(rows).to(alpha).split(3, 1)]


def assert_finite(what: str, output, values, *vectors) -> None:
    """Output and its derivatives; a lane's cotangent is 1 in every component."""
    tensors = list(output) if isinstance(output, Vec3) else [output]
    names = [f"values[{k}].{c}" for k in range(len(values)) for c in "xyz"] + [f"w[{k}]" for k in range(3 * len(vectors))]
    leaves = [c for vector in (*values, *vectors) for c in vector]
    for tensor in tensors:
        assert torch.isfinite(tensor).all(), f"{what}: value, lanes {(~torch.isfinite(tensor)).nonzero()[:3].tolist()}"
        if not tensor.requires_grad:
            continue
        for name, grad in zip(names, torch.autograd.grad(tensor.sum(), leaves, allow_unused=True, retain_graph=True)):
            if grad is not None and not torch.isfinite(grad).all():
                lane = int((~torch.isfinite(grad)).nonzero()[0])
                at = [leaf[lane].item() for leaf in leaves]
                raise AssertionError(f"{what}: derivative in {name} is {grad[lane].item()} at {dict(zip(names, at))}")


def attached(values, wi):
    return (tuple(value.map(lambda c: c.clone().requires_grad_()) for value in values),
            wi.map(lambda c: c.clone().requires_grad_()))


@pytest.mark.parametrize("dtype", [torch.float32, deep(torch.float64)], ids=str)
@pytest.mark.parametrize("name", deep_but_every(2, KINDS))
def test_sampling_stays_finite(name, dtype):
    kind = KINDS[name]
    values, wi = attached(*grid(kind, dtype))
    corners = list(itertools.product(NUMBER, NUMBER)) if not getattr(kind, "anisotropic", False) else [(0.3, 0.75)]
    for (u, v), c in itertools.product(corners, (0.0, 0.5, 1 - 2.0**-24)):
        random = Numbers(*(torch.full_like(wi.z, number).detach() for number in (c, u, v)))
        choice = kind.choose(values, wi, *random)
        assert (choice.probability > 0).all() and (choice.probability <= 1).all()
        wo = kind.sample(values, wi, choice, random.u, random.v)
        length = wo.x**2 + wo.y**2 + wo.z**2
        assert (length - 1).abs().max() < 200 * torch.finfo(dtype).eps, (u, v, c)
        assert_finite(f"sample at {u, v}", wo, values, wi)
        if kind.delta:
            assert_finite("specular", kind.specular(values, wi, choice), values, wi)
        if not kind.smooth:
            continue
        # At the sampled direction, also with the derivative of that direction: what the tracer uses.
        assert_finite(f"eval at sample {u, v}", kind.eval(values, wi, wo), values, wi)
        assert_finite(f"pdf at sample {u, v}", kind.pdf(values, wi, wo), values, wi)
        assert_finite(f"density at sample {u, v}", kind.eval_pdf(values, wi, wo, fixed_lobes=True)[1], values, wi)
        pdf = kind.pdf(values, wi, wo).detach()
        weight = kind.eval(values, wi, wo) / pdf.clamp_min(1e-30)
        assert_finite("weight", weight * (pdf > 0).to(dtype), values, wi)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", KINDS)
def test_evaluation_stays_finite(name, dtype):
    kind = KINDS[name]
    values, wi = attached(*grid(kind, dtype))
    fixed = wi.detach()
    others = {
        "back along wi": -fixed, "along wi": fixed, "mirror": Vec3(-fixed.x, -fixed.y, fixed.z),
        "mirror below": Vec3(-fixed.x, -fixed.y, -fixed.z.abs()),
        **{f"z = {z}": Vec3(*(torch.full_like(fixed.z, c) for c in ((1 - z * z)**0.5, 0.0, z))) for z in COSINE},
        "horizon, across": Vec3(*(torch.full_like(fixed.z, c) for c in (-ACROSS[1], ACROSS[0], 0.0))),
    }
    positive = False
    for what, wo in others.items():
        wo = wo.map(lambda c: c.clone().requires_grad_())
        eval_, pdf = kind.eval(values, wi, wo), kind.pdf(values, wi, wo)
        positive |= bool((pdf > 0).any())
        assert (eval_.stack() >= 0).all() and (pdf >= 0).all()
        assert_finite(f"eval {what}", eval_, values, wi, wo)
        assert_finite(f"pdf {what}", pdf, values, wi, wo)
    assert positive or not kind.smooth


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_rough_glass_between_nearly_equal_indices_still_samples_what_it_evaluates(distribution):
    """Equal indices bend nothing: all light goes straight through, and the weight of a sample stays near one."""
    kind, count = RoughDielectricKind(distribution), 1000
    generator = torch.Generator().manual_seed(0)
    for dtype, eta in itertools.product((torch.float32, torch.float64), (1.0, 1.0 + 1e-7, 0.9999)):
        full = [torch.full((count,), value, dtype=dtype) for value in (0.3, eta, 1.0, 1.0)]
        values = tuple(Vec3(c, c, c) for c in full)
        wi = Vec3(*(torch.full((count,), c, dtype=dtype) for c in (0.6, 0.0, 0.8)))
        random = Numbers(*torch.rand(3, count, generator=generator).to(dtype).unbind())
        choice = kind.choose(values, wi, *random)
        wo = kind.sample(values, wi, choice, random.u, random.v)
        assert (choice.lobe == 1).all()
        assert (wo.x + wi.x).abs().mean() < 0.01 and (wo.z + wi.z).abs().mean() < 0.01
        weight = kind.eval(values, wi, wo).x / kind.pdf(values, wi, wo)
        assert (weight.median() - 1).abs() < 0.05 and (weight > 0).double().mean() > 0.98
