"""Gradients of renderings, and how far two of them are apart."""

from __future__ import annotations

import math

import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes import parameters

STRIDES = (1, 2, 3, 7, "sqrt", "log")
MEMOIZED = tuple(rb.MemoizedAdjoint(stride, keep_hits) for stride in STRIDES for keep_hits in (True, False))
QUADRATIC = (rb.QuadraticAdjoint(), rb.QuadraticAdjoint(keep_hits=False))
REPLAY = (rb.ReplayAdjoint(), rb.ReplayAdjoint(keep_hits=False))
# One of each kind: strides that end a segment at every bounce, at others, and where few states are kept; hits kept or not.
SOME = (rb.MemoizedAdjoint(1), rb.MemoizedAdjoint(2, keep_hits=False), rb.MemoizedAdjoint(3),
        rb.MemoizedAdjoint("log", keep_hits=False), rb.QuadraticAdjoint(), *REPLAY)
MOVED = (rb.MemoizedAdjoint(1), rb.MemoizedAdjoint("log", keep_hits=False), rb.QuadraticAdjoint(), *REPLAY)
FEW = (rb.MemoizedAdjoint("log", keep_hits=False), rb.ReplayAdjoint())  # where the others are taken in a scene much like it
EXACT = (*MEMOIZED, *QUADRATIC, rb.TapeAdjoint())


def cotangent(image: Tensor, seed: int = 0) -> Tensor:
    """Normal numbers in the shape of an image: no symmetry in which a wrong gradient could cancel."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(image.shape, generator=generator, dtype=torch.float64, device="cpu").to(image)


def unwarned_renderer(scene: rb.Scene, **settings) -> rb.Renderer:
    """A renderer that does not look for what its derivatives lack, which takes longer than a small image."""
    renderer = rb.Renderer(scene, **settings)
    renderer.jump_watch.looks.clear()
    return renderer


def image_and_gradients(scene: rb.Scene, names, *, seed: int = 3, sensors=None, adj_image: Tensor | None = None,
                        **settings) -> tuple[Tensor, list[Tensor]]:
    """An image, and the gradients of <adj_image, image> for the parameters called `names`."""
    wanted = parameters(scene, names)
    image = unwarned_renderer(scene, **settings)(seed=seed, sensors=sensors)
    adj_image = cotangent(image.detach()) if adj_image is None else adj_image
    return image.detach(), list(torch.autograd.grad(image, wanted, adj_image))


def gradients_by_seed(scene: rb.Scene, names, seeds, adj_image: Tensor, **settings) -> list[list[Tensor]]:
    """The gradients of <adj_image, image> for the parameters called `names`, of an image for each seed."""
    wanted, renderer = parameters(scene, names), unwarned_renderer(scene, **settings)
    return [list(torch.autograd.grad(renderer(seed=seed), wanted, adj_image)) for seed in seeds]


def assert_transposed(scene: rb.Scene, *names: str, **settings) -> None:
    """Forward mode and the backward pass by parameters of float64, all at once, are transposes of each other."""
    parameters = [scene.get_parameter(name) for name in names]
    tangents = [torch.linspace(0.5, 1.0, parameter.numel(), dtype=torch.float64).view_as(parameter)
                for parameter in parameters]
    forward = rb.jvp(scene, dict(zip(names, tangents)), seed=1, **settings)
    w = cotangent(forward)
    _, gradients = image_and_gradients(scene, names, seed=1, adj_image=w, **settings)
    parts = [float((gradient * tangent).sum()) for gradient, tangent in zip(gradients, tangents)]
    expected = float((w * forward).sum())
    assert math.isfinite(expected) and expected != 0
    assert all(abs(part) > 1e-4 * abs(expected) for part in parts)  # what either leaves out would be noticed
    assert math.isclose(sum(parts), expected, rel_tol=1e-9)


def assert_informative(image: Tensor, gradients: list[Tensor]) -> None:
    """A reference must be finite, and must not be zero."""
    for value in (image, *gradients):
        assert torch.isfinite(value).all()
        assert value.abs().max() > 0


def relative_error(value: Tensor, reference: Tensor) -> float:
    """The greatest difference, in units of the greatest reference value."""
    return float((value - reference).abs().max() / reference.abs().max())


def z_score(samples: Tensor, expected: Tensor) -> float:
    """How many standard errors the mean of independent `samples` (R, ...) lies from `expected`, at worst.

    Entries without variance must be right to rounding.
    """
    error, standard_error = samples.mean(0) - expected, samples.std(0) / math.sqrt(len(samples))
    certain = standard_error <= 1e-13 * expected.abs()
    assert not certain.all()
    assert (error.abs() <= 1e-12 * expected.abs())[certain].all()
    return float((error / standard_error)[~certain].abs().max())
