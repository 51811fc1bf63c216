"""Threads that share work: how many, what they are told of torch, what becomes of them after errors and forks."""

import ctypes
import gc
import multiprocessing
import os
import signal
import sys
import threading
import time
import weakref
from collections import deque

import pytest
import torch

from torch_radbp.jit import LaneFunction
from torch_radbp.tensors import torch_internals
from torch_radbp.tensors.torch_internals import setters_of_threads
from torch_radbp.threads import team
from torch_radbp.threads.team import (
    HERE,
    LEAST,
    PART,
    after_loops,
    alone_in_torch,
    each,
    loops_together,
    part_for_all,
    threads,
    together,
    until_none_is_left,
)

NUMBER = 3


@pytest.fixture(autouse=True)
def three_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(NUMBER)
    yield
    torch.set_num_threads(before)


def on_new_thread(work):
    """What `work()` returns on a thread that has not asked torch for anything."""
    results = []
    thread = threading.Thread(target=lambda: results.append(work()))
    thread.start()
    thread.join()
    return results[0]


def helpers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("torch_radbp_helper")]


def in_mkl() -> int | None:
    """The number of threads that MKL would use on this thread; None: torch has no MKL."""
    function = getattr(torch_internals.library_of_torch(), "MKL_Get_Max_Threads", None)
    return function and function()


def test_torch_is_alone_inside_and_as_before_outside():
    before = in_mkl()
    with alone_in_torch():
        assert torch.get_num_threads() == 1 and threads() == NUMBER
        assert in_mkl() in (None, 1)
        with alone_in_torch():
            assert torch.get_num_threads() == 1 and threads() == NUMBER
        with alone_in_torch(threads=1):
            assert threads() == 1
        assert torch.get_num_threads() == 1 and threads() == NUMBER
    assert torch.get_num_threads() == threads() == NUMBER and in_mkl() == before


def test_torch_is_as_before_after_an_error():
    with pytest.raises(KeyboardInterrupt), alone_in_torch():
        raise KeyboardInterrupt
    assert torch.get_num_threads() == NUMBER and HERE.threads is None


@pytest.mark.skipif(setters_of_threads()[0] is torch.set_num_threads, reason="OpenMP's own function is not found")
def test_a_thread_that_asks_torch_meanwhile_is_not_told_one():
    with alone_in_torch():
        assert on_new_thread(torch.get_num_threads) == NUMBER
        assert on_new_thread(threads) == NUMBER


def test_torch_itself_is_told_where_its_runtime_is_not_found(monkeypatch):
    setters_of_threads.cache_clear()
    monkeypatch.setattr(torch_internals, "library_of_torch", lambda: None)
    try:
        with alone_in_torch():
            assert torch.get_num_threads() == 1 and threads() == NUMBER
        assert torch.get_num_threads() == NUMBER
    finally:
        setters_of_threads.cache_clear()


def test_a_runtime_that_torch_does_not_ask_is_not_taken(monkeypatch):
    class Other:
        omp_set_num_threads = staticmethod(lambda number: None)

    setters_of_threads.cache_clear()
    monkeypatch.setattr(torch_internals, "library_of_torch", Other)
    try:
        assert setters_of_threads()[0] is torch.set_num_threads
    finally:
        setters_of_threads.cache_clear()


def test_helpers_take_part_and_are_alone():
    everyone, seen = threading.Barrier(NUMBER), []

    def work(task) -> None:
        everyone.wait(60)
        seen.append((threading.current_thread(), threads(), torch.get_num_threads()))

    together(work, NUMBER)
    assert len({thread for thread, _, _ in seen}) == NUMBER
    assert all(numbers == [1, 1] for thread, *numbers in seen if thread is not threading.current_thread())
    assert all(thread.daemon for thread in helpers())


def test_there_are_never_more_helpers_than_were_asked_for():
    together(lambda task: None, NUMBER)
    count = len(helpers())
    for _ in range(200):
        together(lambda task: None, NUMBER)
    callers = [threading.Thread(target=lambda: [together(lambda task: None, NUMBER) for _ in range(50)]) for _ in range(4)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert len(helpers()) == count >= NUMBER - 1


def test_nobody_waits_for_a_helper_that_is_busy():
    free, taken = threading.Event(), threading.Semaphore(0)

    def hold(task) -> None:
        taken.release()
        free.wait(60)

    caller = threading.Thread(target=lambda: together(hold, NUMBER))
    caller.start()
    for _ in range(NUMBER):
        assert taken.acquire(timeout=60)
    try:
        seen = []
        together(lambda task: seen.append(threading.current_thread()), NUMBER)  # would otherwise wait for a minute
        assert seen == [threading.current_thread()]
    finally:
        free.set()
        caller.join()


def test_every_item_is_taken_once():
    items, taken = deque(range(10_000)), []
    together(lambda task: taken.extend(until_none_is_left(items)), NUMBER)
    assert sorted(taken) == list(range(10_000))


@pytest.mark.parametrize("recorded", [False, True])
def test_results_come_in_the_order_of_the_items_however_long_each_takes(recorded):
    both = threading.Barrier(2)

    def work(number: int) -> tuple[int, bool, str]:
        if number < 2:
            both.wait(timeout=60)  # one thread alone would wait for ever
        time.sleep(0.01 * (5 - number))
        return number, torch.is_grad_enabled(), threading.current_thread().name

    with torch.set_grad_enabled(recorded):
        found = each(work, range(5), 2)
    assert [number for number, *_ in found] == list(range(5)) and all(grad == recorded for _, grad, _ in found)
    assert len({name for *_, name in found}) == 2
    assert each(work, [], 2) == []


@pytest.mark.parametrize(("number", "of_helper"), [(2, 1), (3, 1), (4, 2), (7, 3)])
def test_of_two_items_a_helper_has_half_the_threads_and_the_caller_all(number, of_helper):
    both = threading.Barrier(2)

    def work(item: int) -> tuple[bool, int, int]:
        both.wait(timeout=60)
        return threading.current_thread() in helpers(), threads(), torch.get_num_threads()

    with alone_in_torch(threads=number):
        found = each(work, range(2), number)
    assert sorted(found) == [(False, number, 1), (True, of_helper, 1)]


def test_nothing_is_begun_after_an_item_has_failed():
    begun = []

    def work(number: int) -> None:
        begun.append(number)
        if number == 1:
            raise ValueError("the second")

    with pytest.raises(ValueError, match="the second"):
        each(work, range(5), 1)
    assert begun == [0, 1]


def test_the_caller_waits_for_those_that_take_part():
    finished, everyone = [], threading.Barrier(NUMBER)

    def work(task) -> None:
        everyone.wait(60)
        if threading.current_thread() not in helpers():
            raise ValueError("the caller's")
        time.sleep(0.05)
        assert isinstance(task.error, ValueError)  # which they may stop for
        finished.append(True)

    with pytest.raises(ValueError, match="the caller's"):
        together(work, NUMBER)
    assert len(finished) == NUMBER - 1


def test_an_error_of_a_helper_is_raised_and_frees_what_it_holds():
    everyone = threading.Barrier(NUMBER)

    class Large:
        pass

    def fail() -> weakref.ref:
        large = Large()

        def work(task) -> None:
            everyone.wait(60)
            if threading.current_thread() in helpers():
                raise MemoryError(id(large))

        with pytest.raises(MemoryError):
            together(work, NUMBER)
        return weakref.ref(large)

    gc.collect()
    gc.disable()
    try:
        held = fail()
        together(lambda task: everyone.wait(60), NUMBER)  # the helpers have gone on
        assert held() is None
    finally:
        gc.enable()


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="signals of a thread")
def test_an_interruption_waits_for_helpers_that_write():
    """A loop of compiled code on a helper writes into tensors that the caller frees."""
    everyone, finished = threading.Barrier(NUMBER), []

    def work(task) -> None:
        everyone.wait(60)
        if threading.current_thread() in helpers():
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
            time.sleep(0.1)
            finished.append(True)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell starts in the background ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            together(work, NUMBER)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(finished) == NUMBER - 1


def total(numbers: torch.Tensor) -> float:
    """A sum by items on all threads."""
    parts, found = deque(numbers.split(10)), []
    together(lambda task: found.extend(float(part.sum()) for part in until_none_is_left(parts)), NUMBER)
    return sum(found)


def names_after_work(pipe) -> None:
    everyone = threading.Barrier(NUMBER)
    together(lambda task: everyone.wait(60), NUMBER)
    with alone_in_torch():
        pipe.send(len(helpers()))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_has_helpers_of_its_own():
    assert total(torch.arange(100.0)) == 4950
    here, there = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=names_after_work, args=(there,))
    child.start()
    assert here.poll(60) and here.recv() == NUMBER - 1
    child.join(60)
    assert child.exitcode == 0


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere another runtime may stand in")
def test_the_runtime_of_torch_is_found():
    """Without it other threads may be told to be alone: nothing else would tell."""
    assert setters_of_threads()[0] is not torch.set_num_threads
    assert isinstance(ctypes.CDLL(torch._C.__file__).omp_get_max_threads(), int) and os.name == "posix"


@pytest.mark.parametrize("variable", ["OMP_WAIT_POLICY", "GOMP_SPINCOUNT"])
def test_what_the_user_says_of_waiting_holds(variable, monkeypatch):
    monkeypatch.setenv(variable, "ACTIVE")
    monkeypatch.setattr(torch_internals, "library_of_torch", lambda: pytest.fail("is told something else"))
    torch_internals.keep_waits_short.__wrapped__()


def test_waits_are_made_short_once():
    with alone_in_torch():
        pass
    names = [thread.name for thread in threading.enumerate()]
    with alone_in_torch():
        assert [thread.name for thread in threading.enumerate()] == names


def test_work_is_done_where_no_thread_can_be_started(monkeypatch):
    def refuse(self) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(team, "TEAM", team.Team())
    monkeypatch.setattr(threading.Thread, "start", refuse)
    seen = []
    together(seen.append, NUMBER)
    assert len(seen) == 1


def test_loops_run_together_once_all_have_begun_and_what_waits_for_them_comes_after():
    double, x = LaneFunction(lambda x: x * 2.0), torch.arange(10_001, dtype=torch.float32)
    with alone_in_torch():
        room, told = torch.full((20_002,), torch.nan), []
        with loops_together():
            double.into(room, 0, x)
            after_loops(lambda: told.append(bool(room.isnan().any())))
            double.into(room, 10_001, x + 1.0)
            assert room.isnan().all() and not told
        assert told == [False] and torch.equal(room, torch.cat([2 * x, 2 * x + 2]))
        assert torch.equal(double(x), 2 * x)  # and outside at once


def test_after_an_error_no_loop_runs_that_waited_and_later_ones_run_at_once():
    double, x, room = LaneFunction(lambda x: x * 2.0), torch.ones(3), torch.zeros(3)
    with pytest.raises(KeyError), loops_together():
        double.into(room, 0, x)
        raise KeyError
    assert not room.any()
    double.into(room, 0, x)
    assert torch.equal(room, 2 * x)


@pytest.mark.parametrize("lanes", [PART + 1, 5000, 3 * PART, 7 * PART + 5])
def test_loops_of_few_parts_give_each_thread_equally_many(lanes):
    part = part_for_all(lanes, PART)
    parts = -(-lanes // part)
    assert LEAST <= part <= PART and parts % NUMBER == 0 and part * parts - lanes < 64 * parts


@pytest.mark.parametrize("lanes", [1, PART, 1000 * PART])
def test_loops_of_one_part_or_many_are_divided_as_asked(lanes):
    assert part_for_all(lanes, PART) == PART
