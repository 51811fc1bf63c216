"""Bitwise comparison of tensors at the speed of memory."""

from __future__ import annotations

import ctypes
import itertools
import os
from collections import deque
from collections.abc import Callable, Sequence
from functools import cache, lru_cache

import torch
from torch import Tensor

from torch_radbp.tensors.differentiated import primal
from torch_radbp.threads.team import Task, threads, together, until_none_is_left

PART = 16 << 20  # bytes that a thread compares at a time
MOST_FETCHED = 1024  # numbers of a tensor that are all fetched, and not only their extremes
SMALL = 4096  # bytes of tensors of a device that are compared together with others


def same_bits(a: Tensor, b: Tensor) -> bool:
    """True if two tensors have one shape, dtype and device, and the same bits: NaN equals itself, 0 does not equal -0."""
    if not comparable(a, b):
        return False
    if not a.is_cpu:
        return torch.equal(bits_of(a), bits_of(b))
    a, b = (each if each.is_contiguous() else primal(each).contiguous() for each in (a, b))
    return same_memory(a.data_ptr(), b.data_ptr(), a.nbytes)


def same_bits_each(tensors: Sequence[Tensor], copies: Sequence[Tensor]) -> list[bool]:
    """For each pair of CPU tensors of equal shapes and dtypes, whether their bits are the same."""
    differ = memory_difference()
    return [not differ(a.data_ptr(), b.data_ptr(), a.nbytes) if a.is_contiguous() and a.nbytes <= PART else same_bits(a, b)
            for a, b in zip(tensors, copies)]


def equal_on_device(tensors: Sequence[Tensor], copies: Sequence[Tensor],
                    others: Sequence[Tensor] = ()) -> tuple[list[bool], list[list[float]]]:
    """Whether pairs of tensors of one device have equal bits, and the numbers of `others`; with one wait.

    Small tensors are compared as one, entry by entry, and what differs is counted up to the end of each.

    Args:
        tensors, copies: the pairs.
        others: tensors whose numbers are fetched as well, in float64; of large ones the extremes.
    """
    answers, order = counted_differences(tensors, copies)
    parts = list(map(fetched_of, others))
    dtypes = list(dict.fromkeys([part.dtype for part in parts]))
    joined = [torch.cat([part for part in parts if part.dtype == dtype]).double() for dtype in dtypes]
    joined = [*([torch.cat(answers).double()] if answers else []), *joined]
    found = (joined[0] if len(joined) == 1 else torch.cat(joined)).tolist() if joined else []
    equal = {place: count == 0 for place, count in zip(order, found)}
    left = iter(found[len(tensors):])
    numbers = {place: list(itertools.islice(left, part.numel()))
               for dtype in dtypes for place, part in enumerate(parts) if part.dtype == dtype}
    return [equal[place] for place in range(len(tensors))], [numbers[place] for place in range(len(parts))]


def counted_differences(tensors: Sequence[Tensor], copies: Sequence[Tensor]) -> tuple[list[Tensor], list[int]]:
    """The numbers of differing bytes of pairs of tensors, of large ones 0 or 1, int64 on their device, and the pairs in the
    order of these numbers. Args: as for `equal_on_device`."""
    few = [place for place, tensor in enumerate(tensors) if tensor.nbytes <= SMALL]
    many = sorted({*range(len(tensors))}.difference(few))
    answers = [(bits_of(tensors[place]) != bits_of(copies[place])).any().reshape(1).long() for place in many]
    if few:
        joined, others = (torch.cat([bits_of(each[place]) for place in few]) for each in (tensors, copies))
        different = torch.nn.functional.pad((joined != others).cumsum(0), (1, 0))
        ends = itertools.accumulate([tensors[place].nbytes for place in few], initial=0)
        answers.append(different.index_select(0, whole_numbers(tuple(ends), joined.device)).diff())
    return answers, [*many, *few]


def differing_bytes(tensors: Sequence[Tensor], copies: Sequence[Tensor]) -> Tensor:
    """The numbers of differing bytes of pairs of tensors, of large ones 0 or 1, as one tensor: 0 where a pair is equal."""
    return torch.cat(counted_differences(tensors, copies)[0])


def fetched_of(value: Tensor) -> Tensor:
    """The numbers of a tensor that are fetched to check it: all of a small one, else the extremes; detached."""
    value = primal(value)
    return value.reshape(-1) if value.numel() <= MOST_FETCHED else torch.stack(value.aminmax())


def numbers_on_host(values: Sequence[Tensor]) -> list[list[float]]:
    """The numbers of device tensors, fetched by one transfer; of large ones the extremes."""
    return equal_on_device((), (), values)[1]


@lru_cache(maxsize=64)
def whole_numbers(numbers: tuple[int, ...], device: torch.device) -> Tensor:
    """An int64 tensor of some integers on a device, cached."""
    with torch.inference_mode(False):
        return torch.tensor(numbers, dtype=torch.int64, device=device)


def comparable(a: Tensor, b: Tensor) -> bool:
    """True if two tensors have one shape, dtype and device."""
    return a.shape == b.shape and a.dtype == b.dtype and a.device == b.device


def bits_of(tensor: Tensor) -> Tensor:
    """The bytes of a tensor, detached."""
    return primal(tensor).contiguous().view(-1).view(torch.uint8)


def same_memory(a: int, b: int, length: int) -> bool:
    """True if the bytes at two addresses are equal; large ones are compared by several threads.

    The C library does so at the speed of memory; `torch.equal` takes half as long again.
    """
    if length <= PART:
        return not memory_difference()(a, b, length)
    starts, different = deque(range(0, length, PART)), []

    def compare(task: Task) -> None:
        for start in until_none_is_left(starts):
            if memory_difference()(a + start, b + start, min(PART, length - start)):
                different.append(start)
                starts.clear()

    together(compare, min(threads(), len(starts)))
    return not different


@cache
def memory_difference() -> Callable[[int, int, int], int]:
    """The C library's `memcmp`, called without the interpreter lock."""
    function = ctypes.CDLL("msvcrt" if os.name == "nt" else None).memcmp
    function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t]
    return function
