"""Worker threads ("helpers") that share work, and sleep while there is none.

After each operation torch's OpenMP threads wait for the next by spinning, for ten milliseconds and more. They take the cores
from ours, from other processes and from each other, and an operation ends only when the last of them was given a core. So
torch's operations stay on the thread that calls them wherever we are called (`alone_in_torch`), and what is worth sharing is
shared here: a helper takes part once it is awake, and nobody waits for one that is not.
"""

from __future__ import annotations

import ctypes
import os
import threading
from array import array
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from queue import SimpleQueue
from typing import NamedTuple, TypeVar

import torch

from torch_radbp.tensors.torch_internals import operations_on_this_thread

Item, Result = TypeVar("Item"), TypeVar("Result")
PART = 4096  # lanes that a thread takes at a time
LEAST = 1024  # the same where parts are made smaller, so that each thread takes equally many
BLOCK = 64  # lanes of which all parts but the last are a multiple
EVEN = 4  # parts for each thread, of more of which it matters little


class Job(ctypes.Structure):
    """The C structure from which threads take parts of a compiled loop over lanes, one after the other."""

    _fields_ = [("lanes", ctypes.c_int64), ("part", ctypes.c_int64), ("next", ctypes.c_int64),
                ("inputs", ctypes.c_void_p), ("outputs", ctypes.c_void_p)]


LoopBody = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class Task:
    """Work that several threads share.

    Args:
        work: called by each thread that takes part. It divides what is to be done itself, is right on any number of them,
            and looks at `error` now and then, if it is long.
    """

    def __init__(self, work: Callable[[Task], None]) -> None:
        self.work = work
        self.working = 0  # threads
        self.closed = False  # to those that have not begun
        self.error: BaseException | None = None  # the first; the others' work is in vain
        self.lock, self.done = threading.Lock(), threading.Lock()
        self.done.acquire()

    def take_part(self) -> None:
        """Works until nothing is left to begin; does nothing if the task is closed."""
        with self.lock:
            if self.closed:
                return
            self.working += 1
        try:
            self.work(self)
        except BaseException as error:
            self.error = self.error or error
        with self.lock:
            self.working -= 1
            if self.closed and not self.working:
                self.done.release()

    def close(self) -> None:
        """Waits for the threads that take part, even if interrupted, since they write into the caller's memory."""
        with self.lock:
            self.closed = True
            waiting = self.working > 0
        while waiting:
            try:
                self.done.acquire()
                waiting = False
            except BaseException as interruption:
                self.error = self.error or interruption
        self.work = None  # helpers that are still asleep hold the task


class Team:
    """The helpers of a process, started when needed, and their queue of tasks."""

    def __init__(self) -> None:
        self.helpers, self.growing = 0, threading.Lock()
        self.tasks: SimpleQueue[Task] = SimpleQueue()

    def call(self, task: Task, helpers: int, most: int = 0) -> None:
        """Wakes helpers for a task.

        Args:
            task: that they take part in.
            helpers: for this one.
            most: that there are for all tasks, if that is more.
        """
        most = max(helpers, most)
        while self.helpers < most and self.grow(most):
            pass
        for _ in range(min(helpers, self.helpers)):
            self.tasks.put(task)

    def grow(self, helpers: int) -> bool:
        """Starts one more helper, up to a number; False if there cannot be one."""
        with self.growing:
            if self.helpers >= helpers:
                return False
            try:
                threading.Thread(target=self.help, name=f"torch_radbp_helper_{self.helpers}", daemon=True).start()
            except RuntimeError:  # no more threads, or the interpreter ends
                return False
            self.helpers += 1
        return True

    def help(self) -> None:
        """The loop of a helper thread."""
        with alone_in_torch(threads=1):
            while True:
                self.tasks.get().take_part()


class _ThreadState(threading.local):
    """Thread-local state: number of threads and pending loops."""

    threads: int | None = None  # threads that work for this one, itself included; None: as many as torch has
    loops: list[LaneLoop] | None = None  # loops that wait to run together; None: outside of `loops_together`
    afterwards: list[Callable[[], None]] | None = None  # functions to call after them


HERE, TEAM = _ThreadState(), Team()
COMPILERS, ASSEMBLERS = Team(), Team()  # that take no part in loops; see `later.py`


def forget_helpers() -> None:
    """Resets the team in a forked process, which has none of its parent's threads."""
    global TEAM, COMPILERS, ASSEMBLERS
    TEAM, COMPILERS, ASSEMBLERS = Team(), Team(), Team()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=forget_helpers)


def threads() -> int:
    """The number of threads that may work for this one, itself included: as many as torch has; for a helper 1."""
    return torch.get_num_threads() if HERE.threads is None else HERE.threads


@contextmanager
def alone_in_torch(threads: int | None = None) -> Iterator[None]:
    """A context in which torch's operations stay on this thread.

    Args:
        threads: that work for it meanwhile; None: as many as torch has, or as an outer context says.
    """
    before = HERE.threads
    if before is not None and threads in (None, before):
        yield
        return
    with operations_on_this_thread() as number:
        HERE.threads = threads or number
        try:
            yield
        finally:
            HERE.threads = before


def together(work: Callable[[Task], None], threads: int) -> None:
    """Calls `work` on this thread and on helpers as they wake up; waits for those that have begun.

    Args:
        work: see `Task`.
        threads: at most so many; 1 is the calling thread alone.

    Raises:
        BaseException: the first that one of them raised.
    """
    task = Task(work)
    try:
        if threads > 1:
            TEAM.call(task, threads - 1)
        task.take_part()
    finally:
        task.close()
    error, task.error = task.error, None
    try:
        if error is not None:
            raise error
    finally:
        del error  # whose traceback holds this frame


@contextmanager
def assisted(work: Callable[[Task], None], finish: Callable[[], None]) -> Iterator[Callable[[], None]]:
    """A context with a function that calls helpers to do `work`, perhaps again; at its end `finish` lets them return."""
    task, number = Task(work), threads()

    def call() -> None:
        if number > 1:
            TEAM.call(task, number - 1)

    try:
        yield call
    finally:
        finish()
        task.close()
    if task.error is not None:
        raise task.error


def each(work: Callable[[Item], Result], items: Sequence[Item], threads: int) -> list[Result]:
    """Calls `work` on each item, in several threads; results in order.

    Of fewer items than threads each has its part of them, and this thread, which waits for the others, all.
    """
    recorded, left, results = torch.is_grad_enabled(), deque(enumerate(items)), {}
    part = threads // max(1, len(items))

    def take_items(task: Task) -> None:
        with torch.set_grad_enabled(recorded), alone_in_torch(max(part, HERE.threads or 1)):
            for number, item in until_none_is_left(left):
                if task.error is not None:
                    return
                results[number] = work(item)

    together(take_items, min(threads, len(items)))
    return [results[number] for number in range(len(items))]


def until_none_is_left(items: deque[Item]) -> Iterator[Item]:
    """Yields items from a queue that is shared with other threads."""
    while items:
        try:
            item = items.popleft()
        except IndexError:
            return
        yield item


@contextmanager
def loops_together() -> Iterator[None]:
    """A context in which loops are collected, and run together at its end.

    None may read what another one writes. What is to be done after them is said by `after_loops`.
    """
    HERE.loops, HERE.afterwards = [], []
    try:
        yield
        loops, afterwards = HERE.loops, HERE.afterwards
    finally:
        HERE.loops = HERE.afterwards = None
    run_loops(loops)
    for work in afterwards:
        work()


def after_loops(work: Callable[[], None]) -> None:
    """Calls `work` after the loops collected so far have run."""
    if HERE.afterwards is None:
        work()
    else:
        HERE.afterwards.append(work)


class LaneLoop(NamedTuple):
    """A compiled loop over lanes, with its arguments."""

    body: int  # address of a C function that takes parts of a `Job`
    lanes: int
    inputs: array  # 64-bit integers, addresses of inputs and outputs
    outputs: array
    part: int  # lanes that a thread takes at a time


def run_lanes(body: int, lanes: int, inputs: array, outputs: array, part: int = PART) -> None:
    """Runs compiled code over lanes on all threads that may work for this one; in `loops_together` at the end of that.

    Args:
        body: the address of a C function that takes parts of a `Job`.
        lanes: how many.
        inputs, outputs: addresses, of what `body` reads and writes.
        part: the lanes that a thread takes at a time.
    """
    if HERE.loops is None:
        run_loops([LaneLoop(body, lanes, inputs, outputs, part_for_all(lanes, part))])
    else:
        HERE.loops.append(LaneLoop(body, lanes, inputs, outputs, part))


def part_for_all(lanes: int, part: int) -> int:
    """The number of lanes, at most `part`, that a thread takes at a time, such that all threads get equally many parts."""
    count, team = -(-lanes // part), threads()
    if count < 2 or count > EVEN * team:
        return part
    count = max(count, min(-(-count // team) * team, lanes // LEAST))
    return -(-lanes // (count * BLOCK)) * BLOCK


def run_loops(loops: Sequence[LaneLoop]) -> None:
    """Runs several loops, whose parts threads take until none is left."""
    jobs = [Job(loop.lanes, loop.part, 0, loop.inputs.buffer_info()[0], loop.outputs.buffer_info()[0]) for loop in loops]
    calls = [(LoopBody(loop.body), ctypes.addressof(job)) for loop, job in zip(loops, jobs)]
    parts = sum(-(-loop.lanes // loop.part) for loop in loops)

    def take_parts(task: Task | None = None) -> None:
        for body, job in calls:
            body(job)

    if parts <= 1 or threads() == 1:
        take_parts()
    else:
        together(take_parts, min(threads(), parts))
