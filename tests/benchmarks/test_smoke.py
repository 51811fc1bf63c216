"""The comparison of loops that find a density: what it counts, and both sides on tiny images."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from PIL import Image

from benchmarks.smoke import Judge
from benchmarks.smoke_loops import LEAST, MOST, RATE, START, OurLoop, Run, SameLoop, Setup, run, scene_file
from torch_radbp.formats.volume import read_volume

HERE = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def judge(tmp_path_factory) -> Judge:
    return Judge(scene_file(tmp_path_factory.mktemp("smoke"), views=2, resolution=12, scale=40.0), fine=16, spp=32)


def test_a_run_knows_what_it_had_by_a_time():
    found = Run([0.0, 1.0, 3.0], [torch.zeros(1)] * 3)
    assert [found.until(seconds) for seconds in (0.0, 0.9, 1.0, 2.9, 3.0, 9.0)] == [0, 0, 1, 1, 2, 2]


def test_the_truth_has_no_error_but_the_noise_of_its_images(judge):
    assert judge.of_grid(judge.truth) == 0
    assert max(judge.of_images(judge.truth)) < 0.25 * min(judge.of_images(torch.full_like(judge.truth, START)))


def setup_of(judge: Judge, fine: int) -> Setup:
    return Setup(judge.scene_file, judge.images[0][:2].movedim(1, -1).numpy(), spp=4, rounds=20, fine=fine)


def test_our_loop_comes_nearer_to_the_images(judge):
    found = run(OurLoop(setup_of(judge, fine=16)), rounds=20)
    assert len(found.grids) == 41 and found.grids[-1].shape == (16, 16, 16, 1)
    before, after = (judge.of_images(grid) for grid in (found.grids[0], found.grids[-1]))
    assert after[0] < 0.8 * before[0] and after[1] < 0.9 * before[1]


def test_the_copy_of_the_tutorials_loop_keeps_to_its_rate_and_ends(judge):
    loop = SameLoop(setup_of(judge, fine=32)._replace(rounds=1))
    found = run(loop, rounds=1)
    assert [len(grid) for grid in found.grids] == [16, 16, 32]
    assert 0 < (found.grids[1] - found.grids[0]).abs().max() <= 2.5 * RATE  # a step after each of two views
    assert LEAST == found.grids[-1].min() < found.grids[-1].max() <= MOST


def test_both_cameras_and_grid_are_those_of_the_file(judge):
    assert [sensor for sensor in judge.scene.named_sensors] == ["view_0", "view_1", "between_0", "between_1"]
    plume = read_volume(HERE / "assets" / "shapes" / "plume.vol", (1,))
    assert torch.equal(judge.truth, torch.from_numpy(plume.values))


@pytest.mark.deep
def test_both_renderers_run(tmp_path):
    pytest.importorskip("mitsuba")
    done = subprocess.run([sys.executable, "-m", "benchmarks.smoke", "--small", "--out", tmp_path], capture_output=True,
                          text=True, cwd=HERE)
    if "libLLVM" in done.stderr or "LLVM ERROR" in done.stderr:
        pytest.skip("Mitsuba finds no LLVM that it works with")
    assert done.returncode == 0, done.stderr
    rows = [line.split(" | ") for line in done.stdout.splitlines()[2:]]
    assert [row[1] for row in rows] == ["Mitsuba", "ours", "ours, its loop", "Mitsuba, our loop"] * 3
    assert len({row[3] for row in rows[-4:]}) == 4, "each has changed the grid in its own way"
    assert Image.open(tmp_path / "curves.png").size == (1120, 800)
    assert Image.open(tmp_path / "slices.png").width > 100
