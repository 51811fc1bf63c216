"""Alias tables: what they store is the distribution, exactly, and what they draw follows it."""

import sys

import numpy as np
import pytest
import torch

from torch_radbp.check.chi_square import SIGNIFICANCE, p_value
from torch_radbp.sampling import alias
from torch_radbp.sampling.alias import alias_table

RNG = np.random.default_rng(5)
WEIGHTS = {
    "one": [3.0], "two": [1.0, 3.0], "equal": [2.0] * 7, "with zeros": [0.0, 1.0, 0.0, 4.0, 0.0],
    "first zero": [0.0, 1.0], "last zero": [1.0, 0.0], "far apart": [1e-6, 1.0, 1e6, 1.0],
    "random": list(RNG.uniform(0, 1, 37)),
    "skewed": list(RNG.uniform(0, 1, 64) ** 8),
}


def implied(table) -> np.ndarray:
    """The distribution that threshold and other stand for."""
    threshold, other = table.threshold.double().numpy(), table.other.numpy()
    pmf = np.zeros(len(threshold))
    np.add.at(pmf, np.arange(len(threshold)), threshold / len(threshold))
    np.add.at(pmf, other, (1 - threshold) / len(threshold))
    return pmf


def numbers(count: int, dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor]:
    """What `AliasTable.sample` takes."""
    generator = torch.Generator().manual_seed(2)
    bits = torch.randint(-(1 << 31), 1 << 31, (count,), generator=generator).to(torch.int32)
    return bits, torch.rand(count, generator=generator, dtype=dtype)


@pytest.mark.parametrize("weights", WEIGHTS.values(), ids=WEIGHTS)
def test_the_table_stands_for_its_weights(weights):
    table = alias_table(torch.tensor(weights, dtype=torch.float64))
    expected = np.array(weights) / np.sum(weights)
    np.testing.assert_allclose(table.pmf.numpy(), expected, rtol=1e-14)
    np.testing.assert_allclose(implied(table), expected, rtol=1e-9, atol=1e-15)
    assert (table.threshold >= 0).all() and (table.threshold <= 1 + 1e-12).all()
    assert table.other.dtype == torch.int32 and table.other.min() >= 0 and table.other.max() < len(weights)


MANY = 100_000
LARGE = {
    "random": RNG.uniform(0, 1, MANY), "uniform": np.full(MANY, 0.3), "skewed": RNG.uniform(0, 1, MANY) ** 20,
    "one heavy first": np.append(1e9, RNG.uniform(0, 1, MANY)), "one heavy last": np.append(np.full(MANY, 1e-3), 5.0),
    "with zeros": RNG.uniform(0, 1, MANY) * (RNG.uniform(0, 1, MANY) < 0.3), "sorted": np.linspace(0, 1, MANY),
    "nearly uniform": 1 + 1e-16 * RNG.integers(-9, 9, MANY), "far apart": np.exp(4 * RNG.standard_normal(MANY)),
    "single": np.array([2.0]),
}


@pytest.mark.parametrize("weights", LARGE.values(), ids=LARGE)
def test_a_large_table_is_exact_to_rounding(weights):
    table = alias_table(torch.from_numpy(weights))
    expected = weights / weights.sum()
    # Sums over all entries are rounded: 1e5 of them to about 1e-12. Far below 1e-12 in every probability.
    np.testing.assert_allclose(implied(table), expected, rtol=1e-11, atol=1e-10 / len(weights))
    assert (implied(table)[weights == 0] == 0).all()
    assert table.threshold.min() >= 0 and table.threshold.max() <= 1


def test_tables_are_built_without_a_loop_over_entries():
    lines = 0

    def count(frame, event, argument):
        nonlocal lines
        lines += frame.f_code.co_filename == alias.__file__
        return count

    sys.settrace(count)
    try:
        alias_table(torch.from_numpy(LARGE["random"]))
    finally:
        sys.settrace(None)
    assert 0 < lines < 100


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("weights", WEIGHTS.values(), ids=WEIGHTS)
def test_draws_follow_the_weights(weights, dtype):
    table = alias_table(torch.tensor(weights, dtype=dtype))
    count = 100_000
    drawn = table.sample(*numbers(count, dtype))
    assert drawn.dtype == torch.int32 and drawn.shape == (count,)
    observed = np.bincount(drawn.numpy(), minlength=len(weights))
    expected = count * np.array(weights) / np.sum(weights)
    assert observed[np.array(weights) == 0].sum() == 0
    if np.count_nonzero(weights) > 1:
        assert p_value(observed, expected) > SIGNIFICANCE


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_every_number_below_one_draws_an_entry_of_positive_weight(dtype):
    bits = torch.tensor([-(1 << 31), -1, 0, 1, (1 << 31) - 1], dtype=torch.int32)
    bits = torch.cat([bits, torch.arange(-(1 << 31), 1 << 31, 1 << 20).to(torch.int32)])
    split = torch.tensor([0.0, 0.5, 1 - 2.0**-24]).repeat_interleave(len(bits))
    for weights in WEIGHTS.values():
        drawn = alias_table(torch.tensor(weights, dtype=dtype)).sample(bits.repeat(3), split.to(dtype)).long()
        assert (torch.tensor(weights)[drawn] > 0).all()


def test_weights_need_no_gradient_and_keep_their_dtype():
    table = alias_table(torch.tensor([1.0, 2.0], requires_grad=True))
    assert not table.pmf.requires_grad and table.pmf.dtype == table.threshold.dtype == torch.float32


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("count", [36_000, 1_000_003])
def test_many_entries_are_picked_as_often_as_they_should_be(count, dtype):
    """A lamp of many triangles: the shares of entries, from the numbers that pick each, which are 2^32 / count in a row."""
    table = alias_table(1 + torch.arange(count, dtype=dtype).remainder(7))
    first = torch.tensor([0, 1, count // 3, count // 2, count - 2, count - 1])
    ends = [-(-(entry << 32) // count) for entry in (*first.tolist(), *(first + 1).tolist())]
    for start, end in zip(ends[:6], ends[6:]):
        bits = torch.arange(start, end).to(torch.int32)  # wraps as the random bits do
        assert len(bits) == pytest.approx(2**32 / count, abs=1) and 1 / len(bits) < 3e-4
        drawn = table.sample(bits, torch.ones(len(bits), dtype=dtype).mul(1 - 2.0**-24))
        kept = table.sample(bits, torch.zeros(len(bits), dtype=dtype))
        assert len(kept.unique()) == len(drawn.unique()) == 1


def test_a_number_picks_an_entry_and_another_decides():
    """So that the share of an entry is its threshold, to 24 bits, however many entries there are."""
    table = alias_table(torch.linspace(0.1, 3.0, 10_007, dtype=torch.float64))
    entry = int(((table.threshold > 0.2) & (table.threshold < 0.8)).nonzero()[0])
    split = torch.arange(1 << 16, dtype=torch.float64) / (1 << 16)
    bits = torch.full((1 << 16,), -(-(entry << 32) // 10_007), dtype=torch.int64).to(torch.int32)
    kept = (table.sample(bits, split) == entry).double().mean()
    assert float(kept) == pytest.approx(float(table.threshold[entry]), abs=2**-16)
