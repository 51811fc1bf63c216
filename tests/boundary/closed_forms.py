"""A view of the unit square, a glow before the dark, and derivatives of sums over the image: those have closed forms."""

from __future__ import annotations

import torch

import torch_radbp as rb
from tests.gradients import relative_error, unwarned_renderer
from tests.scenes import overhead, rgb

SIZE = 16
DARK = {"type": "constant", "radiance": rgb(0.25, 0.25, 0.25)}
GLOW = {"emitter": {"type": "area", "radiance": rgb(3, 2, 1)}}
JUMP = torch.tensor([2.75, 1.75, 0.75], dtype=torch.float64)  # of radiance between the two


def parallel(size: int = SIZE, rfilter: str = "box") -> dict:
    """A view of x and y from -1 to 1, x to the right, from z = 3; pixels are 2 / size wide."""
    return overhead(size, 3.0, rfilter=rfilter)


def derivative(scene: rb.Scene, name: str, direction: torch.Tensor, weights: torch.Tensor | None = None, spp: int = 1024,
               **settings) -> torch.Tensor:
    """(1,) of the sum of the weighted image, depth 1, its channels mixed, when a parameter moves in a direction."""
    parameter = scene.get_parameter(name).requires_grad_()
    image = unwarned_renderer(scene, spp=spp, **{"max_depth": 1, **settings})(seed=1)[0]
    gradient, = torch.autograd.grad(mixed((image if weights is None else image * weights).sum((1, 2))), parameter)
    return (gradient * direction).sum()[None]


def mixed(channels: torch.Tensor) -> torch.Tensor:
    """() of (3,) numbers, of which each counts for another share: whichever is wrong is noticed in one backward pass."""
    return channels @ torch.tensor([1.0, 0.7, 0.4]).to(channels)


def along(axis: int) -> torch.Tensor:
    """The direction in which a pose moves along an axis of the world."""
    direction = torch.zeros(4, 4, dtype=torch.float64)
    direction[axis, 3] = 1.0
    return direction


def assert_close(found: torch.Tensor, expected: torch.Tensor, share: float = 0.01) -> None:
    """Numbers agree; found may be a mixture of channels that are expected."""
    expected = mixed(expected)[None] if len(expected) == 3 != len(found) else expected
    assert torch.isfinite(expected).all() and expected.abs().min() > 0
    assert relative_error(found, expected) < share, (found, expected)
