"""Sums of what lanes count in rectangles of pixels."""

import pytest
import torch

from torch_radbp.jit.patches import CHANNELS, Patches, add_patches
from torch_radbp.jit.recording.any_device import AnyDevice

ROWS, COLUMNS = 9, 11


def patches(lanes: int, down: int, across: int, dtype: torch.dtype) -> Patches:
    """Patches of random places and numbers."""
    generator = torch.Generator().manual_seed(lanes + down)
    row, column = (torch.randint(0, most, (lanes,), generator=generator) for most in (ROWS - down + 1, COLUMNS - across + 1))
    numbers = [torch.rand(lanes, generator=generator, dtype=dtype) - 0.3 for _ in range(3 + down + across)]
    return Patches((row * COLUMNS + column).to(torch.int32), numbers[:3], numbers[3:3 + down], numbers[3 + down:])


def expected(given: Patches) -> torch.Tensor:
    """The same in float64, pixel by pixel."""
    totals = torch.zeros(ROWS * COLUMNS, CHANNELS, dtype=torch.float64)
    for down, in_row in enumerate(given.down):
        for across, in_column in enumerate(given.across):
            weight = in_row * in_column
            for channel, value in enumerate(given.values):
                totals[:, channel].index_add_(0, given.first + (down * COLUMNS + across), (value * weight).double())
    return totals.view(ROWS, COLUMNS, CHANNELS)


@pytest.mark.parametrize("lanes", [0, 1, 17, 5000])
@pytest.mark.parametrize("down, across", [(1, 1), (4, 4), (3, 7)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_all_pixels_of_a_patch_have_their_weighted_values(lanes, down, across, dtype):
    given, totals = patches(lanes, down, across, dtype), torch.zeros(ROWS, COLUMNS, CHANNELS, dtype=torch.float64)
    add_patches(given, totals)
    add_patches(given, totals)
    torch.testing.assert_close(totals, 2 * expected(given), rtol=1e-13, atol=1e-12)  # of another order of the sum
    assert lanes == 0 or bool(totals[..., :3].any())


def test_other_devices_add_the_same():
    given, totals = patches(500, 4, 3, torch.float32), torch.zeros(ROWS, COLUMNS, CHANNELS, dtype=torch.float64)
    AnyDevice().add_patches(given, totals)
    torch.testing.assert_close(totals, expected(given), rtol=1e-13, atol=1e-12)
    assert bool(totals.any())


def test_columns_of_rows_are_taken_too():
    given = patches(300, 2, 2, torch.float32)
    strided = Patches(given.first, *([torch.stack([part, part], 1)[:, 0] for part in parts] for parts in given[1:]))
    sums = [torch.zeros(ROWS, COLUMNS, CHANNELS, dtype=torch.float64) for _ in range(2)]
    for one, total in zip((given, strided), sums):
        add_patches(one, total)
    assert not strided.down[0].is_contiguous() and torch.equal(*sums) and bool(sums[0].any())


@pytest.mark.parametrize("name, part", [("first", torch.zeros(3)), ("values", [torch.zeros(3)] * 2),
                                        ("down", [torch.zeros(4)]), ("across", []),
                                        ("across", [torch.zeros(3, dtype=torch.float64)])])
def test_what_does_not_go_together_is_refused(name, part):
    given = patches(3, 1, 1, torch.float32)
    with pytest.raises(ValueError, match="int32 first pixels"):
        add_patches(given._replace(**{name: part}), torch.zeros(ROWS, COLUMNS, CHANNELS, dtype=torch.float64))
