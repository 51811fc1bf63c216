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


@pytest.mark.parametrize("codes, status", [((0, 0), 0), ((3, 0), 3)])
def test_with_a_gpu_every_step_runs_and_is_saved(monkeypatch, tmp_path, capsys, codes, status):
    def steps(folder, quick):
        """Each prints, and saves a figure."""
        script = "print('of {0}'); open({1!r}, 'w').write('[{2}]'); raise SystemExit({2})"
        return [gpu_check.Step(name, (sys.executable, "-c", script.format(name, str(folder / f"{name}.json"), code)))
                for name, code in zip(("tests", "times"), codes)]

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "a card")
    monkeypatch.setattr(gpu_check, "steps", steps)
    assert gpu_check.main(["--folder", str(tmp_path)]) == status
    folder, = tmp_path.iterdir()
    report = json.loads((folder / "report.json").read_text())
    assert report["machine"]["card"] == "a card" and report["status"] == dict(zip(("tests", "times"), codes))
    assert (report["tests"], report["times"]) == ([codes[0]], [codes[1]])
    assert [(folder / f"{name}.txt").read_text().strip() for name in ("tests", "times")] == ["of tests", "of times"]
    assert ("failed with status 3" if status else "times: passed") in capsys.readouterr().out


def test_the_steps_are_the_tests_on_a_gpu_figures_and_the_times_beside_mitsuba(tmp_path):
    tests, figures, times = (step.command for step in gpu_check.steps(tmp_path, quick=False))
    assert tests[2:6] == ("pytest", "-m", "gpu", "tests/gpu")
    for command, module in ((figures, "device_figures"), (times, "versus_mitsuba")):
        assert command[2:9] == (f"benchmarks.{module}", "--device", "cuda", "--resolution", "512", "--spp", "64")
        assert command[-2] == "--json"
