"""The comparison of loops that shape a plate of glass: what it counts, and both sides."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from PIL import Image

from benchmarks.caustic import EVERY, Run, run
from benchmarks.caustic_loops import PLATE, OurLoop, Schedule, as_colours, at_vertices, larger
from benchmarks.scenes.caustic import PICTURES, PIXELS
from torch_radbp.shape.normals import angle_weighted_normals

HERE = Path(__file__).parents[2]


def test_a_run_knows_losses_and_plates_after_steps_and_seconds():
    found = Run([0.5 * (step + 1) for step in range(30)], [float(step) for step in range(30)], list(torch.arange(3.0)))
    assert [found.until(seconds) for seconds in (0.1, 5.0, 9.9, 10.0, 99.0)] == [10, 10, 10, 20, 30]
    assert found.loss(20) == 14.5 and found.plate(20) == 1.0
    assert found.curve().seconds == [0.0, 5.0, 10.0, 15.0]


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_have_many_tones_and_a_mean_of_one(name):
    picture = PICTURES[name]()
    assert picture.shape == (PIXELS, PIXELS) and abs(picture.mean() - 1) < 1e-5
    assert picture.min() > 0.05, "no caustic is black, since light is lost nowhere"
    assert picture.std() > 0.3


def test_the_schedule_is_the_tutorials():
    schedule = Schedule()
    calm = [number for number in range(1000) if schedule.calms(number)]
    assert calm == [700, 900] and schedule.spp == 128 and schedule.rate == 3e-5 / 4


def test_a_larger_grid_shows_the_same_plane():
    rise = torch.arange(8.0).expand(8, 8)
    assert torch.allclose(larger(rise, 16)[:, 1:-1].diff(dim=1), torch.tensor(0.5))


def test_texels_are_the_normals_of_the_smooth_mesh():
    heights = at_vertices(1e-4 * torch.randn(64, 64, generator=torch.Generator().manual_seed(1)))
    across = torch.linspace(-1, 1, PLATE)
    v, u = torch.meshgrid(across, across, indexing="ij")
    number = torch.arange(PLATE * PLATE).view(PLATE, PLATE)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = torch.cat([torch.stack(each, -1).reshape(-1, 3) for each in ((a, b, c), (b, d, c))])
    normals = angle_weighted_normals(torch.stack([u, v, heights], -1).reshape(-1, 3), faces).view(PLATE, PLATE, 3)
    inside = slice(1, -1)
    assert normals[inside, inside, :2].abs().max() > 0.005
    assert torch.allclose(2 * as_colours(heights)[inside, inside] - 1, normals[inside, inside], atol=2e-5)


def test_our_loop_comes_nearer_to_the_picture():
    loop = OurLoop(PICTURES["letters"]())
    loop.schedule.spp = 1  # where an image has 128 x 128 pixels
    found = run(loop, its=2 * EVERY, seconds=float("inf"))
    assert len(found.losses) == 2 * EVERY and len(found.plates) == 2
    assert found.loss(2 * EVERY) < 0.9 * found.loss(EVERY)


@pytest.mark.deep
def test_both_renderers_run(tmp_path):
    pytest.importorskip("mitsuba")
    done = subprocess.run([sys.executable, "-m", "benchmarks.caustic", "--its", "20", "--spp", "64", "--pictures", "letters",
                           "--out", tmp_path], capture_output=True, text=True, cwd=HERE)
    if "libLLVM" in done.stderr or "LLVM ERROR" in done.stderr:
        pytest.skip("Mitsuba finds no LLVM that it works with")
    assert done.returncode == 0, done.stderr
    rows = [line.split(" | ") for line in done.stdout.splitlines()[2:]]
    assert [row[1] for row in rows[:1]] == ["20 steps"] and len(rows) == 4
    assert 0.9 < float(rows[0][4]) < 1.1, "after equal steps both have the same loss"
    assert Image.open(tmp_path / "curves.png").size == (1120, 400)
    assert Image.open(tmp_path / "caustics.png").width > 500
