"""Decimal numbers are read as Python reads them, to the last bit."""

import numpy as np
import pytest

from torch_radbp.formats.text_lines import decimals


def read(words):
    lengths = np.array([len(word.encode()) for word in words])
    ends = np.cumsum(lengths + 1) - 1
    return decimals(np.frombuffer(" ".join(words).encode(), np.uint8), ends - lengths, ends)


def test_random_numbers_of_every_format_are_correctly_rounded():
    random = np.random.default_rng(0)
    numbers = random.normal(size=4000) * 10.0 ** random.integers(-12, 12, 4000)
    formats = ["{:.3f}", "{:.6f}", "{:g}", "{:.17g}", "{:+.0f}", "{:.10e}", "{}", "{:.25f}"]
    words = [formats[i % len(formats)].format(number) for i, number in enumerate(numbers)]
    values, valid = read(words)
    assert valid.all()
    np.testing.assert_array_equal(values, [float(word) for word in words])


@pytest.mark.parametrize("word, value", [
    ("0", 0.0), ("-0", -0.0), ("-.0", -0.0), ("5.", 5.0), (".5", 0.5), ("+7", 7.0), ("9007199254740993", 9007199254740992.0),
    ("0.000000000000000001", 1e-18), ("123456789012345678901234567890", 1.2345678901234568e29), ("1e-400", 0.0),
    ("999999999999999999", 1e18), ("1E5", 1e5),
])
def test_numbers_at_the_limits(word, value):
    values, valid = read([word, "1"])
    assert valid.all() and values[0] == value and np.signbit(values[0]) == np.signbit(value)


@pytest.mark.parametrize("word", [".", "-", "+", "-.", "e5", "1e", "1e+", "1.2.3", "1-2", "--1", "+-1", "1_000", "0x10",
                                  "nan", "inf", "1e999", "1d5", "1,5", "²", "١", "1.5f"])
def test_everything_else_is_no_number(word):
    assert read(["1", word, "2"])[1].tolist() == [True, False, True]
