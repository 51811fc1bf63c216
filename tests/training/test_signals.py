"""Ctrl-C and SIGTERM at every stage of a run: real processes, whose memory is that of one that has imported torch."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from tests.deep import deep
from torch_radbp.training.interrupt import WORDS, Interrupts
from torch_radbp.training.recovery.checkpoint import FILE_NAME, load_checkpoint
from torch_radbp.training.recovery.metrics import MetricsFile

pytestmark = pytest.mark.hostile

# Forks a process for each line of JSON on its input and prints its number; then its exit status.
FORKS = """
import json, os, sys
import torch.utils.tensorboard
from torch_radbp.training import cli
from torch_radbp.training.recovery import optimize, problem
from torch_radbp.training.recovery import outcome
from torch_radbp.training.recovery import passes
from torch_radbp.training.report import page as report
from torch_radbp.training import run

for line in sys.stdin:
    case = json.loads(line)
    process = os.fork()
    if process == 0:
        os.chdir(case["folder"])
        for number, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT), number)
        exec(case["script"])
        try:
            cli.app(case["arguments"])
        except SystemExit as end:
            sys.stdout.flush()
            os._exit(end.code or 0)
        os._exit(99)
    print(process, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
"""

# Says that a function has been reached, and waits a moment there for the signal.
AT = """
import time
def reached(module, name, at_call=1):
    function, calls = getattr(module, name), []
    def waiting(*arguments, **named):
        calls.append(None)
        if len(calls) == at_call:
            open("reached", "w").close()
            deadline = time.monotonic() + 20
            while time.monotonic() < deadline and not os.path.exists("go"):
                time.sleep(0.01)
        return function(*arguments, **named)
    setattr(module, name, waiting)
"""


@pytest.fixture(scope="module")
def forks():
    environment = os.environ | {"OMP_NUM_THREADS": "1", "COLUMNS": "200"}
    with subprocess.Popen([sys.executable, "-c", FORKS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
                          env=environment) as process:
        yield process
        process.stdin.close()


def wait_for(path):
    deadline = time.monotonic() + 60
    while not path.exists():
        assert time.monotonic() < deadline, f"{path} did not appear"
        time.sleep(0.01)


@pytest.fixture
def signalled(forks, folder):
    """Returns a function that runs `radbp optimize`, sends it signals at a place, and returns (code, stdout, stderr).

    In plain torch, since what is compiled would be loaded anew by each fork.
    """

    def invoke(place, *signals, arguments=()):
        (folder / "reached").unlink(missing_ok=True)
        case = {"folder": str(folder), "script": AT + place,
                "arguments": ["optimize", "recipe.toml", "--out", "run", "-D", "render.compile=false", *arguments]}
        forks.stdin.write(json.dumps(case) + "\n")
        forks.stdin.flush()
        process = int(forks.stdout.readline())
        for number in signals:
            wait_for(folder / "reached")
            os.kill(process, number)
            time.sleep(0.05)
        (folder / "go").touch()
        code = int(forks.stdout.readline())
        (folder / "go").unlink()
        return code, (folder / "stdout").read_text(), (folder / "stderr").read_text()

    return invoke


def state_of(folder):
    return load_checkpoint(folder / "run" / FILE_NAME, 2**20)["step"]


@pytest.mark.parametrize("number, code, word", [(signal.SIGINT, 130, "interrupted"),
                                                deep(signal.SIGTERM, 143, "terminated")])
def test_a_signal_during_the_steps_saves_state_and_report(number, code, word, signalled, folder):
    got, stdout, stderr = signalled("reached(optimize, 'render_buffers', 3)", number)
    assert got == code and not stderr, stderr
    assert f"{word}: the checkpoint is saved" in stdout and "stopped at step 2; to continue: --resume --out run" in stdout
    assert state_of(folder) == 2 and len(MetricsFile(folder / "run" / "metrics.csv").rows()) == 2
    assert "interrupted at step 2 of 6" in (folder / "run" / "report.html").read_text()


def test_a_signal_that_a_library_swallows_ends_the_run_at_the_next_step(signalled, folder):
    swallow = """
swallowed = problem.Recovery.__init__
def __init__(self, *arguments):
    try:
        reached(problem, 'read_targets')
        swallowed(self, *arguments)
    except KeyboardInterrupt:
        swallowed(self, *arguments)
problem.Recovery.__init__ = __init__
"""
    code, _, stderr = signalled(swallow, signal.SIGINT)
    assert (code, stderr.strip()) == (130, "interrupted")
    assert not (folder / "run").exists(), "nothing had been written"


def test_a_signal_before_the_first_image_says_how_to_continue(signalled, folder):
    code, stdout, stderr = signalled("reached(outcome, 'render_in_passes')", signal.SIGTERM)
    assert code == 143 and "stopped before the first step; to continue: --resume --out run" in stdout
    assert stderr.strip() == "terminated" and state_of(folder) == 0


PLACES = [deep("outcome, 'render_in_passes', 2"), deep("outcome, '_parameter_summary'"), "report, 'curves_section'"]


@pytest.mark.parametrize("place", PLACES)
def test_signals_during_the_final_report_leave_a_report(place, signalled, folder):
    code, stdout, stderr = signalled(f"reached({place})", signal.SIGINT, signal.SIGINT)
    assert code == 130 and not stderr
    assert "report: run/report.html" in stdout
    assert "6 steps" in (folder / "run" / "report.html").read_text() and state_of(folder) == 6


def test_a_signal_shortens_the_images_of_the_report(signalled, folder):
    # Nine looks, each at two images, at the noise before the first step, nine at that after the last: in the third of those.
    place = "outcome.INVISIBLE = 0; reached(passes, 'shown', 23)"
    code, *_ = signalled(place, signal.SIGTERM, arguments=["-D", "report.spp=320"])
    assert code == 143
    summary = json.loads((folder / "run" / "summary.json").read_text())
    assert (summary["image_spp"], summary["status"]) == (128, "finished")


IMPORTING = """
import os, sys, time
from torch_radbp.training.cli import app
class Slow:
    def find_spec(name, path=None, target=None):
        if name == "torch":
            open("reached", "w").close()
            try:
                time.sleep(20)
            except KeyboardInterrupt:
                {then}
sys.meta_path.insert(0, Slow)
app(["optimize", "recipe.toml"])
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("then", ["raise", "raise ImportError('torch is broken')"])
def test_a_signal_in_the_first_second_is_one_line(number, then, folder):
    with subprocess.Popen([sys.executable, "-c", IMPORTING.format(then=then)], cwd=folder, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True) as process:
        wait_for(folder / "reached")
        process.send_signal(number)
        stdout, stderr = process.communicate()
    assert (process.returncode, stdout, stderr) == (128 + number, "", f"{WORDS[number]}\n")


def test_handlers_are_those_of_before_when_a_command_has_ended():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with Interrupts(), Interrupts():
        assert signal.getsignal(signal.SIGTERM) != before[1]
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_held_signal_is_raised_at_the_end_of_the_block():
    done = []
    with pytest.raises(KeyboardInterrupt), Interrupts() as interrupts:
        with interrupts.held():
            os.kill(os.getpid(), signal.SIGTERM)
            done.append(interrupts.pending)
    assert done == [True]
