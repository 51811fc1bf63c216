"""The counter-based random numbers: uniform, uncorrelated along every address, the same in both precisions."""

import itertools

import numpy as np
import pytest
import torch

from tests.sampling.chi_square import SIGNIFICANCE, p_value
from torch_radbp.sampling.sampler import (
    CAMERA_DEPTH,
    DIMENSIONS_PER_BOUNCE,
    bounce_key,
    depth_counter,
    hash32,
    lane_key,
    seed_key,
    uniform,
)

PIXELS, SAMPLES = 256, 256


def numbers(seed=0, depth=0, dimension=0, dtype=torch.float64, sensor=0):
    """(PIXELS, SAMPLES) numbers of one dimension of one bounce."""
    index = torch.arange(PIXELS * SAMPLES, dtype=torch.int32)
    key = lane_key(torch.tensor(seed_key(seed, sensor), dtype=torch.int32), index // SAMPLES, index % SAMPLES)
    return draw(key, depth, dimension, dtype).reshape(PIXELS, SAMPLES)


def draw(key, depth, dimension, dtype=torch.float64):
    """One dimension of one bounce of each lane."""
    return uniform(bounce_key(key, depth_counter(depth, key.device)), dimension, dtype)


ADDRESSES = [(seed, depth, dimension) for seed in (0, 1, 12345) for depth in (CAMERA_DEPTH, 0, 3) for dimension in (0, 1, 5)]


@pytest.mark.parametrize("seed, depth, dimension", ADDRESSES)
def test_numbers_are_uniform(seed, depth, dimension):
    u = numbers(seed, depth, dimension).numpy().ravel()
    assert u.min() >= 0 and u.max() < 1
    assert p_value(np.histogram(u, 256, (0, 1))[0], np.full(256, u.size / 256)) > SIGNIFICANCE
    # The lowest of the 24 bits as well.
    low = (u * 2**24).astype(np.int64) % 256
    assert p_value(np.bincount(low, minlength=256), np.full(256, u.size / 256)) > SIGNIFICANCE


@pytest.mark.parametrize("dimensions", itertools.combinations(range(6), 3))
def test_three_dimensions_fill_the_cube(dimensions):
    """The dimensions of a bounce lie on a lattice; at 2 million points nothing of it may be seen in 32 x 32 x 32 cells."""
    key = hash32(torch.arange(1 << 21, dtype=torch.int32))
    cells = sum((draw(key, 0, dimension) * 32).long() * 32**place for place, dimension in enumerate(dimensions))
    assert p_value(torch.bincount(cells, minlength=32**3).numpy(), np.full(32**3, len(key) / 32**3)) > SIGNIFICANCE


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


@pytest.mark.parametrize("first, second", itertools.combinations(range(6), 2))
def test_dimensions_are_independent(first, second):
    assert_independent(numbers(dimension=first), numbers(dimension=second), "dimensions")


@pytest.mark.parametrize("first, second", [(CAMERA_DEPTH, 0), (0, 1), (1, 2), (0, 7), (3, 1023)])
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
    index = torch.arange(PIXELS * SAMPLES, dtype=torch.int32)
    keys = [set(lane_key(torch.tensor(seed_key(seed, 0), dtype=torch.int32), index // SAMPLES, index % SAMPLES).tolist())
            for seed in range(4)]
    assert all(len(k) > 0.9999 * PIXELS * SAMPLES for k in keys)
    for a, b in itertools.combinations(keys, 2):
        assert len(a & b) < 12


def test_sensors_are_independent():
    assert_independent(numbers(sensor=0), numbers(sensor=1), "sensors")
    assert_independent(numbers(seed=0, sensor=1), numbers(seed=1, sensor=0), "sensor and seed")


def test_sums_along_a_path_have_the_variance_of_independent_numbers():
    """What a path tracer adds up: numbers of all dimensions and depths of a lane."""
    addresses = [(depth, dimension) for depth in range(-1, 7) for dimension in range(6)]
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
    key = lane_key(torch.tensor(seed_key(3, 0), dtype=torch.int32), torch.tensor([17], dtype=torch.int32),
                   torch.tensor([5], dtype=torch.int32))
    assert draw(key, 2, 4) == everything[17, 5]


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
    assert DIMENSIONS_PER_BOUNCE >= 6
    key = torch.arange(4, dtype=torch.int32)
    seen = {tuple(draw(key, depth, dimension).tolist())
            for depth in range(-1, 40) for dimension in range(6)}
    assert len(seen) == 41 * 6
