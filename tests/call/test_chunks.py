"""How lanes are cut into chunks, which of these are traced as one, and how they are dealt out."""

import pytest
import torch

from torch_radbp.call.chunks import BAND, LEAST_LANES, fair_chunk, plan_chunks
from torch_radbp.call.wavefronts import plan_wavefronts
from torch_radbp.film.splat import TOGETHER

CPU = torch.device("cpu")


@pytest.mark.parametrize("workers", [1, 2, 3, 16])
@pytest.mark.parametrize("sensors, columns, rows, spp, lanes", [
    (1, 192, 192, 16, 1 << 18), (1, 101, 101, 4, 5000), (2, 8, 8, 3, 1), (3, 8, 8, 3, 7), (1, 16, 4, 3, 31),
    (1, 1, 1, 10_000, 4096), (2, 17, 1, 1, 10**6), (1, 1000, 700, 1, 1 << 14), (1, 640, 480, 100, 1 << 15)])
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


@pytest.mark.parametrize("sensors, side, spp, workers, expected", [
    (1, 64, 4, 2, 1), (2, 64, 4, 2, 1), (8, 64, 8, 2, 2), (8, 64, 4, 1, 1), (9, 64, 16, 2, 4), (3, 8, 1, 16, 1)])
def test_small_images_are_traced_as_one_as_long_as_no_worker_is_idle(sensors, side, spp, workers, expected):
    grids = [(side, side)] * sensors
    chunks = plan_chunks(grids, spp, fair_chunk(grids, spp, workers, 1 << 18), workers)
    wavefronts = plan_wavefronts(chunks, lambda chunk: "alike", 1 << 18, workers)
    assert [chunk for wavefront in wavefronts for chunk in wavefront.chunks] == chunks
    assert all(wavefront.lanes <= 1 << 18 for wavefront in wavefronts)
    assert len(wavefronts) == min(expected, len(chunks))
    for wavefront in wavefronts:
        parts = list(wavefront.parts())
        assert parts[0][1] == 0 and parts[-1][2] == wavefront.lanes
        assert all(last - first == chunk.lanes for chunk, first, last in parts)


def test_only_chunks_that_are_alike_are_traced_as_one():
    chunks = plan_chunks([(8, 8)] * 5, 1, 64, 1)
    kinds = ["a", "a", None, "b", "b"]
    found = plan_wavefronts(chunks, lambda chunk: kinds[chunk.sensor], 1 << 18, 1)
    assert [[chunk.sensor for chunk in wavefront.chunks] for wavefront in found] == [[0, 1], [2], [3, 4]]
    apart = plan_wavefronts(chunks, lambda chunk: None, 1 << 18, 1)
    assert [len(wavefront.chunks) for wavefront in apart] == [1] * 5
