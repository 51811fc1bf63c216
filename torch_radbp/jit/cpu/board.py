"""Runs loops from machine code on several threads: helpers look for work on a shared board.

A helper that finds no loop gives its core to others before it looks again, and sleeps a little once it has found none for
long, so that it is in nobody's way.
"""

from __future__ import annotations

import ctypes
import os
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from torch_radbp.jit.cpu.machine import MachineCode, cached_code
from torch_radbp.jit.lane.loops import WRITE_JOB
from torch_radbp.threads.made_once import made_once
from torch_radbp.threads.team import assisted

# Words of a board: whether a loop is open to helpers, how many are inside, whether all is done, the address of a function
# that gives the core to others, the address of the loop's body; then the `team.Job` that the body takes parts of; and the
# address of a function that sleeps, with how long.
DONE, YIELD, SLEEP, TIME, WORDS = 2, 3, 10, 11, 16
LOOKS = 200  # before a helper sleeps
MICROSECONDS = 20
TEXT = """\
define void @run_loop(ptr %board, ptr %body, i64 %lanes, i64 %part, ptr %inputs, ptr %outputs) {
  %some = icmp sgt i64 %lanes, 0
  br i1 %some, label %begin, label %done
begin:
  %body_at = getelementptr i64, ptr %board, i64 4
  store ptr %body, ptr %body_at, align 8
  %job = getelementptr i64, ptr %board, i64 5
{job}  %several = icmp sgt i64 %lanes, %part
  br i1 %several, label %share, label %alone
alone:
  call void %body(ptr %job)
  br label %done
share:
  store atomic i64 1, ptr %board seq_cst, align 8
  call void %body(ptr %job)
  store atomic i64 0, ptr %board seq_cst, align 8
  %inside_at = getelementptr i64, ptr %board, i64 1
  br label %wait
wait:
  %inside = load atomic i64, ptr %inside_at seq_cst, align 8
  %busy = icmp sgt i64 %inside, 0
  br i1 %busy, label %wait, label %done
done:
  ret void
}

define void @help(ptr %board) {
entry:
  %inside_at = getelementptr i64, ptr %board, i64 1
  %done_at = getelementptr i64, ptr %board, i64 2
  %yield_at = getelementptr i64, ptr %board, i64 3
  %yield = load ptr, ptr %yield_at, align 8
  %body_at = getelementptr i64, ptr %board, i64 4
  %job = getelementptr i64, ptr %board, i64 5
  %sleep_at = getelementptr i64, ptr %board, i64 10
  %sleep = load ptr, ptr %sleep_at, align 8
  %time_at = getelementptr i64, ptr %board, i64 11
  %time = load i32, ptr %time_at, align 8
  br label %look
look:
  %looks = phi i64 [ 0, %entry ], [ %more, %rest ], [ %more, %wait ]
  %over = load atomic i64, ptr %done_at seq_cst, align 8
  %finished = icmp ne i64 %over, 0
  br i1 %finished, label %leave, label %ask
ask:
  %open = load atomic i64, ptr %board seq_cst, align 8
  %some = icmp ne i64 %open, 0
  br i1 %some, label %enter, label %rest
enter:
  %before = atomicrmw add ptr %inside_at, i64 1 seq_cst
  %still = load atomic i64, ptr %board seq_cst, align 8
  %in_time = icmp ne i64 %still, 0
  br i1 %in_time, label %work, label %exit
work:
  %body = load ptr, ptr %body_at, align 8
  call void %body(ptr %job)
  br label %exit
exit:
  %after = atomicrmw sub ptr %inside_at, i64 1 seq_cst
  br label %rest
rest:
  %before_rest = phi i64 [ %looks, %ask ], [ 0, %exit ]
  call i32 %yield()
  %more = add i64 %before_rest, 1
  %long = icmp sgt i64 %more, {looks}
  br i1 %long, label %wait, label %look
wait:
  call i32 %sleep(i32 %time)
  br label %look
leave:
  ret void
}

define i32 @stay() {
  ret i32 0
}
"""


@made_once
def board_code() -> MachineCode:
    """The machine code of this module's LLVM IR, `TEXT`."""
    return cached_code(TEXT.replace("{looks}", str(LOOKS)).replace("{job}", WRITE_JOB), entry="run_loop")


def run_loop() -> int:
    """The address of the C function that runs a loop: board, body, lanes, lanes of a part, inputs and outputs."""
    return board_code().address


@made_once
def helping() -> Callable[[int], None]:
    """The C function in which a helper works, given the address of a board."""
    return ctypes.CFUNCTYPE(None, ctypes.c_void_p)(board_code().address_of("help"))


@made_once
def resting() -> tuple[object, int, int, int]:
    """The C library with the addresses of its yield and sleep functions, and the time to sleep."""
    if hasattr(os, "sched_yield"):
        library, time = ctypes.CDLL(None), MICROSECONDS
        functions = library.sched_yield, library.usleep
    elif hasattr(ctypes, "WinDLL"):
        library, time = ctypes.WinDLL("kernel32"), 0
        functions = library.SwitchToThread, library.Sleep
    else:  # then it looks without a rest
        code = board_code()
        return code, code.address_of("stay"), code.address_of("stay"), 0
    return library, *[ctypes.cast(function, ctypes.c_void_p).value for function in functions], time


class Board:
    """A shared board on which helpers look for loops while it is open; they do no other work then.

    Args:
        words: its own; `DONE` while it is closed.
        call: calls the helpers.
    """

    def __init__(self, words: array, call: Callable[[], None]):
        self.words, self.address, self.call = words, words.buffer_info()[0], call

    def open(self) -> None:
        """Calls helper threads to look for loops here, unless the board is open already."""
        if self.words[DONE]:
            self.words[DONE] = 0
            self.call()

    def close(self) -> None:
        """Dismisses the helpers, without waiting for them."""
        self.words[DONE] = 1


@contextmanager
def board() -> Iterator[Board]:
    """A board for the helpers of this thread, not yet open."""
    words = array("q", [0] * WORDS)
    _, words[YIELD], words[SLEEP], words[TIME] = resting()
    words[DONE] = 1
    address, help = words.buffer_info()[0], helping()

    def finish() -> None:
        words[DONE] = 1

    with assisted(lambda task: help(address), finish) as call:
        yield Board(words, call)
