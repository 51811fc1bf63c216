"""Large blocks of memory are marked for large pages; others are not."""

import sys
from pathlib import Path

import pytest
import torch

from torch_radbp.jit.cpu.large_pages import LEAST, PAGE, block_of

SETTING = Path("/sys/kernel/mm/transparent_hugepage/enabled")


def advised(address: int) -> bool:
    """Whether the mapping that a byte lies in is marked (VmFlags hg, see Linux's proc(5))."""
    inside = False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        first = line.split()[0]
        if "-" in first and not first.endswith(":"):
            begin, end = (int(number, 16) for number in first.split("-"))
            inside = begin <= address < end
        elif inside and first == "VmFlags:":
            return "hg" in line.split()
    raise AssertionError("the address is not mapped")


@pytest.mark.skipif(sys.platform != "linux" or not SETTING.exists(), reason="the system has no such pages")
def test_the_inside_of_large_blocks_is_marked():
    block = block_of((LEAST + PAGE,), torch.uint8)
    assert advised(block.data_ptr() + len(block) // 2)


@pytest.mark.parametrize("size", [1, 1000, LEAST - 1, LEAST, LEAST + 1, 3 * LEAST + 123])
def test_blocks_have_their_size_and_keep_what_is_written(size):
    block, other = block_of((size,), torch.uint8), block_of((size,), torch.uint8)
    block.fill_(7), other.fill_(9)
    again = block_of((size,), torch.uint8)
    again.fill_(1)
    assert block.shape == (size,) and block.dtype == torch.uint8 and block.is_contiguous()
    assert (block == 7).all() and (other == 9).all()


def test_a_place_that_was_exchanged_before_keeps_its_contents():
    for _ in range(3):  # freed memory comes again, at the same place
        block = block_of((2 * LEAST,), torch.uint8)
        block.copy_(torch.arange(2 * LEAST) % 251)
        kept = block_of((2 * LEAST,), torch.uint8)
        assert torch.equal(block.long(), torch.arange(2 * LEAST) % 251)
        del block, kept
