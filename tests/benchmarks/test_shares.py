"""The parts of a pass: each second counts once, for the innermost part."""

import time

import pytest

from benchmarks.peers import Ours
from benchmarks.scenes import QUICK, SCENES
from benchmarks.shares import BACKWARD, TIMED, Clock, clocked
from torch_radbp.raycast.embree import Embree


def test_time_counts_for_the_innermost_part():
    clock = Clock()
    inner = clock.timing("inner", lambda: time.sleep(0.02))
    outer = clock.timing("outer", lambda: (time.sleep(0.01), inner(), inner()))
    start = time.perf_counter()
    outer()
    whole = time.perf_counter() - start
    assert clock.seconds["inner"] >= 0.04
    assert 0.01 <= clock.seconds["outer"] <= whole - 0.04


def test_an_error_closes_the_part():
    clock = Clock()
    with pytest.raises(ZeroDivisionError):
        clock.timing("wrong", lambda: 1 / 0)()
    assert clock.open == []


def test_every_part_of_a_compiled_pass_is_found(tmp_path):
    """All of the parts that are timed are still called under these names, and the sum is the pass."""
    ours = Ours(SCENES["cornell-box"].make(tmp_path, QUICK), compiled=True)
    ours.run(0)
    intersect = Embree.intersect
    with clocked() as clock:
        whole = ours.run(1).both
    assert Embree.intersect is intersect
    assert {part for part, seconds in clock.seconds.items() if seconds > 0} == set(TIMED)
    assert sum(clock.seconds.values()) <= whole
    assert clock.seconds[BACKWARD] < 0.5 * whole
