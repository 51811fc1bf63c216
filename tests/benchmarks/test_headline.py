"""The race to equal error: what it counts, and that it runs from end to end where Mitsuba is installed."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageColor

from benchmarks.headline.__main__ import HEADER, joined, rows
from benchmarks.headline.chart import COLOURS, panel
from benchmarks.headline.race import OURS, Curve, common_error, outcome, race, soonest
from benchmarks.headline.task import parameters
from benchmarks.headline.tasks import TASKS
from benchmarks.headline.tasks.shape import radius
from tests.deep import deep
from torch_radbp.sensor.sampler import Independent, LowDiscrepancy, MultiJitter

HERE = Path(__file__).parents[2]
FALLING = [1.0, 0.5, 0.25, 0.125, 0.0625]


def curve(step: float, errors: list[float], complete: bool = True) -> Curve:
    return Curve([step * number for number in range(len(errors))], errors, complete)


class Halving:
    """A loop whose error halves with every step, each of so many seconds."""

    def __init__(self, seconds: float):
        self.seconds, self.error = seconds, 1.0

    def step(self, number: int) -> float:
        self.error /= 2
        return self.seconds

    def found(self):
        return {"error": np.array(self.error)}


def test_the_seconds_are_those_after_which_an_error_stays_below():
    assert curve(2.0, [1.0, 0.1, 0.6, 0.2, 0.1]).reaches(0.3) == 6.0
    assert curve(2.0, [1.0, 0.1, 0.6]).reaches(0.3) is None


def test_who_has_used_up_the_seconds_is_stopped():
    found = race({"quick": Halving(1.0), "slow": Halving(3.0)}, lambda found: float(found["error"]), 4, 5.0, lambda: None)
    assert found["quick"] == Curve([0.0, 1.0, 2.0, 3.0, 4.0], FALLING, True)
    assert found["slow"] == Curve([0.0, 3.0, 6.0], FALLING[:3], False)


def test_the_common_error_is_that_of_the_worse_of_ours_and_their_best():
    """Errors at the end 0.0625 and 0.5 (ours), 0.8 and 0.2 (theirs); and 0.01, which is better than ours."""
    runs = {OURS: [curve(1.0, FALLING)], f"{OURS}, b": [curve(1.0, [1.0, 0.5])], "b": [curve(1.0, [1.0, 0.8])],
            "c": [curve(1.0, [1.0, 0.2], complete=False)]}
    assert common_error(runs) == pytest.approx(1.5 * 0.2)
    assert common_error(runs | {"d": [curve(1.0, [1.0, 0.01])]}) == pytest.approx(1.5 * 0.0625)


def test_a_row_has_the_ratio_to_the_faster_of_theirs_and_says_what_did_not_converge():
    runs = {OURS: [curve(1.0, FALLING)], "guided": [curve(8.0, FALLING)], "plain": [curve(4.0, [1.0, 0.9, 0.8])]}
    text = rows({"title": "Box", "first": dict.fromkeys(runs, 2.0), "measure": "RMS",
                 "runs": {name: [each._asdict() for each in curves] for name, curves in runs.items()}})
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text]
    assert all(len(line) == len(HEADER.splitlines()[0].strip("|").split("|")) for line in cells)
    assert cells[0] == ["Box", "ours", "1000", "2.0", "1", "0.0625", "0.0938", "4.00", "**0.12**"]
    assert cells[1][7] == "32.00" and cells[2][5] == "0.8, not converged" and cells[2][7] == "not reached"


def test_a_row_has_the_ratio_of_the_fastest_of_both():
    """Ours with fewer samples is sooner, theirs later."""
    runs = {"b": [curve(8.0, FALLING)], f"{OURS}, 4": [curve(1.0, FALLING)], f"{OURS}, 1": [curve(0.5, FALLING)],
            "a": [curve(4.0, FALLING)]}
    text = rows({"title": "Box", "first": dict.fromkeys(runs, 2.0), "measure": "RMS",
                 "runs": {name: [each._asdict() for each in curves] for name, curves in runs.items()}})
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in text]
    assert [line[1] for line in cells] == [f"{OURS}, 4", f"{OURS}, 1", "b", "a"]
    assert cells[0][0] == "Box" and cells[0][8] == "**0.12**" and all(line[8] == "" for line in cells[1:])


def test_a_chart_has_the_runs_that_are_soonest():
    slow, never, quick = ([curve(step, errors)] for step, errors in ((2.0, FALLING), (1.0, [1.0, 0.9]), (1.0, FALLING)))
    runs = {"a": never, f"{OURS}, 4": slow, "b": quick, f"{OURS}, 1": quick, "c": slow}
    assert list(soonest(runs, 0.1, 4)) == [f"{OURS}, 1", f"{OURS}, 4", "b", "c"]
    assert list(soonest(runs, 0.1, 2)) == [f"{OURS}, 1", "b"]


def test_runs_of_which_half_do_not_arrive_have_no_seconds():
    runs = [curve(1.0, FALLING), curve(1.0, [1.0, 0.9])]
    assert outcome(runs, 0.3).seconds is None and outcome([*runs, runs[0]], 0.3).seconds == 2.0


@pytest.mark.parametrize("count", [2, len(COLOURS)])
def test_a_panel_has_the_curves_of_all_renderers(count):
    names = [f"{OURS if number < 2 else 'theirs'}, a long name {number}" for number in range(count)]
    runs = {name: [curve(1.0 + number, FALLING)] for number, name in enumerate(names)}
    colours = {colour for _, colour in panel("Box", "RMS", runs, 0.1).getcolors(1 << 16)}
    assert {ImageColor.getrgb(colour) for colour in COLOURS[:count]} <= colours


def test_races_of_a_task_are_joined_with_all_runs_of_ours():
    fast, slow = (curve(step, FALLING)._asdict() for step in (1.0, 2.0))
    shared = {"title": "Box", "measure": "RMS"}
    found = joined([shared | {"first": {OURS: 1.0, "a": 2.0}, "runs": {OURS: [fast], "a": [slow]}},
                    shared | {"first": {OURS: 3.0, "b": 4.0}, "runs": {OURS: [slow], "b": [fast]}}])
    assert found == shared | {"first": {OURS: 1.0, "a": 2.0, "b": 4.0},
                              "runs": {OURS: [fast, slow], "a": [slow], "b": [fast]}}


@pytest.mark.parametrize("name", TASKS)
def test_the_truth_has_no_error_and_the_first_guess_has(name, tmp_path):
    task = TASKS[name](tmp_path)
    scene = task.load()
    if name == "pose":
        truth = {"block": np.zeros((2, 3))}
    elif name == "shape":
        ball = scene.body.vertex_positions.numpy()
        truth = {"body": ball * radius(ball)[:, None]}
    else:
        truth = parameters(scene, [unknown.name for unknown in task.unknowns])
    assert task.error(truth) < 1e-6
    guess = {unknown.name: unknown.ours(scene).found() for unknown in task.unknowns}
    assert task.error(guess) > 0.1


SAMPLERS = {None: LowDiscrepancy, "independent": Independent, "multijitter": MultiJitter}
OTHERS = [name for name in TASKS if name != "pose"]


@pytest.mark.parametrize("name, samplers", [("pose", SAMPLERS), *((name, ["multijitter"]) for name in OTHERS),
                                            *(deep(name, SAMPLERS) for name in OTHERS)])
def test_a_task_begins_with_the_samplers_asked_for(name, samplers, tmp_path):
    task = TASKS[name](tmp_path)
    for sampler in samplers:
        scene = task.sampled(tmp_path, sampler).load()
        assert len(scene.sensors) == task.views
        assert all(type(sensor.sampler) is SAMPLERS[sampler] for sensor in scene.sensors)


@pytest.mark.deep
@pytest.mark.parametrize("name", TASKS)
def test_a_task_runs_with_both_renderers(name, tmp_path):
    pytest.importorskip("mitsuba")
    pytest.importorskip("cholespy")
    command = [sys.executable, "-m", "benchmarks.headline", "--task", name, "--quick", "--seeds", "1", "--target-samples",
               "16", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=HERE)
    if "libLLVM" in done.stderr or "LLVM ERROR" in done.stderr:
        pytest.skip("Mitsuba finds no LLVM that it works with")
    assert done.returncode == 0, done.stderr
    runs = json.loads((tmp_path / f"{name}.json").read_text())["runs"]
    starts = {one["errors"][0] for curves in runs.values() for one in curves}
    assert max(starts) - min(starts) < 1e-4 * max(starts), "all begin with the same guess"
    for curves in runs.values():
        assert len(curves[0]["errors"]) == 3 and np.isfinite(curves[0]["errors"]).all()
        assert curves[0]["errors"][-1] != curves[0]["errors"][0] > 0
    assert Image.open(tmp_path / "curves.png").size == (1120, 400)
    assert (tmp_path / "table.md").read_text() in done.stdout + "\n"
