"""Schedules as pure functions: coverage, exact order, number of states, number of replayed steps.

Reference: Li 2020, section 2 (every k-th depth; log N of them); Griewank 1992 for recursive bisection.
"""

import math

import pytest

from torch_radbp.adjoint.schedule import (
    ADJOINT,
    ADVANCE,
    DROP,
    KEEP,
    LOAD,
    backward_plan,
    kept_depths,
)

LENGTHS = range(1, 71)
STRIDES = (1, 2, 3, 5, 7, 10, 64, 100, "sqrt", "log")


def peak_states(bounces: int, stride: int | str) -> int:
    """The greatest number of states that exist at once, the current one of a replay not counted."""
    held = peak = len(kept_depths(bounces, stride))
    for action in backward_plan(bounces, kept_depths(bounces, stride), stride):
        held += {KEEP: 1, DROP: -1}.get(action.kind, 0)
        peak = max(peak, held)
    return peak


def replayed_steps(bounces: int, stride: int | str) -> int:
    """The number of bounces that the backward sweep replays."""
    return sum(action.kind == ADVANCE for action in backward_plan(bounces, kept_depths(bounces, stride), stride))


def words(bounces, stride, longest=None):
    """The plan as text, "load 0, advance 0, ..."; the forward pass expected `longest` bounces."""
    kept = kept_depths(bounces, stride, longest)
    return ", ".join(f"{action.kind} {action.depth}" for action in backward_plan(bounces, kept, stride))


def run(plan, kept):
    """Follows a plan with nothing but the depths of the states; yields each depth when it is differentiated."""
    held, current = set(kept), None
    for kind, depth in plan:
        if kind == LOAD:
            assert depth in held, f"load of depth {depth}, which is not kept"
            current = depth
        elif kind == ADVANCE:
            assert current == depth, f"the current state has reached {current}, not {depth}"
            current = depth + 1
        elif kind == KEEP:
            assert current == depth and depth not in held
            held.add(depth)
        elif kind == ADJOINT:
            assert depth in held, f"adjoint of depth {depth}, whose state is not kept"
            yield depth
        elif kind == DROP:
            held.remove(depth)
        else:
            raise AssertionError(kind)
    assert not held, f"states {held} were never dropped"


@pytest.mark.parametrize("stride", STRIDES)
def test_each_depth_is_differentiated_once_from_its_own_state_deepest_first(stride):
    for bounces in LENGTHS:
        kept = kept_depths(bounces, stride)
        assert list(run(backward_plan(bounces, kept, stride), kept)) == list(reversed(range(bounces)))


@pytest.mark.parametrize("stride", STRIDES)
def test_paths_may_end_before_the_greatest_depth(stride):
    for longest in (1, 2, 7, 32, 1024):
        for bounces in range(1, min(longest, 40) + 1):
            kept = kept_depths(bounces, stride, longest)
            assert list(run(backward_plan(bounces, kept, stride), kept)) == list(reversed(range(bounces)))


@pytest.mark.parametrize("stride", STRIDES)
def test_kept_depths_ascend_from_zero(stride):
    for bounces in LENGTHS:
        kept = kept_depths(bounces, stride)
        assert kept[0] == 0 and kept[-1] < bounces
        assert list(kept) == sorted(set(kept))


@pytest.mark.parametrize("stride", STRIDES)
def test_nothing_is_done_for_no_bounces(stride):
    assert kept_depths(0, stride) == ()
    assert backward_plan(0, (), stride) == []
    assert peak_states(0, stride) == 0


def test_depths_that_are_kept():
    assert kept_depths(5, 1) == (0, 1, 2, 3, 4)
    assert kept_depths(10, 3) == (0, 3, 6, 9)
    assert kept_depths(2, "sqrt") == (0, 1)
    assert kept_depths(8, "sqrt") == (0, 2, 4, 6)
    assert kept_depths(9, "sqrt") == (0, 4, 8)
    assert kept_depths(8, "log") == (0, 4, 6, 7)
    assert kept_depths(10, "log") == (0, 5, 8, 9)


def test_order_of_actions_with_every_state_kept():
    assert words(3, 1) == "load 2, adjoint 2, drop 2, load 1, adjoint 1, drop 1, load 0, adjoint 0, drop 0"


def test_order_of_actions_with_every_third_state_kept():
    assert words(4, 3) == ("load 3, adjoint 3, drop 3, "
                           "load 0, advance 0, keep 1, advance 1, keep 2, "
                           "adjoint 2, drop 2, adjoint 1, drop 1, adjoint 0, drop 0")


def test_order_of_actions_with_square_root():
    assert words(4, "sqrt") == ("load 2, advance 2, keep 3, adjoint 3, drop 3, adjoint 2, drop 2, "
                                "load 0, advance 0, keep 1, adjoint 1, drop 1, adjoint 0, drop 0")


def test_order_of_actions_with_recursive_bisection():
    assert words(4, "log") == ("adjoint 3, drop 3, adjoint 2, drop 2, "
                               "load 0, advance 0, keep 1, adjoint 1, drop 1, adjoint 0, drop 0")
    assert words(4, "log", longest=8) == ("load 0, advance 0, advance 1, keep 2, "
                                          "load 2, advance 2, keep 3, adjoint 3, drop 3, adjoint 2, drop 2, "
                                          "load 0, advance 0, keep 1, adjoint 1, drop 1, adjoint 0, drop 0")


@pytest.mark.parametrize("stride", [1, 2, 3, 5, 7, 10, 64, 100])
def test_a_fixed_stride_holds_n_over_k_plus_k_states_and_replays_each_bounce_at_most_once(stride):
    for bounces in LENGTHS:
        kept = math.ceil(bounces / stride)
        assert kept <= peak_states(bounces, stride) <= bounces / stride + stride
        assert replayed_steps(bounces, stride) == bounces - kept


def test_stride_one_holds_every_state_and_replays_nothing():
    for bounces in LENGTHS:
        assert peak_states(bounces, 1) == bounces
        assert replayed_steps(bounces, 1) == 0


def test_square_root_holds_two_square_roots_of_n_states():
    for bounces in LENGTHS:
        assert peak_states(bounces, "sqrt") <= 2.13 * math.sqrt(bounces) + 1
        assert replayed_steps(bounces, "sqrt") < bounces


@pytest.mark.parametrize("stride", STRIDES)
def test_the_forward_pass_needs_no_state_that_it_has_dropped(stride):
    """It decides after each bounce, without knowing how many will follow."""
    for most in (1, 40, 1024):
        held = set()
        for bounces in range(1, min(most, 70) + 1):
            kept = set(kept_depths(bounces, stride, most))
            assert 0 in kept and kept <= held | {bounces - 1}
            held = kept


@pytest.mark.parametrize("bounces", [5, 20, 33, 50])
def test_states_follow_the_bounces_taken_however_many_there_may_be(bounces):
    def states(stride):
        kept = kept_depths(bounces, stride, most=1024)
        held = peak = len(kept)
        for kind, _ in backward_plan(bounces, kept, stride):
            held += {KEEP: 1, DROP: -1}.get(kind, 0)
            peak = max(peak, held)
        return peak

    assert states("sqrt") <= 2.13 * math.sqrt(bounces) + 1
    assert states("log") <= math.log2(bounces) + 2


def test_bisection_holds_log_n_states_and_replays_n_log_n_bounces():
    for bounces in LENGTHS:
        assert peak_states(bounces, "log") <= math.log2(bounces) + 2
        assert replayed_steps(bounces, "log") <= bounces * math.log2(bounces)
    assert peak_states(64, "log") < peak_states(64, "sqrt") < peak_states(64, 1)


@pytest.mark.parametrize("stride", ["sqrt", "log"])
def test_bounds_hold_for_long_paths_too(stride):
    bound = {"sqrt": 2.13 * 32 + 1, "log": 10 + 2}[stride]
    assert peak_states(1024, stride) <= bound
