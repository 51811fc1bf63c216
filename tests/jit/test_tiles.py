"""Recordings that are run tile by tile do what they do one after the other, whoever goes on and however many threads."""

import pytest
import torch
from torch import Tensor

from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.jit.order import chosen, put
from torch_radbp.jit.recording.recording import ALL, NotRecordable, Recording, listening, outside
from torch_radbp.jit.recording.results import RecordedInputs
from torch_radbp.jit.tiles import TILE, TileStep, handed, run_in_tiles
from torch_radbp.threads.team import alone_in_torch

STEPS = 4
HALF, LARGE = LaneFunction(lambda x: 0.5 * x), LaneFunction(lambda x: x > 0.1)
GATHERED = LaneFunction(lambda x, lanes: torch.index_select(x, 0, lanes), ("x",))


def halved(x: Tensor, lane: Tensor, total: Tensor) -> tuple[Tensor, Tensor]:
    """Writes half of what lanes have to their places in `total`; those that still have much, go on with it."""
    half = HALF(x)
    put((total,), lane, (half,))
    alive = chosen(LARGE(half))
    return GATHERED(half, alive), GATHERED(lane, alive)


def recorded(function, contexts: tuple = ()) -> Recorded:
    given = [torch.empty(ALL), torch.empty(ALL, dtype=torch.int32), torch.empty(ALL)]
    listener = Recording(given, contexts=contexts)
    with torch.no_grad(), listening(listener):
        results = function(*given)
    return Recorded(listener, given, results)


def in_tiles(x: Tensor, total: Tensor, threads: int) -> None:
    made, lane = recorded(halved), torch.arange(len(x), dtype=torch.int32)
    steps = [TileStep(made, handed(made), RecordedInputs([x, lane, total]), 2) for _ in range(STEPS)]
    with alone_in_torch(threads=threads):
        assert run_in_tiles(steps, len(x)) == 0  # rays


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("lanes", [1, TILE - 1, TILE, 3 * TILE + 5, 70_000])
def test_tiles_are_taken_through_all_recordings(lanes, threads):
    x = torch.rand(lanes, generator=torch.Generator().manual_seed(lanes)) + 0.001
    mine, expected, left, lane = torch.zeros(lanes), torch.zeros(lanes), x, torch.arange(lanes, dtype=torch.int32)
    for _ in range(STEPS):
        if len(left):
            left, lane = halved(left, lane, expected)
    in_tiles(x, mine, threads)
    assert bool((expected > 0).all()) and torch.equal(mine, expected)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_tile_in_which_nobody_goes_on_ends_alone(threads):
    x, total = torch.zeros(2 * TILE + 7), torch.full((2 * TILE + 7,), -1.0)
    x[TILE:2 * TILE] = 0.9
    in_tiles(x, total, threads)
    expected = torch.zeros_like(x)
    expected[TILE:2 * TILE] = 0.9 / 8 / 2
    assert torch.equal(total, expected)


def given_back(x: Tensor, lane: Tensor, total: Tensor) -> tuple[Tensor, Tensor]:
    return HALF(x), lane


def answered(x: Tensor, lane: Tensor, total: Tensor) -> tuple[Tensor, ...]:
    return tuple(outside(lambda context, given: [[own + 1] for own, in given], ANSWERS, [(x,)], [1])[0])


ANSWERS = "who answers"


@pytest.mark.parametrize(("function", "why"), [(given_back, "not made by a loop"), (answered, "done for all lanes")])
def test_what_was_given_or_is_done_outside_cannot_be_handed_on(function, why):
    made = recorded(function, (ANSWERS,))
    with pytest.raises(NotRecordable, match=why):
        handed(made)
