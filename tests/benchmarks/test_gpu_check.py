"""`make gpu-check`: what it does without a GPU, and that it runs, and saves, all of its steps with one."""

import json
import sys

import pytest
import torch

from benchmarks import gpu_check


def test_without_a_gpu_it_says_so_saves_nothing_and_fails(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert gpu_check.main(["--folder", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().out
    assert said.startswith("No CUDA GPU was found, so nothing was run") and torch.__version__ in said
    assert not (tmp_path / "out").exists()


def check(monkeypatch, tmp_path, scripts: dict[str, str], *arguments: str, needs: str | None = None) -> tuple:
    """The status and the report of a check, with a card, whose steps run these scripts; {0} in them names the folder."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "a card")
    monkeypatch.setattr(gpu_check, "steps", lambda folder, quick: [
        gpu_check.Step(name, (sys.executable, "-c", script.replace("{0}", str(folder))),
                       2 if "sleep" in script else 600, 1 + ("PART 2" in script), needs)
        for name, script in scripts.items()])
    status = gpu_check.main(["--folder", str(tmp_path), *arguments])
    folder, = tmp_path.iterdir()
    return status, json.loads((folder / "report.json").read_text()), folder


@pytest.mark.parametrize("codes, status", [((0, 0), 0), ((3, 0), 1)])
def test_with_a_gpu_every_step_runs_and_is_saved(monkeypatch, tmp_path, capsys, codes, status):
    scripts = {name: f"print('of {name}'); open('{{0}}/{name}.json', 'w').write('[{code}]'); raise SystemExit({code})"
               for name, code in zip(("kernels", "times"), codes)}
    found, report, folder = check(monkeypatch, tmp_path, scripts)
    assert found == status and report["machine"]["card"] == "a card" and set(report["status"]) == {"kernels", "times"}
    assert (report["kernels"], report["times"]) == ([codes[0]], [codes[1]])
    assert [(folder / f"{name}.txt").read_text().strip() for name in scripts] == ["of kernels", "of times"]
    said = capsys.readouterr().out
    assert ("failed with status 3" if status else "times: passed") in said and "  of kernels" in said


def test_a_step_that_takes_too_long_is_ended_with_what_it_started_and_the_next_one_runs(monkeypatch, tmp_path):
    monkeypatch.setattr(gpu_check, "PATIENCE", 0.3)  # a shell's background jobs ignore interrupts, and so do their children
    waiting = ("import subprocess, sys, time; "
               "subprocess.run([sys.executable, '-c', 'import time; time.sleep(600)'])")
    status, report, folder = check(monkeypatch, tmp_path, {"figures": waiting, "times": ""}, "--patience", "0.25")
    assert status == 1 and report["status"]["figures"].startswith("stopped after its")
    assert report["status"]["times"].startswith("passed") and (folder / "figures.txt").exists()


def test_single_steps_are_run_and_those_that_need_what_is_missing_are_left_out(monkeypatch, tmp_path):
    status, report, _ = check(monkeypatch, tmp_path, {"kernels": "", "times": "raise SystemExit(1)"}, "--only", "times",
                              needs="no_such_module")
    assert status == 0 and report["status"] == {"times": "left out: no_such_module is not installed"}


def test_parts_are_run_one_by_one(monkeypatch, tmp_path):
    status, report, _ = check(monkeypatch, tmp_path, {"kernels": "raise SystemExit(1)", "times": "# PART 2"}, "--part", "2")
    assert status == 0 and set(report["status"]) == {"times"}


def test_the_steps_are_the_table_beside_mitsuba_the_tests_on_a_gpu_and_figures(tmp_path):
    table, kernels, figures, plugins = gpu_check.steps(tmp_path, quick=False)
    assert kernels.command[2:6] == plugins.command[2:6] == ("pytest", "-m", "gpu", "tests/gpu")
    assert kernels.command[-2:] == ("-k", "not every_plugin")
    assert table.command[2:5] == ("benchmarks.gpu_table", "--device", "cuda") and table.command[-2] == "--json"
    assert figures.command[2:9] == ("benchmarks.device_figures", "--device", "cuda", "--resolution", "512", "--spp", "64")
    assert [step.part for step in (table, kernels, figures, plugins)] == [1, 2, 3, 3]
    assert table.limit < 600 and kernels.limit < 600 and table.limit + kernels.limit < 900  # of a card that is lent
