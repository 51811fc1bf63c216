"""Several processes under torchrun: they find the gradient of one, and a run survives the loss of one of them."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from datetime import timedelta

import pytest
import torch

from tests.training.gradient_of_ranks import gradient
from torch_radbp.rendering.cost import memory_of
from torch_radbp.training.ranks import ALONE, Ranks, joined
from torch_radbp.training.recovery.checkpoint import FILE_NAME, load_checkpoint
from torch_radbp.training.recovery.metrics import MetricsFile
from torch_radbp.training.recovery.renderers import own_budget

ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1", "COLUMNS": "200", "MASTER_ADDR": "127.0.0.1"}


def under_torchrun(processes: int, *program: str, **options) -> subprocess.Popen:
    """A program in several processes on this machine."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes), *program]
    return subprocess.Popen(command, env=ENVIRONMENT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **options)


def finished(process: subprocess.Popen) -> str:
    """What a program has printed; it must have succeeded."""
    said = process.communicate(timeout=300)[0]
    assert process.returncode == 0, said
    return said


def close_to_the_same(found: list[torch.Tensor], expected: list[torch.Tensor]) -> None:
    for ours, reference in zip(found, expected, strict=True):
        assert ours.dtype == torch.float64 and bool(ours.isfinite().all()) and bool((ours != 0).all())
        torch.testing.assert_close(ours, reference, rtol=1e-12, atol=0)


def test_two_processes_that_share_two_views_find_the_gradient_of_one(two_views, monkeypatch):
    """The first is this one; by torchrun, which takes a while to start, all processes of the deep tests begin."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    monkeypatch.setattr("torch_radbp.training.ranks.PATIENCE", timedelta(minutes=2))
    for name, value in {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": "2", "RANK": "0"}.items():
        monkeypatch.setenv(name, value)
    command = [sys.executable, "-m", "tests.training.gradient_of_ranks", str(two_views), "not written"]
    second = subprocess.Popen(command, env=os.environ | {"OMP_NUM_THREADS": "1", "RANK": "1"}, text=True,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    with joined() as ranks:
        assert ranks == (0, 2)
        found = gradient(two_views, ranks)
    finished(second)
    close_to_the_same(found, gradient(two_views, ALONE))


@pytest.mark.deep
def test_three_processes_that_share_samples_find_the_mean_of_three_gradients(folder, monkeypatch):
    recipe = folder / "recipe.toml"
    finished(under_torchrun(3, "-m", "tests.training.gradient_of_ranks", str(recipe), str(folder / "gradient.pt")))
    monkeypatch.setattr(Ranks, "sums", lambda ranks, tensors: list(tensors))
    parts = [gradient(recipe, Ranks(number, 3)) for number in range(3)]  # each with its weight of 1/3
    assert not torch.equal(parts[0][0], parts[1][0])
    close_to_the_same(torch.load(folder / "gradient.pt"), [sum(part) for part in zip(*parts)])


def test_shares_cover_all_views_once_and_their_weights_sum_to_one():
    for views in range(1, 9):
        for count in range(1, 6):
            shares = [Ranks(number, count).share(views) for number in range(count)]
            assert sum(share.weight for share in shares) == pytest.approx(1.0)
            if views >= count:
                assert sorted(view for share in shares for view in share.views) == list(range(views))
                assert {share[2:] for share in shares} == {(0, 1)}  # the random numbers of one process
            else:
                assert all(share.views == list(range(views)) for share in shares)
                assert {share[2:] for share in shares} == {(number, count) for number in range(count)}


def test_processes_share_the_memory_of_a_machine(monkeypatch):
    cpu, gpu = torch.device("cpu"), torch.device("cuda", 0)
    alone = memory_of(cpu)
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "4")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 3)
    assert own_budget("2GiB", cpu) == 2**29 and memory_of(cpu) == alone / 4
    assert own_budget("2GiB", gpu) == 2**30  # two of them share a GPU
    assert own_budget(None, cpu) is None


@pytest.mark.deep
def test_a_killed_process_ends_the_run_with_a_message_and_resume_continues(folder, edit_recipe):
    edit_recipe("steps = 6", "steps = 4000")
    command = ("-m", "torch_radbp.training.cli", "optimize", str(folder / "recipe.toml"), "--out", str(folder / "run"))
    # torchrun looks after its processes every 5 seconds: by then the other one has noticed the loss, and is not terminated.
    with under_torchrun(2, "--monitor-interval", "5", *command, start_new_session=True) as process:
        metrics = MetricsFile(folder / "run" / "metrics.csv")
        deadline = time.monotonic() + 300
        while not metrics.path.exists() or len(metrics.rows()) < 3:
            assert time.monotonic() < deadline and process.poll() is None, process.communicate()[0]
            time.sleep(0.1)
        os.kill(rank_processes(process.pid)[1], signal.SIGKILL)
        said = process.communicate(timeout=300)[0]
    assert process.returncode != 0
    message = r"error: process 0 of 2 lost another one.*the state after \d+ steps is saved; to continue: --resume"
    assert re.search(message, said)
    reached = load_checkpoint(folder / "run" / FILE_NAME, 2**20)["step"]
    assert reached >= 3

    steps = str(reached + 2)
    said = finished(under_torchrun(2, *command, "--resume", "--steps", steps))
    assert said.count("report:") == 1  # by one process only
    assert [int(row["step"]) for row in metrics.rows()] == list(range(reached + 2))
    assert load_checkpoint(folder / "run" / FILE_NAME, 2**20)["processes"] == 2


def rank_processes(torchrun: int) -> dict[int, int]:
    """The process ids of the ranks that torchrun has started, by rank."""
    found = {}
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/stat") as stat, open(f"/proc/{name}/environ") as environment:
                parent = int(stat.read().rpartition(")")[2].split()[1])
                variables = dict(each.split("=", 1) for each in environment.read().split("\0") if "=" in each)
        except (OSError, ValueError):
            continue
        if parent == torchrun and "RANK" in variables:
            found[int(variables["RANK"])] = int(name)
    return found


@pytest.mark.deep
@pytest.mark.parametrize("processes", [2, 3])
def test_several_processes_recover_the_cornell_box(processes, tmp_path):
    command = ("-m", "torch_radbp.training.cli", "optimize", "cornell_reflectance", "--out", str(tmp_path / "run"))
    process = under_torchrun(processes, *command)
    said = process.communicate(timeout=900)[0]
    assert process.returncode == 0, said
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert max(each["largest_error"] for each in summary["parameters"]) < 0.01
