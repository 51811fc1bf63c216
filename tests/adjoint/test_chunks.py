"""How lanes are cut into chunks, and chunks dealt out."""

import pytest
import torch

from torch_radbp.rendering.call.chunks import LEAST_LANES, fair_chunk, plan_chunks

CPU = torch.device("cpu")


@pytest.mark.parametrize("workers", [1, 2, 3, 16])
@pytest.mark.parametrize("sensors, pixels, spp, lanes", [
    (1, 192 * 192, 16, 1 << 18), (1, 101 * 101, 4, 5000), (2, 64, 3, 1), (3, 64, 3, 7), (1, 64, 3, 31), (1, 1, 10_000, 4096),
    (2, 17, 1, 10**6)])
def test_every_sample_of_every_pixel_is_in_one_chunk(sensors, pixels, spp, lanes, workers):
    seen = torch.zeros(sensors, pixels, spp, dtype=torch.int32)
    for chunk in plan_chunks(sensors, pixels, spp, lanes, workers):
        assert 0 < chunk.lanes <= lanes
        index = chunk.pixels.index(CPU).long()
        assert len(index) == chunk.pixels.count
        seen[chunk.sensor, index, chunk.first_sample:chunk.first_sample + chunk.samples] += 1
    assert (seen == 1).all()


@pytest.mark.parametrize("workers", [1, 2, 3, 16])
@pytest.mark.parametrize("side, spp", [(192, 16), (192, 24), (256, 16), (101, 64), (500, 4)])
def test_workers_get_as_much_of_every_part_of_the_image(side, spp, workers):
    """Up to two runs of 16 pixels in each quarter: one at either end."""
    lanes = fair_chunk(1, side * side, spp, workers, 1 << 18)
    shares = torch.zeros(workers, side * side)
    for number, chunk in enumerate(plan_chunks(1, side * side, spp, lanes, workers)):
        shares[number % workers, chunk.pixels.index(CPU).long()] = 1
    for quarter in shares.chunk(4, dim=1):
        counts = quarter.sum(1)
        assert counts.max() - counts.min() <= 32


def test_chunks_of_a_small_image_are_not_too_small():
    assert fair_chunk(1, 32 * 32, 1, 16, 1 << 18) >= 32 * 32
    lanes = fair_chunk(1, 64 * 64, 4, 16, 1 << 18)
    assert len(plan_chunks(1, 64 * 64, 4, lanes, 16)) == 1
    lanes = fair_chunk(1, 256 * 256, 4, 16, 1 << 18)
    assert all(chunk.lanes >= LEAST_LANES for chunk in plan_chunks(1, 256 * 256, 4, lanes, 16))
