"""Tensors are compared bit by bit, on the CPU one by one, on a device all at once."""

import pytest
import torch

from torch_radbp.scene.cache.same_bits import MOST_FETCHED as FEW
from torch_radbp.scene.cache.same_bits import PART, SMALL, equal_on_device, numbers_on_host, same_bits

LARGE = (9 << 20) + 5  # numbers


@pytest.mark.parametrize("a, b, equal", [
    (torch.tensor([torch.nan, 1.0]), torch.tensor([torch.nan, 1.0]), True),
    (torch.tensor([0.0, 1.0]), torch.tensor([-0.0, 1.0]), False),
    (torch.arange(7.0), torch.arange(7.0), True),
    (torch.arange(9.0)[1:], torch.arange(9.0)[1:].clone(), True),
    (torch.arange(8.0)[1:4], torch.arange(8.0)[1:4].clone(), True),
    (torch.arange(12.0).reshape(3, 4).T, torch.arange(12.0).reshape(3, 4).T.clone(), True),
    (torch.ones(3).expand(2, 3), torch.ones(2, 3), True),
    (torch.ones(4), torch.ones(2, 2), False), (torch.ones(2), torch.ones(2, dtype=torch.float64), False),
    (torch.tensor([True, False, True]), torch.tensor([True, False, True]), True),
    (torch.tensor([True, False, True]), torch.tensor([True, False, False]), False),
    (torch.zeros(0, 3), torch.zeros(0, 3), True), (torch.tensor(2.0), torch.tensor(3.0), False),
])
def test_tensors_are_compared_bit_by_bit(a, b, equal):
    assert same_bits(a, b) == same_bits(b, a) == equal


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("place", [None, 0, 1_000_003, 4 << 20, -1])
def test_large_tensors_are_compared_to_the_last_bit(place, threads):
    assert 4 * LARGE > 2 * PART
    count = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        a = torch.arange(LARGE, dtype=torch.int32)
        b = a.clone()
        if place is not None:
            b[place] ^= 1 << 30
        assert same_bits(a, b) == (place is None)
    finally:
        torch.set_num_threads(count)


@pytest.mark.parametrize("changed", [(), (0,), (2,), (0, 3, 5), (1, 2, 3, 4, 5, 6)])
def test_many_are_compared_at_once(changed):
    tensors = [torch.zeros(3), torch.arange(SMALL, dtype=torch.int32), torch.tensor(1.0, dtype=torch.float64),
               torch.tensor([True, False]), torch.arange(12.0).reshape(3, 4).T, torch.full((2, SMALL), torch.nan),
               torch.ones(SMALL // 4), torch.zeros(0, 3)]
    copies = [tensor.contiguous().clone() for tensor in tensors]
    for place in changed:
        copies[place].view(-1).view(torch.uint8)[-1] ^= 1
    assert equal_on_device(tensors, copies)[0] == [place not in changed for place in range(len(tensors))]
    assert equal_on_device([], []) == ([], [])


def test_numbers_of_many_are_fetched_at_once():
    tensors = [torch.tensor(0.1), torch.tensor([[3, -1], [2, 5]]), torch.arange(FEW + 1.0) - 7,
               torch.tensor([0.3, torch.nan], dtype=torch.float64), torch.eye(4)]
    found = numbers_on_host(tensors)
    assert [tensor.flatten().tolist() for tensor in tensors[:2]] == found[:2] and found[2] == [-7, FEW - 7]
    assert found[3][0] == 0.3 and found[3][1] != found[3][1] and found[4] == torch.eye(4).flatten().tolist()
    assert numbers_on_host([]) == []
