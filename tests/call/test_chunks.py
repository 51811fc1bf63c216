"""How lanes are cut into chunks, and chunks dealt out."""

import pytest
import torch

from torch_radbp.call.chunks import BAND, LEAST_LANES, fair_chunk, plan_chunks
from torch_radbp.film.splat import TOGETHER

CPU = torch.device("cpu")


@pytest.mark.parametrize("workers", [1, 2, 3, 16])
@pytest.mark.parametrize("sensors, columns, rows, spp, lanes", [
    (1, 192, 192, 16, 1 << 18), (1, 101, 101, 4, 5000), (2, 8, 8, 3, 1), (3, 8, 8, 3, 7), (1, 16, 4, 3, 31),
    (1, 1, 1, 10_000, 4096), (2, 17, 1, 1, 10**6), (1, 1000, 700, 1, 1 << 14), (2, 640, 480, 100, 1 << 15)])
def test_every_sample_of_every_pixel_is_in_one_chunk(sensors, columns, rows, spp, lanes, workers):
    seen = torch.zeros(sensors, columns * rows, spp, dtype=torch.int32)
    chunks = plan_chunks([(columns, rows)] * sensors, spp, lanes, workers)
    for chunk in chunks:
        assert 0 < chunk.lanes <= max(lanes, columns * TOGETHER)
        index = chunk.rows.numbers(CPU).long()
        assert len(index) * chunk.samples == chunk.lanes
        assert set((index // columns).tolist()) <= set(chunk.band)
        seen[chunk.sensor, index, chunk.first_sample:chunk.first_sample + chunk.samples] += 1
    assert (seen == 1).all()
    assert [chunk.group for chunk in chunks] == sorted(chunk.group for chunk in chunks)
    for group in range(chunks[-1].group + 1):
        bands = {(chunk.sensor, chunk.band) for chunk in chunks if chunk.group == group}
        assert len(bands) == 1 or sum(len(band) for _, band in bands) * columns <= BAND


@pytest.mark.parametrize("workers", [1, 2, 3, 16])
@pytest.mark.parametrize("side, spp", [(192, 16), (192, 24), (256, 16), (101, 64), (500, 4), (1500, 4)])
def test_workers_get_as_much_of_every_part_of_the_image(side, spp, workers):
    """Up to a row of each band; of many workers only as many work as there are chunks that are not too small."""
    lanes = fair_chunk([(side, side)], spp, workers, 1 << 18)
    chunks = plan_chunks([(side, side)], spp, lanes, workers)
    assert len(chunks) >= min(workers, side * side * spp // LEAST_LANES)
    workers = min(workers, len(chunks))
    shares = torch.zeros(workers, side * side)
    for number, chunk in enumerate(chunks):
        shares[number % workers, chunk.rows.numbers(CPU).long()] = 1
    for quarter in shares.chunk(4, dim=1):
        counts = quarter.sum(1)
        bands = len({chunk.band for chunk in chunks})
        assert counts.max() - counts.min() <= 2 * side * max(1, bands // 4)


def test_chunks_of_a_small_image_are_not_too_small():
    assert fair_chunk([(32, 32)], 1, 16, 1 << 18) >= 32 * 32
    lanes = fair_chunk([(64, 64)], 4, 16, 1 << 18)
    assert len(plan_chunks([(64, 64)], 4, lanes, 16)) == 1
    lanes = fair_chunk([(256, 256)], 4, 16, 1 << 18)
    assert all(chunk.lanes >= LEAST_LANES for chunk in plan_chunks([(256, 256)], 4, lanes, 16))
