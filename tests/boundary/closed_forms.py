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
    """(3,) of the sums of the weighted channels of the image, depth 1, when a parameter moves in a direction."""
    parameter = scene.get_parameter(name).requires_grad_()
    image = unwarned_renderer(scene, spp=spp, **{"max_depth": 1, **settings})(seed=1)[0]
    sums = (image if weights is None else image * weights).sum((1, 2))
    return torch.stack([(torch.autograd.grad(channel, parameter, retain_graph=True)[0] * direction).sum()
                        for channel in sums])


def along(axis: int) -> torch.Tensor:
    """The direction in which a pose moves along an axis of the world."""
    direction = torch.zeros(4, 4, dtype=torch.float64)
    direction[axis, 3] = 1.0
    return direction


def assert_close(found: torch.Tensor, expected: torch.Tensor, share: float = 0.01) -> None:
    assert torch.isfinite(expected).all() and expected.abs().min() > 0
    assert relative_error(found, expected) < share, (found, expected)
