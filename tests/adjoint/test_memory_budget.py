"""Memory budgets as people write them."""

import numpy as np
import pytest

from torch_radbp.rendering.memory import parse_budget

pytestmark = pytest.mark.hostile

BYTES = {
    "2GiB": 2 << 30, "2 GiB": 2 << 30, "2gib": 2 << 30, "2GB": 2 * 10**9, " 2 gb ": 2 * 10**9, "1.5MB": 1_500_000,
    "0.5MiB": 1 << 19, "512KiB": 1 << 19, "3kB": 3000, "3KB": 3000, "1TB": 10**12, "1TiB": 1 << 40, "700": 700, "700B": 700,
    "1e6": 10**6, 4096: 4096, 1e9: 10**9, np.int64(77): 77,
}  # fmt: skip


@pytest.mark.parametrize("text", BYTES, ids=repr)
def test_a_budget_is_read_in_binary_and_decimal_units(text):
    assert parse_budget(text) == BYTES[text]


@pytest.mark.parametrize("text", ["", "plenty", "GB", "-1GB", "2 G B", "2GiBs", "2PB", "0", 0, -5, "0.1B", "nan", "inf",
                                  float("nan"), float("inf"), True, "1..5GB", "1e999", None, [1]], ids=repr)
def test_what_is_no_budget_is_refused_with_the_units(text):
    with pytest.raises(ValueError, match=r"memory_budget must be .* '2GB' \(.*GiB.*GB.*\), got") as caught:
        parse_budget(text)
    assert str(caught.value).endswith(repr(text))
