"""Plain autograd."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TapeAdjoint:
    """Lets autograd record every operation of the forward pass: the oracle of the tests.

    Memory grows with everything that is computed. Takes no part in the one `autograd.Function`; the loop over bounces is
    recorded as it runs.
    """
