"""Queues of lanes and entries in their places, against torch's own functions."""

import re
from pathlib import Path

import pytest
import torch

import torch_radbp
from torch_radbp.jit.order import chosen, in_order, partition, put

COUNTS = [0, 1, 15, 17, 100_003]


@pytest.mark.parametrize("dtype", [torch.bool, torch.int8, torch.int32, torch.int64], ids=str)
@pytest.mark.parametrize("lanes", COUNTS)
def test_lanes_come_queue_by_queue_in_their_order(lanes, dtype):
    queues = 2 if dtype == torch.bool else 7
    number = torch.randint(0, queues - (queues > 2), (lanes,), generator=torch.Generator().manual_seed(1)).to(dtype)
    order, counts = partition(number, queues)
    assert order.dtype == torch.int32 and len(counts) == queues
    assert torch.equal(order.long(), number.to(torch.int64).sort(stable=True).indices)
    assert list(counts) == torch.bincount(number.long(), minlength=queues).tolist()


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("lanes", COUNTS)
def test_lanes_are_chosen_by_flags(lanes, share):
    flags = torch.rand(lanes, generator=torch.Generator().manual_seed(3)) < share
    assert chosen(flags).dtype == torch.int32
    assert torch.equal(chosen(flags).long(), flags.nonzero().squeeze(1))
    assert torch.equal(chosen(flags[::2]).long(), flags[::2].nonzero().squeeze(1))


def test_a_part_of_a_tensor_is_partitioned():
    number = torch.tensor([1, 0, 1, 0, 0, 1])
    order, counts = partition(number[1:5], 2)
    assert order.tolist() == [0, 2, 3, 1] and list(counts) == [3, 1]
    order, _ = partition(number[::2], 2)
    assert order.tolist() == [2, 0, 1]


@pytest.mark.parametrize("dtype", [torch.bool, torch.int32, torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("lanes", COUNTS)
def test_entries_are_put_into_their_places(lanes, dtype):
    generator = torch.Generator().manual_seed(2)
    place = torch.randperm(2 * lanes + 3, generator=generator)[:lanes]
    targets = [torch.rand(2 * lanes + 3, generator=generator).mul(9).to(dtype), torch.arange(2 * lanes + 3)]
    entries = [torch.rand(lanes, generator=generator).mul(9).to(dtype), -torch.arange(lanes)]
    expected = [target.index_copy(0, place, entry) for target, entry in zip(targets, entries)]
    put(targets, place.to(torch.int32), entries)
    assert all(map(torch.equal, targets, expected))


def test_entries_of_another_dtype_or_number_are_refused():
    place = torch.tensor([0, 1], dtype=torch.int32)
    for entry in (torch.zeros(2, dtype=torch.float64), torch.zeros(3)):
        with pytest.raises(ValueError, match="2 entries of torch.float32"):
            put([torch.zeros(4)], place, [entry])


def test_no_machine_code_is_kept_where_a_second_thread_could_free_it():
    """As `functools.cache` may: see `made_once`."""
    files = [path for path in Path(torch_radbp.__file__).parent.rglob("*.py")
             if re.search("MachineCode|machine import .*cached_code", path.read_text())]
    assert len(files) > 4
    wrong = [str(path) for path in files if path.name != "machine.py" and "functools.cache" in path.read_text()]
    assert not wrong, wrong


@pytest.mark.parametrize("lanes, queues", [(0, 3), (1, 1), (1000, 7), (5000, 1300)])
def test_lanes_come_in_the_order_of_two_numbers_and_else_in_their_own(lanes, queues):
    """In few queues lanes are so many that they are partitioned twice; in many each queue is sorted by itself."""
    generator = torch.Generator().manual_seed(lanes)
    major, minor = torch.randint(queues, (2, lanes), generator=generator, dtype=torch.int32)
    order, *sorted_numbers = in_order(major, minor, queues)
    expected = sorted(range(lanes), key=lambda lane: (int(major[lane]), int(minor[lane]), lane))
    assert order.dtype == torch.int32 and order.tolist() == expected
    assert all(torch.equal(found, number[expected]) for found, number in zip(sorted_numbers, (major, minor)))
