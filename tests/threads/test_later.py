"""Code that is made meanwhile: once, by whoever comes first, and errors reach whoever asks."""

import subprocess
import sys
from functools import partial
from threading import Barrier, Event, current_thread, main_thread

import pytest
import torch

from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu.board import board
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.jit.recording.recording import ALL, Recording, Reserve, listening
from torch_radbp.jit.recording.results import RecordedInputs
from torch_radbp.jit.target import Cpu
from torch_radbp.threads.later import Later

ENDS = """
import os
from functools import partial
from threading import Event
from torch_radbp.threads.later import Later

if hasattr(os, "fork"):
    working, made = Event(), []
    def make():
        working.set()
        Event().wait(0.2)
        made.append(1)
    Later(make).meanwhile()
    working.wait()
    if os.fork():
        assert os.wait()[1] == 0
    else:
        assert made == [1]  # a helper that was at work has finished
        found = Event()
        Later(found.set).meanwhile()
        os._exit(0 if found.wait(60) else 3)

os.cpu_count = lambda: 2
begun = {"meanwhile": Event(), "beside": Event()}
def work(helped):
    begun[helped].set()
    Event().wait(0.2)
    print(f"finished {helped}\\n", end="", flush=True)
laters = [getattr(Later(partial(work, helped)), helped)() for helped in begun for _ in range(3)]
for event in begun.values():
    event.wait()
"""


def scaled(k: float, x: torch.Tensor) -> torch.Tensor:
    return x * k + 1


def test_a_helper_makes_what_nobody_has_asked_for_yet():
    made = Event()
    later = Later(lambda: made.set() or current_thread()).meanwhile()
    assert made.wait(60)
    assert later.result() is later.result() and later.result() is not main_thread()


def test_without_a_helper_it_is_made_when_asked_for_and_once():
    made = []
    later = Later(lambda: made.append(current_thread()) or len(made))
    assert made == []
    assert later.result() == later.result() == 1 and made == [main_thread()]


def test_whoever_asks_is_told_of_an_error_and_may_ask_again():
    tried = []

    def work() -> int:
        tried.append(1)
        if len(tried) < 3:
            raise RuntimeError(f"failed {len(tried)}")
        return 5

    later = Later(work)
    for number in (1, 2):
        with pytest.raises(RuntimeError, match=f"failed {number}"):
            later.result()
    assert later.result() == 5


def test_a_process_that_ends_waits_for_what_helpers_have_begun_and_begins_nothing_more():
    """A fork waits for the helper, too, and has one of its own."""
    done = subprocess.run([sys.executable, "-c", ENDS], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and done.stderr == ""
    assert done.stdout.count("finished meanwhile\n") == 1 <= done.stdout.count("finished beside\n") <= 2


def test_several_helpers_compute_beside_each_other(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    both = Barrier(2, timeout=60)
    laters = [Later(both.wait).beside() for _ in range(2)]
    assert sorted(later.result() for later in laters) == [0, 1]


def test_an_error_of_a_helper_waits_for_who_needs_the_value():
    tried, failed = [], Event()

    def work() -> int:
        tried.append(current_thread())
        if len(tried) == 1:
            raise RuntimeError("failed on a helper")
        return 5

    later = Later(work)
    helped = later.tried
    later.tried = lambda: helped() or failed.set()
    assert later.beside() is later and failed.wait(60)
    with pytest.raises(RuntimeError, match="failed on a helper"):
        later.result()
    assert later.result() == 5 and tried[0] is not main_thread() and tried[1] is main_thread()


def test_errors_of_the_compiler_reach_whoever_runs_the_function(monkeypatch):
    def refuse(self, program):
        raise RuntimeError("no code today")

    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off")
    monkeypatch.setattr(Cpu, "code", refuse)
    with pytest.raises(RuntimeError, match="no code today"):
        LaneFunction(lambda x: x + 1)(torch.ones(5))


def test_a_recording_needs_no_code_before_it_ends(monkeypatch):
    """Functions are traced one after the other while helpers compile; what was recorded waits for them."""
    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off")
    may_begin, code = Event(), Cpu.code
    monkeypatch.setattr(Cpu, "code", lambda self, program: may_begin.wait(60) and code(self, program))
    functions = [LaneFunction(partial(scaled, k)) for k in (2.0, 3.0)]
    reserve = Reserve()
    x = reserve.tensor(torch.float32, ALL)
    recording = Recording([x], reserve=reserve)
    with torch.no_grad(), listening(recording):
        found = functions[1](functions[0](x))
    may_begin.set()
    recorded = Recorded(recording, [x], found)
    given = torch.rand(100)
    with board() as own:
        result, _ = recorded(RecordedInputs([given]), RecordedInputs([]), 100, own)
    torch.testing.assert_close(result, (given * 2 + 1) * 3 + 1)
