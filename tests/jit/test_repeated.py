"""Functions of lanes that a kernel repeats by itself: turn after turn, until the flag of the lane is false."""

from __future__ import annotations

from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from tests.jit.emulated import emulated
from tests.jit.interpreter import interpreted, needs_interpreter
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.tensors.vec import rows

LANES, PLACES = 1000, 37


class Walk(NamedTuple):
    """Lanes that walk over places, (N,) each."""

    place: Tensor  # int32
    before: Tensor  # int32, where they came from
    sum: Tensor  # of what they have found
    steps: Tensor  # int32
    running: Tensor  # bool
    name: Tensor  # int32, stays as it is


def walked(height: Tensor, factor: Tensor, walk: Walk, lanes: Tensor, limit: Tensor) -> Walk:
    """One step: to a place that depends on the two before, until the limit is reached."""
    walk, factor = rows((walk, factor), lanes)
    place = (walk.place * 5 + walk.before * 3 + 1) % PLACES
    total = walk.sum + height.index_select(0, place) * factor
    return Walk(place, walk.place, total, walk.steps + 1, total < limit, walk.name)


def given(lanes: int = LANES) -> tuple[Tensor, Tensor, Walk, Tensor, Tensor]:
    """Heights, factors, lanes that have not begun, those of them that do, and their limits."""
    generator = torch.Generator().manual_seed(3)
    height, factor = (0.1 + torch.rand(count, generator=generator) for count in (PLACES, lanes))
    place, before = (torch.randint(PLACES, (lanes,), generator=generator, dtype=torch.int32) for _ in range(2))
    walk = Walk(place, before, torch.zeros(lanes), torch.zeros(lanes, dtype=torch.int32),
                torch.ones(lanes, dtype=torch.bool), torch.arange(lanes, dtype=torch.int32))
    chosen = torch.arange(0, lanes, 3, dtype=torch.int32).flip(0)
    limit = 40 * torch.rand(len(chosen), generator=generator)
    limit[0] = 0.0
    return height, factor, walk, chosen, limit


def turn_by_turn(height: Tensor, factor: Tensor, walk: Walk, lanes: Tensor, limit: Tensor) -> Walk:
    """The same by torch, one turn after the other."""
    found = rows(walk, lanes)
    factor, own = rows(factor, lanes), torch.arange(len(lanes), dtype=torch.int32)
    while len(own):
        on = walked(height, factor, found, own, limit[own])
        for target, new in zip(found, on):
            target[own] = new
        own = own[on.running]
    return found


def repeated(target) -> LaneFunction:
    return LaneFunction(walked, tables=("height", "factor", "walk"), target=target, repeats="walk")


def assert_walked(found: Walk, expected: Walk) -> None:
    assert expected.steps.min() == 1 and expected.steps.max() > 30 and not expected.running.any()
    for name in ("place", "before", "steps", "running", "name"):
        assert torch.equal(getattr(found, name), getattr(expected, name)), name
    torch.testing.assert_close(found.sum, expected.sum, rtol=1e-5, atol=0.0)


def test_a_kernel_goes_on_with_each_lane_until_its_flag_is_false():
    gpu, arguments = emulated(), given()
    assert_walked(repeated(gpu)(*arguments), turn_by_turn(*arguments))
    assert len(gpu.launcher.launches) == 1


def test_a_call_on_a_processor_takes_one_turn():
    arguments = given()
    found, expected = repeated(Cpu())(*arguments), walked(*arguments)
    for one, other in zip(found, expected):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=0.0)
    assert (found.steps == 1).all() and found.running.any()


@needs_interpreter
def test_ptx_goes_on_likewise():
    arguments = given(90)
    assert_walked(repeated(interpreted())(*arguments), turn_by_turn(*arguments))


def test_what_is_not_returned_anew_cannot_be_repeated():
    height, factor, walk, *rest = given()
    with pytest.raises(ValueError, match="returns 6 tensors in the place of 6 of 'walk', which must all be different"):
        repeated(emulated())(height, factor, walk._replace(before=walk.place), *rest)
