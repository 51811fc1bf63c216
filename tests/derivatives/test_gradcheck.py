"""`torch.autograd.gradcheck`, float64 and slow, of the renderer: every plugin, every parameter, every way of sampling.

Attached: of the image at one seed, discrete choices held. Detached and hybrid: of the image with proposal and hits held; see
`tests/derivatives/frozen.py`. Values are the forward pass's, derivatives the backward pass's. Of parameters with many
entries some are moved alone, and all together in random directions; with `EVERY_ENTRY=1` in the environment each is. Quick
cases move each parameter in one direction.

Tolerances are tighter than gradcheck's own (1e-3 relative): central differences with a step of 1e-6 of sums of size 1 are
right to 1e-16 / 1e-6 by rounding, times the hundreds of operations that make a sum.
"""

import os

import pytest
import torch
from torch import Tensor
from torch.autograd.gradcheck import GradcheckError

from tests.deep import deep
from tests.derivatives.frozen import Rendering
from tests.scenes.every_plugin import SCENES, build, subjects
from torch_radbp.scene.packing.pack import pack

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
SETTINGS = {"spp": 4, "max_depth": 4, "rr_depth": 100}
SEED = 6
FEW = 3  # entries of a parameter that are all checked
PROJECTIONS = 2  # random sums of all pixels, of which the derivative is taken
STEP, ABSOLUTE, RELATIVE = 1e-6, 1e-8, 1e-6
SMALLEST = 1e-4  # of the greatest derivative by a parameter; the sums have size 1
# Scenes in which hybrid sampling is not detached sampling.
FOLLOWED = ("conductor", "dielectric", "pane", "plastic", "blend", "blend of deltas", "mirror with a normal map",
            "mirror with a bump map", "rough glass beckmann", "rough glass ggx", "brushed glass beckmann",
            "brushed glass ggx", "blend of glasses", "frosted leaf", "glass with bumps", "moving rough glass",
            "mirror of trilinear normals", "glass with trilinear tint")
CASES = [(name, sampling) for name in SCENES for sampling in ("attached", "detached", "hybrid")
         if sampling != "hybrid" or name in FOLLOWED]
# Plugins of each kind that take little time; media have `medium`, and of all materials `bsdf` examines the local functions.
QUICK = (("rough glass ggx", "hybrid"), ("trilinear on a mesh", "attached"), ("checkerboard", "detached"),
         ("calibrated", "attached"), ("flat mesh", "detached"), ("envmap", "attached"), ("spot", "detached"))


def directions(gradient: Tensor, seed: int, single: bool) -> Tensor:
    """(entries, k) in which a parameter is moved: each entry; or those of greatest derivative, and random ones; or a
    single one."""
    count = gradient.numel()
    if single:  # of random numbers, in which whatever entry is wrong shows
        return torch.randn(count, 1, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    unit = torch.eye(count, dtype=torch.float64)
    if count <= FEW or os.environ.get("EVERY_ENTRY"):
        return unit
    random = torch.randn(count, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.cat([unit[:, gradient.flatten().argsort(descending=True)[:2]], random], 1)


class HeldRendering(torch.autograd.Function):
    """Sums of pixels with decisions held; their derivative as the renderer computes it."""

    @staticmethod
    def forward(ctx, value, jacobians, *inputs):
        ctx.jacobians = jacobians
        return value(inputs)

    @staticmethod
    def backward(ctx, adjoint):
        return None, None, *(adjoint @ jacobian for jacobian in ctx.jacobians)


def projections_of(image: Tensor) -> Tensor:
    """(PROJECTIONS, pixels) that make sums of the image's pixels of about size 1."""
    generator = torch.Generator().manual_seed(2)
    random = torch.randn(PROJECTIONS, image.numel(), generator=generator, dtype=torch.float64)
    return random / image.norm()


@pytest.mark.parametrize("name, sampling, single", [
    *((*case, True) for case in QUICK), *(deep(*case, False) for case in CASES)])
def test_gradcheck(name, sampling, single):
    scene = build(name)
    names = subjects(scene)
    rendering = Rendering(scene, names, SEED, sampling=sampling, **SETTINGS)
    start = [scene.get_parameter(parameter).detach().clone().requires_grad_() for parameter in names]
    image = rendering.live(start)
    assert torch.isfinite(image).all() and image.min() >= 0 and image.max() > 0
    projections = projections_of(image.detach())
    rows = [torch.autograd.grad(image, start, row.view_as(image), retain_graph=True) for row in projections]
    gradients = [torch.stack(parts).reshape(PROJECTIONS, -1) for parts in zip(*rows)]
    bases = [directions(gradient.abs().amax(0), seed, single) for seed, gradient in enumerate(gradients)]
    for parameter, gradient in zip(names, gradients):
        assert torch.isfinite(gradient).all(), parameter
        largest = float(gradient.abs().max())
        assert largest > SMALLEST, f"{parameter} does not matter in the scene {name!r}: derivative {largest:.1e}"

    kinds = [appearance.kind for appearance in pack(scene).layout.appearances]
    forward = sampling == "attached" and not any(kind.discrete and kind.smooth for kind in kinds)
    held = rendering.with_choices_held if forward else rendering.along_the_tape

    def value(inputs):
        moved = [(x.detach().flatten() + basis @ step).view_as(x) for x, basis, step in zip(start, bases, inputs)]
        return projections @ held(moved).detach().flatten()

    jacobians = [gradient @ basis for gradient, basis in zip(gradients, bases)]
    steps = [torch.zeros(basis.shape[1], dtype=torch.float64, requires_grad=True) for basis in bases]
    assert torch.allclose(value(steps), projections @ image.detach().flatten(), rtol=1e-12, atol=1e-14)
    try:
        torch.autograd.gradcheck(lambda *inputs: HeldRendering.apply(value, jacobians, *inputs), steps, eps=STEP,
                                 atol=ABSOLUTE, rtol=RELATIVE)
    except GradcheckError as error:
        raise AssertionError(f"{name}, {sampling}, inputs {dict(enumerate(names))}: {error}") from None
