"""Numbers at the edges of every dtype, and bits that are the same."""

from __future__ import annotations

import math

import torch

DTYPES = (torch.bool, torch.int32, torch.float32, torch.float64, torch.int64)

EDGES = {
    torch.float32: [0.0, -0.0, 1.0, -1.0, 0.5, 1.5, 2.5, -2.5, math.inf, -math.inf, math.nan, 1e-45, -1e-45, 1.17549435e-38,
                    3.4028235e38, -3.4028235e38, 16777217.0, 0.49999997],
    torch.float64: [0.0, -0.0, 1.0, -1.0, 0.5, 1.5, 2.5, -2.5, math.inf, -math.inf, math.nan, 5e-324, -5e-324, 2.3e-308,
                    1.7976931348623157e308, -1.7976931348623157e308, 2.0**53 + 1, 0.49999999999999994],
    torch.int32: [0, 1, -1, 2, 7, -7, 2**31 - 1, -(2**31)],
    torch.int64: [0, 1, -1, 2, 7, -7, 2**63 - 1, -(2**63)],
    torch.bool: [False, True],
}


def pairs(dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor]:
    """Every pair of edge values, and random values."""
    edges = torch.tensor(EDGES[dtype], dtype=dtype)
    a, b = (column.clone() for column in torch.cartesian_prod(edges, edges).unbind(1))
    generator = torch.Generator().manual_seed(1)
    if dtype.is_floating_point:
        more = 10 ** torch.empty(2, 333).uniform_(-3, 3, generator=generator) * torch.randn(2, 333, generator=generator)
    else:
        more = torch.randint(-1000, 1000, (2, 333), generator=generator)
    more = more.to(dtype)
    return torch.cat([a, more[0]]), torch.cat([b, more[1]])


def assert_same(found: torch.Tensor, expected: torch.Tensor) -> None:
    """Equal to the last bit, signs of zeros too; NaN is NaN."""
    assert found.dtype == expected.dtype and found.shape == expected.shape
    if expected.dtype.is_floating_point:
        assert torch.equal(found.isnan(), expected.isnan())
        known = ~expected.isnan()
        found, expected = found[known], expected[known]
        assert torch.equal(found.signbit(), expected.signbit())
    assert torch.equal(found, expected)
