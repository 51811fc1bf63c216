"""What `benchmarks.tails` counts, without Mitsuba."""

import numpy as np

from benchmarks.tails import LIMITS, counts, row


def test_large_derivatives_are_counted_whatever_their_sign():
    assert counts(np.array([0.5, -1.5, 3.0, -100.0, 1.0])) == [3, 2, 1, 1, 1, 1, 1]
    assert len(LIMITS) == 7
    assert row("ours", "red", np.array([2.0, 4.0])) == (
        "| `red` | ours | 3.00000 +- 0.70711 | 1.00000 | 2 | 1 | 0 | 0 | 0 | 0 | 0 | 4 |")
