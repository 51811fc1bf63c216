"""The parts of a pass: each second counts once, for the innermost part."""

import pytest

from benchmarks.peers import Ours
from benchmarks.scenes import QUICK, SCENES
from benchmarks.shares import BACKWARD, TIMED, Clock, clocked
from torch_radbp.raycast.embree import Embree


def test_time_counts_for_the_innermost_part():
    now = 0.0

    def work(seconds: float) -> None:
        nonlocal now
        now += seconds

    clock = Clock(lambda: now)
    inner = clock.timing("inner", lambda: work(2.0))
    clock.timing("outer", lambda: (work(1.0), inner(), work(0.5), inner()))()
    assert clock.seconds == {"outer": 1.5, "inner": 4.0}


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
        whole = ours.run(1).cpu
    assert Embree.intersect is intersect
    assert {part for part, seconds in clock.seconds.items() if seconds > 0} == set(TIMED)
    assert sum(clock.seconds.values()) <= whole
    assert clock.seconds[BACKWARD] < 0.5 * whole
