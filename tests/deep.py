"""Which cases of a test are deep: they run by `make test-deep`, the others by `make test`."""

from __future__ import annotations

from collections.abc import Container, Iterable
from typing import Any

import pytest


def deep(*values: Any, **settings: Any):
    """A case that is deep; arguments as for `pytest.param`."""
    return pytest.param(*values, marks=pytest.mark.deep, **settings)


def deep_but(quick: Container, cases: Iterable) -> list:
    """Cases of one parameter, all deep but those in `quick`."""
    return [case if case in quick else deep(case) for case in cases]


def deep_but_every(number: int, cases: Iterable) -> list:
    """Cases, all deep but the first of each `number` of them; a tuple has a value for each of several parameters."""
    return [case if place % number == 0 else deep(*case) if type(case) is tuple else deep(case)
            for place, case in enumerate(cases)]
