"""The counter-based random numbers: uniform, uncorrelated along every address, the same in both precisions.

Samples of low discrepancy share all this but for those of one group, which are spread evenly, as is tested at the end; the
pixels of a film are one. So the other tests take one sample of each of many groups, "pixels", where they take many
independent samples of few.
"""

import itertools

import numpy as np
import pytest
import torch

from tests.deep import deep
from torch_radbp.check.chi_square import SIGNIFICANCE, p_value
from torch_radbp.sampling.sampler import (
    DIMENSIONS_PER_BOUNCE,
    LaneKey,
    bounce_key,
    depth_counter,
    film_lane_key,
    film_order,
    hash32,
    lane_key,
    sample_key,
    seed_key,
    uniform,
)

PIXELS, SAMPLES = 256, 256
LOW_DISCREPANCY = False  # set by the fixture


@pytest.fixture(params=[False, True], ids=["independent", "low discrepancy"], autouse=True)
def low_discrepancy(request, monkeypatch):
    """Every test is of both kinds of samples."""
    monkeypatch.setitem(globals(), "LOW_DISCREPANCY", request.param)
    return request.param


def lanes(seed=0, sensor=0, together=False):
    """The keys of PIXELS x SAMPLES lanes; of low discrepancy each of a pixel of its own, unless `together`."""
    index = torch.arange(PIXELS * SAMPLES, dtype=torch.int32)
    pixel = index if LOW_DISCREPANCY and not together else index // SAMPLES
    return lane_key(sample_key(seed, sensor, LOW_DISCREPANCY, index.device), pixel, index % SAMPLES)


def numbers(seed=0, depth=0, dimension=0, dtype=torch.float64, sensor=0, together=False):
    """(PIXELS, SAMPLES) numbers of one dimension of one bounce."""
    return draw(lanes(seed, sensor, together), depth, dimension, dtype).reshape(PIXELS, SAMPLES)


def draw(key, depth, dimension, dtype=torch.float64):
    """One dimension of one bounce of each lane."""
    return uniform(bounce_key(key, depth_counter(depth, key.shift.device)), dimension, dtype)


ADDRESSES = list(itertools.product((0, 1, 12345), (-1, 0, 3), (0, 1, 3, 6)))


@pytest.mark.parametrize("seed, depth, dimension", ADDRESSES)
def test_numbers_are_uniform(seed, depth, dimension):
    u = numbers(seed, depth, dimension).numpy().ravel()
    assert u.min() >= 0 and u.max() < 1
    assert p_value(np.histogram(u, 256, (0, 1))[0], np.full(256, u.size / 256)) > SIGNIFICANCE
    # The lowest of the 24 bits as well.
    low = (u * 2**24).astype(np.int64) % 256
    assert p_value(np.bincount(low, minlength=256), np.full(256, u.size / 256)) > SIGNIFICANCE


@pytest.mark.parametrize("dimensions", [
    case if place % 8 == 0 else deep(case) for place, case in enumerate(itertools.combinations(range(7), 3))], ids=str)
def test_three_dimensions_fill_the_cube(dimensions):
    """The dimensions of a bounce lie on a lattice; at 2 million points nothing of it may be seen in 32 x 32 x 32 cells."""
    index = torch.arange(1 << 21, dtype=torch.int32)
    key = lane_key(sample_key(0, 0, LOW_DISCREPANCY, index.device), index, index % 16)
    cells = sum((draw(key, 0, dimension) * 32).long() * 32**place for place, dimension in enumerate(dimensions))
    assert p_value(torch.bincount(cells, minlength=32**3).numpy(), np.full(32**3, len(index) / 32**3)) > SIGNIFICANCE


def assert_independent(a, b, what):
    """Pairs fill the unit square: chi-square of 16 x 16 cells, and no linear correlation."""
    a, b = np.ravel(a), np.ravel(b)
    observed = np.histogram2d(a, b, 16, [(0, 1), (0, 1)])[0]
    assert p_value(observed, np.full((16, 16), a.size / 256)) > SIGNIFICANCE, what
    assert abs(np.corrcoef(a, b)[0, 1]) < 5 / np.sqrt(a.size), what


@pytest.mark.parametrize("shift", [1, 2, 3, 16, 128])
def test_neighbouring_pixels_and_samples_are_independent(shift):
    u = numbers().numpy()
    assert_independent(u[:-shift], u[shift:], "pixels")
    assert_independent(u[:, :-shift], u[:, shift:], "samples")
    assert_independent(u[:-shift, shift:], u[shift:, :-shift], "pixel against sample")


def test_a_pixel_and_a_sample_of_exchanged_numbers_are_independent():
    u = numbers().numpy()
    above = np.triu_indices(PIXELS, 1)
    assert_independent(u[above], u.T[above], "pixel and sample exchanged")


@pytest.mark.parametrize("first, second", itertools.combinations(range(7), 2))
def test_dimensions_are_independent(first, second):
    assert_independent(numbers(dimension=first), numbers(dimension=second), "dimensions")


@pytest.mark.parametrize("first, second", [(-1, 0), (0, 1), (1, 2), (0, 7), (3, 1023)])
def test_depths_are_independent(first, second):
    for dimension in (0, 3):
        assert_independent(numbers(depth=first, dimension=dimension), numbers(depth=second, dimension=dimension), "depths")
    assert_independent(numbers(depth=first, dimension=5), numbers(depth=second, dimension=0), "depth and dimension")


@pytest.mark.parametrize("first, second", [(0, 1), (1, 2), (0, 2**31), (0, 2**32), (5, -5), (0, 2**40), (1, 2**20 + 1)])
def test_seeds_are_independent(first, second):
    a, b = numbers(seed=first).numpy(), numbers(seed=second).numpy()
    assert_independent(a, b, "seeds")
    # Not the same numbers in other pixels either.
    assert_independent(a[:-1], b[1:], "seeds, shifted by a pixel")
    assert_independent(a[1:], b[:-1], "seeds, shifted back")


def test_seeds_do_not_share_paths():
    """A path is addressed by its key: no two lanes of a few seeds may have more keys in common than chance gives.

    65536 of 2^32 keys drawn twice: 1 in common is expected.
    """
    keys = [set(zip(*(part.tolist() for part in lanes(seed)))) for seed in range(4)]
    assert all(len(k) > 0.9999 * PIXELS * SAMPLES for k in keys)
    for a, b in itertools.combinations(keys, 2):
        assert len(a & b) < 12


def test_sensors_are_independent():
    assert_independent(numbers(sensor=0), numbers(sensor=1), "sensors")
    assert_independent(numbers(seed=0, sensor=1), numbers(seed=1, sensor=0), "sensor and seed")


def test_sums_along_a_path_have_the_variance_of_independent_numbers():
    """What a path tracer adds up: numbers of all dimensions and depths of a lane."""
    addresses = [(depth, dimension) for depth in range(-1, 7) for dimension in range(7)]
    total = sum(numbers(depth=depth, dimension=dimension) for depth, dimension in addresses).numpy()
    expected = len(addresses) / 12
    # The sample variance of 65536 nearly normal sums is known to sqrt(2 / 65536) = 0.55 per cent.
    assert abs(total.var() / expected - 1) < 5 * 0.0055
    assert abs(total.mean() - len(addresses) / 2) < 5 * np.sqrt(expected / total.size)


def test_both_precisions_use_the_same_24_bits():
    single, double = numbers(dtype=torch.float32), numbers(dtype=torch.float64)
    assert torch.equal(single.double(), double)
    assert torch.equal((double * 2**24).floor(), double * 2**24)
    assert single.max() < 1


def test_numbers_are_a_pure_function_of_their_address():
    everything = numbers(seed=3, depth=2, dimension=4)
    assert torch.equal(everything, numbers(seed=3, depth=2, dimension=4))
    key = lane_key(sample_key(3, 0, LOW_DISCREPANCY, everything.device), *torch.tensor([17, 5], dtype=torch.int32)[:, None])
    assert draw(key, 2, 4) == numbers(seed=3, depth=2, dimension=4, together=True)[17, 5]


def test_the_hash_is_a_permutation():
    """Distinct inputs stay distinct: 2^20 consecutive ones, and 2^20 spread over all of int32."""
    for x in (torch.arange(1 << 20, dtype=torch.int32), (torch.arange(1 << 20) * 4093 - 2**31).to(torch.int32)):
        assert len(hash32(x).unique()) == 1 << 20


def test_each_input_bit_flips_half_of_the_output_bits():
    x = torch.randint(-2**31, 2**31 - 1, (20_000,), generator=torch.Generator().manual_seed(1)).to(torch.int32)
    bits = torch.arange(32, dtype=torch.int64)
    for bit in range(32):
        flipped = x ^ torch.tensor(1 << bit, dtype=torch.int64).to(torch.int32)
        changed = (hash32(x) ^ hash32(flipped)).long()[:, None] >> bits & 1
        # Within 3 per cent of one half: 8 standard errors, and lowbias32's own bias is a tenth of that.
        assert (changed.double().mean(0) - 0.5).abs().max() < 0.03


def test_seed_keys_fit_into_int32_and_differ():
    keys = [seed_key(seed, sensor) for seed in (-1, 0, 1, 2**31, 2**32, 2**63) for sensor in range(3)]
    assert all(-2**31 <= key < 2**31 for key in keys) and len(set(keys)) == len(keys)


def test_no_two_addresses_of_a_bounce_coincide():
    assert DIMENSIONS_PER_BOUNCE >= 7
    key = LaneKey(torch.arange(4, dtype=torch.int32), torch.zeros(4, dtype=torch.int32))
    seen = {tuple(draw(key, depth, dimension).tolist())
            for depth in range(-1, 40) for dimension in range(7)}
    assert len(seen) == 41 * 7


@pytest.mark.parametrize("depth", [-1, 0, 3])
@pytest.mark.parametrize("dimension", range(7))
def test_samples_of_a_pixel_are_stratified(low_discrepancy, depth, dimension):
    """Of every 2^k samples from a multiple of 2^k on, one lies in each of 2^k intervals, counted from some start."""
    u = numbers(depth=depth, dimension=dimension, together=True)
    for count in (2, 8, 32, 256):
        blocks = u.reshape(-1, count).sort(1).values
        gaps = torch.diff(blocks, dim=1, append=blocks[:, :1] + 1)
        evenly = (blocks * count).floor().eq(torch.arange(count)).all() if dimension % 4 < 2 else (
            (gaps * count - 1).abs().max() < 1e-4)
        assert bool(evenly) == low_discrepancy


@pytest.mark.parametrize("depth", [-1, 0, 3])
@pytest.mark.parametrize("dimension", [0, 4])
def test_pairs_of_dimensions_fill_every_elementary_interval(low_discrepancy, depth, dimension):
    u, v = (numbers(depth=depth, dimension=dimension + k, together=True).reshape(-1, 64) for k in (0, 1))
    for across in range(7):
        cell = (u * 2**across).long() * 2**(6 - across) + (v * 2**(6 - across)).long()
        assert cell.sort(1).values.eq(torch.arange(64)).all() == low_discrepancy


def test_means_of_smooth_functions_are_less_noisy(low_discrepancy):
    """By at least a factor of 8 at 256 samples, against the noise of as many independent samples."""
    u, v, w = (numbers(depth=2, dimension=k, together=True) for k in (4, 5, 6))
    for value in (torch.exp(u + v), torch.sin(3 * u) * v, (w + 0.3 * u) ** 2):
        error = value.mean(1).std() / (value.std() / np.sqrt(SAMPLES))
        assert error < 1 / 8 if low_discrepancy else abs(error - 1) < 0.25


def test_products_over_depths_keep_their_mean_and_are_not_noisier():
    """What a path multiplies up; odd functions of two depths, which are the worst that orders of their own can meet."""
    for dimension, other in ((0, 0), (0, 1), (4, 1), (2, 2)):
        product = 12 * (numbers(depth=1, dimension=dimension, together=True) - 0.5) * (
            numbers(depth=2, dimension=other, together=True) - 0.5)
        means = product.mean(1) * np.sqrt(SAMPLES)
        assert abs(means.mean()) < 5 / np.sqrt(PIXELS)
        assert means.std() < 1.35


SIDE = 32  # pixels of a film


def of_film(samples, seed=0, side=SIDE, width=100, corner=0, block=1):
    """The keys of the lanes of the square of pixels at a corner of a film of 100 columns, (side, side, samples).

    Of a range of seeds a row for each of them.
    """
    across = torch.arange(side, dtype=torch.int32) + corner
    pixel = (across[:, None] * width + across)[:, :, None].expand(-1, -1, samples).flatten()
    sample = torch.arange(samples, dtype=torch.int32).repeat(side * side)
    order = film_order(width, samples, pixel.device, block)
    key = sample_key(0, 0, LOW_DISCREPANCY, pixel.device)
    seeds = [seed_key(each, 0) for each in (seed if isinstance(seed, range) else [seed])]
    rows = torch.tensor(seeds, dtype=torch.int32)
    return film_lane_key(order, pixel, sample, key._replace(seed=rows[:, None] if isinstance(seed, range) else rows))


@pytest.mark.parametrize("samples", [1, 2, 4, 16])
@pytest.mark.parametrize("depth, dimension", [(-1, 0), (3, 0), (3, 4)])
def test_squares_of_pixels_fill_every_elementary_interval(low_discrepancy, samples, depth, dimension):
    """All samples, a power of two, of aligned squares of 1, 4, 16, ... pixels, in one pair of dimensions."""
    u, v = (draw(of_film(samples), depth, dimension + k).reshape(SIDE, SIDE, samples) for k in (0, 1))
    for side in (1, 2, 4, 8, 16):
        points = side * side * samples
        bits = points.bit_length() - 1
        squares = [x.reshape(SIDE // side, side, SIDE // side, side, samples).movedim(2, 1).reshape(-1, points)
                   for x in (u, v)]
        for across in range(bits + 1):
            cell = (squares[0] * 2**across).long() * 2**(bits - across) + (squares[1] * 2**(bits - across)).long()
            assert points == 1 or cell.sort(1).values.eq(torch.arange(points)).all() == low_discrepancy


@pytest.mark.parametrize("block", [2, 8])
def test_pixels_at_the_same_place_of_blocks_fill_every_elementary_interval(low_discrepancy, block):
    u, v = (draw(of_film(4, block=block), 1, k).reshape(SIDE // block, block, SIDE // block, block, 4) for k in (0, 1))
    points = (SIDE // block) ** 2 * 4
    squares = [x.permute(1, 3, 0, 2, 4).reshape(-1, points) for x in (u, v)]
    bits = points.bit_length() - 1
    for across in range(bits + 1):
        cell = (squares[0] * 2**across).long() * 2**(bits - across) + (squares[1] * 2**(bits - across)).long()
        assert cell.sort(1).values.eq(torch.arange(points)).all() == low_discrepancy


def test_noise_of_an_image_and_of_a_derivative_in_blocks_have_no_frequencies_in_common(low_discrepancy):
    """The variance of sums of products, over that of independent pixels, known to 4%; both in one order have some."""
    sums = {1: [], 8: []}
    for first in range(0, 3000, 100):
        image = draw(of_film(1, range(first, first + 100, 2)), 0, 0) - 0.5
        for block, own in sums.items():
            derivative = draw(of_film(1, range(first + 1, first + 100, 2), block=block), 0, 0) - 0.5
            own.extend(((image * derivative).sum(1) * 12 / SIDE).tolist())
    for block, own in sums.items():
        noise = float(np.mean(np.square(own)))
        assert (noise > 1.12) == (low_discrepancy and block == 1) and noise > 0.86


@pytest.mark.parametrize("block", [1, 8])
@pytest.mark.parametrize("samples", [1, 3, 5, 16, 4096, 70_000])
def test_no_two_samples_of_a_film_share_their_numbers(samples, block):
    """Also beside each other at the corners of blocks, for numbers of samples that are none of 2^k."""
    for corner in (0, 40):
        key = of_film(samples, side=2 if samples > 5 else SIDE, corner=corner, block=block)
        camera = bounce_key(key, depth_counter(-1, key.point.device))
        shift, first, _ = camera  # of which the second coordinate is a function of the first
        assert len((shift.long() << 32 | first.long() & (1 << 32) - 1).unique()) == len(key.point)


def test_films_of_any_width_have_their_own_numbers():
    """Blocks beyond the first 2^16 columns, as rays in a row have them, and of films with many samples."""
    for samples, numbers_of_pixels in ((1, (0, 1, 1 << 16, 1 << 20, (1 << 31) - 1)), (1 << 20, (0, 64, 128, 1 << 12))):
        pixel = torch.tensor(numbers_of_pixels, dtype=torch.int64).to(torch.int32)
        order = film_order((1 << 31) - 1, samples, pixel.device)
        key = film_lane_key(order, pixel, torch.zeros_like(pixel), sample_key(0, 0, LOW_DISCREPANCY, pixel.device))
        first = bounce_key(key, depth_counter(0, pixel.device))
        assert len(set(zip(*(part.tolist() for part in first)))) == len(pixel)


def test_means_over_a_film_are_unbiased_and_less_noisy(low_discrepancy):
    """Of what changes smoothly from pixel to pixel, by one sample each, over seeds; against independent samples' noise."""
    slope = torch.linspace(0.5, 1.5, SIDE, dtype=torch.float64)
    weight = (slope[:, None] * slope).flatten()
    key = of_film(1, range(64))
    means = (weight * torch.exp(draw(key, 2, 4) + draw(key, 2, 5))).mean(1).numpy()
    expected = float(weight.mean()) * (np.e - 1) ** 2
    independent = np.sqrt(float((weight**2).mean()) * (((np.e**2 - 1) / 2) ** 2 - (np.e - 1) ** 4)) / SIDE
    assert abs(np.mean(means) - expected) < 5 * np.std(means) / 8
    assert np.std(means) < independent / 8 if low_discrepancy else abs(np.std(means) / independent - 1) < 0.4


@pytest.mark.parametrize("first, second", [(-1, 0), (0, 1), (2, 5)])
def test_products_over_depths_of_a_film_keep_their_mean_and_are_not_noisier(first, second):
    """As of a pixel; all pixels of a film have the order of a bounce in common."""
    for dimension, other in ((0, 0), (0, 1), (1, 5), (2, 2)):
        key = of_film(1, range(128))
        product = 12 * (draw(key, first, dimension) - 0.5) * (draw(key, second, other) - 0.5)
        means = product.mean(1).numpy() * SIDE
        assert abs(means.mean()) < 5 / np.sqrt(128)
        assert means.std() < 1.4
