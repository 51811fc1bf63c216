"""Steps beside busy processes run from end to end where Mitsuba is installed, and leave no process behind."""

import json
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import pytest

from benchmarks.busy import TORCHRUN, TUTORIAL, busy_processes, cases, cells, table

HERE = Path(__file__).parents[2]
STEPS = {"scene": TUTORIAL, "resolution": 128, "spp": 4, "busy": 2, "ours": [0.03, 0.01, 0.02], "mitsuba": [0.04, 0.1, 0.01]}
RANKS = {"scene": TORCHRUN, "resolution": 64, "spp": 1, "busy": 0, "alone": [0.1], "together": [0.16], "processes": 2}


def test_ratios_are_ours_over_theirs():
    assert cells(STEPS) == [TUTORIAL, "128 x 128, 4", "2", "20.0", "40.0", "0.50"]


def test_throughput_is_of_all_processes_over_that_of_one():
    """Two processes that take 0.16 s a step make 12.5 steps a second, one that takes 0.1 s makes 10."""
    assert cells(RANKS)[-1] == "1.25"


def test_every_row_has_a_cell_for_each_heading():
    shown = table([STEPS, RANKS])
    assert shown.row_count == 2 and len(shown.columns) == len(cells(STEPS)) == len(cells(RANKS))


def test_scenes_are_small_and_the_loop_is_as_written():
    options = Namespace(scene=[TUTORIAL, "metal-mesh"], resolution=None, spp=None)
    assert list(cases(options)) == [(TUTORIAL, 128, 4), *(("metal-mesh", size, spp) for size in (64, 128) for spp in (1, 4))]
    assert list(cases(Namespace(scene=[TORCHRUN], resolution=[8], spp=[2]))) == [(TORCHRUN, 8, 2)]


def test_neighbours_end_with_the_measurement_also_after_an_error():
    with pytest.raises(KeyboardInterrupt), busy_processes(2) as processes:
        assert len(processes) == 2 and all(process.poll() is None for process in processes)
        raise KeyboardInterrupt
    assert all(process.returncode is not None for process in processes)


@pytest.mark.parametrize("scene", [TUTORIAL, "cornell-box"])
def test_it_runs_on_a_small_scene(scene, tmp_path):
    pytest.importorskip("mitsuba")
    figures = tmp_path / "figures.json"
    command = [sys.executable, "-m", "benchmarks.busy", "--scene", scene, "--resolution", "8", "--spp", "1", "--rounds", "2",
               "--busy", "0", "1", "--json", str(figures)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=HERE)
    if "libLLVM" in done.stderr or "LLVM ERROR" in done.stderr:
        pytest.skip("Mitsuba finds no LLVM that it works with")
    assert done.returncode == 0, done.stderr
    found = json.loads(figures.read_text())
    assert [(each["scene"], each["busy"]) for each in found] == [(scene, 0), (scene, 1)]
    assert all(len(each[peer]) == 2 and min(each[peer]) > 0 for each in found for peer in ("ours", "mitsuba"))


@pytest.mark.deep
def test_two_processes_under_torchrun_are_measured(tmp_path):
    figures = tmp_path / "figures.json"
    command = [sys.executable, "-m", "benchmarks.busy", "--scene", TORCHRUN, "--resolution", "8", "--spp", "1", "--rounds",
               "2", "--turns", "1", "--json", str(figures)]
    subprocess.run(command, check=True, cwd=HERE)
    (found,) = json.loads(figures.read_text())
    assert len(found["alone"]) == len(found["together"]) == 2
