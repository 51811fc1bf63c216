"""Functions that tests compile, their arguments and results."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.lane.graph import LANES, NUMBER, TABLE
from torch_radbp.jit.lane.trace import traced_program
from torch_radbp.jit.scatter import Addition, Sums


class Point(NamedTuple):
    x: Tensor
    y: Tensor | None


def mixed(point: Point, colours: tuple, index: Tensor, scale: Tensor, power: int):
    """Something of everything: tables, numbers, constants, a derivative inside, results of several dtypes."""
    x = point.x.detach().clone().requires_grad_()
    with torch.enable_grad():
        value = (torch.sin(x) ** power * scale).exp()
        slope, = torch.autograd.grad(value, [x], torch.ones_like(x))
    red = colours[0].index_select(0, index)
    near = (red < 0.5) & (slope > 0)
    return Point(torch.where(near, slope, red), None), [index + 1, near, index], value.detach()


def arguments(lanes: int, dtype: torch.dtype = torch.float32):
    generator = torch.Generator().manual_seed(3)
    x = torch.randn(lanes, generator=generator, dtype=dtype)
    index = torch.randint(7, (lanes,), generator=generator).to(torch.int32)
    return Point(x, None), (torch.rand(7, generator=generator, dtype=dtype),), index, torch.tensor(0.7, dtype=dtype), 3


def assert_close(found, expected, rtol: float) -> None:
    """The same nesting, types and numbers."""
    assert type(found) is type(expected)
    if isinstance(expected, Tensor):
        assert found.dtype == expected.dtype and not found.requires_grad
        torch.testing.assert_close(found, expected, rtol=rtol, atol=1e-6 if rtol > 1e-8 else 1e-14)
    elif isinstance(expected, (tuple, list)):
        assert len(found) == len(expected)
        for a, b in zip(found, expected):
            assert_close(a, b, rtol)
    else:
        assert found == expected


def addition(lanes: int, entries: int, tables: int, copies: int, dtype: torch.dtype) -> Addition:
    generator = torch.Generator().manual_seed(lanes)
    index = torch.randint(entries, (lanes,), generator=generator, dtype=torch.int32)
    numbers = [torch.randn(lanes, generator=generator, dtype=dtype) for _ in range(tables)]
    totals = [torch.zeros(entries, copies, dtype=torch.float64) for _ in range(tables)]
    return Addition(index, numbers, Sums(totals, torch.zeros(-(-entries // 16), dtype=torch.bool)))


def shaded(table, index, x, scale):
    return [table.index_select(0, index) * x * scale + 1.0, x * scale]


PROGRAM = traced_program(shaded, [torch.float32, torch.int32, torch.float32, torch.float32], [TABLE, LANES, LANES, NUMBER])
