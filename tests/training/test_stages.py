"""Stages, mini-batches of views, groups with schedules of their own: what a step does follows from recipe and step alone."""

import pytest
import torch
from rich.console import Console

from tests.deep import deep
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery import optimize
from torch_radbp.training.recovery.checkpoint import FILE_NAME, CheckpointError, load_checkpoint
from torch_radbp.training.recovery.continuation import check_state, state_bytes
from torch_radbp.training.recovery.optimize import render_buffers, shown_in
from torch_radbp.training.recovery.plan import Plan
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.run import run

TEXELS = "picture.reflectance.data"
PICTURE = f"""[[parameters]]
name = "{TEXELS}"
bounds = [0.0, 1.0]
parametrisation = "sigmoid"
coarse_to_fine = {{ cells = [1, 1], double_at = [2, 4, 5] }}
optimizer = {{ name = "sgd", momentum = 0.5, learning_rate = 0.2 }}
schedule = {{ name = "step", every = 3, factor = 0.1 }}
truth = "scene"

[gains]
learning_rate = 0.03

[[stages]]
from_step = 1
scale = 0.5
spp = 2
parameters = ["{TEXELS}"]

[[stages]]
from_step = 3
learning_rates = {{ "paint.*" = 0.5 }}
views_per_step = 1

"""


def start(path, out, overrides=(), resume=False):
    summary, _ = run(path, list(overrides), path.parent / out, resume, Console(quiet=True))
    return summary


@pytest.fixture
def staged(two_views):
    """Two views, two parameters and gains; the first step, then two small ones that move the picture alone, then all.

    The picture, 4 x 4 texels, is as fine as it can be after four steps.
    """
    two_views.write_text(two_views.read_text().replace("[render]", PICTURE + "[render]"))
    return two_views


def test_views_take_turns_until_all_had_one(folder):
    recipe = read_recipe(folder / "recipe.toml", [])
    views = 7
    plan = Plan(recipe.model_copy(update={"views_per_step": 3}), [], views)
    epochs = [sorted(view for step in range(2 * epoch, 2 * epoch + 2) for view in plan.views(step)) for epoch in range(60)]
    assert all(len(set(epoch)) == 6 for epoch in epochs), "no view twice in an epoch"
    assert len({tuple(epoch) for epoch in epochs}) > 3, "what is left over of an epoch is not always the same"
    counts = torch.bincount(torch.tensor(sum(epochs, [])), minlength=views)
    assert counts.sum() == 360 and counts.min() > 40
    assert [plan.views(step) for step in range(9)] == [plan.views(step) for step in range(9)]
    assert Plan(recipe, [], views).views(5) == list(range(views))


def test_a_step_renders_its_views_alone(two_views):
    recovery = Recovery(read_recipe(two_views, ["views_per_step=1"]))
    seen = set()
    for step in range(8):
        shown, buffers = shown_in(recovery, step), render_buffers(recovery, step)
        assert buffers[0].shape == (1, 3, 6, 8) and shown.images.shape == (1, 3, 6, 8)
        seen.add(shown.views[0])
    assert seen == {0, 1}


def test_a_stage_has_small_images_its_own_samples_and_moves_some(staged):
    recovery = Recovery(read_recipe(staged))
    calls = []
    forward = recovery.renderer.forward
    recovery.renderer.forward = lambda **call: calls.append(call["spp"]) or forward(**call)
    shapes = [tuple(render_buffers(recovery, step)[0].shape) for step in range(5)]
    assert shapes == [(2, 3, 6, 8), (2, 3, 3, 4), (2, 3, 3, 4), (1, 3, 6, 8), (1, 3, 6, 8)]
    assert calls == [4, 4, 2, 2, 2, 2, 4, 4, 4, 4]
    small = shown_in(recovery, 1).images
    torch.testing.assert_close(small[0, :, 0, 0], recovery.targets.images[0, :, :2, :2].mean((1, 2)))
    assert [each.name for each in recovery.plan.moving(2)] == [TEXELS]
    assert len(recovery.plan.moving(0)) == len(recovery.plan.moving(3)) == 3


def test_groups_have_learning_rates_and_schedules_of_their_own(staged):
    recovery = Recovery(read_recipe(staged))
    paint, picture, gains = recovery.parameters
    rates = [[recovery.plan.learning_rate(each, step) for each in (paint, picture, gains)] for step in (0, 5)]
    assert rates[0] == pytest.approx([0.05, 0.2, 0.03])
    assert rates[1] == pytest.approx([0.0, 0.02, 0.0], abs=1e-12), "a cosine ends at 0, a step goes on by a tenth"
    assert recovery.plan.learning_rate(paint, 3) == pytest.approx(0.5 * 0.345, rel=0.01)
    assert type(recovery.optimizers[TEXELS]).__name__ == "SGD" and type(recovery.optimizers[gains.name]).__name__ == "Adam"


def test_what_a_stage_does_not_name_rests(staged):
    start(staged, "run", ["steps=3"])
    rows = (staged.parent / "run" / "metrics.csv").read_text().splitlines()
    columns = rows[0].split(",")
    values = [dict(zip(columns, row.split(","))) for row in rows[1:]]
    for name in ("paint.reflectance.value[0]", "gains[1]"):
        assert values[0][name] == values[1][name] == values[2][name]
        assert values[0][name] not in ("0.5", "1.0"), "the first step moves it"
    assert len({each[f"{TEXELS}:mean"] for each in values}) == 3


def test_a_map_becomes_finer_and_the_report_has_images_of_full_size(staged):
    recovery = Recovery(read_recipe(staged))
    picture = recovery.parameters[1]
    assert picture.raw.shape == (1, 1, 3)
    before = picture.value
    for step, cells in enumerate([1, 2, 2, 4, 4, 4]):
        recovery.end(step)
        assert picture.raw.shape == (cells, cells, 3)
        assert torch.equal(picture.value, before)
    summary = start(staged, "run")
    assert summary["step"] == 6 and summary["images"][0]["sensor"] == "camera"
    from torch_radbp.formats.image import read_image
    assert read_image(staged.parent / "run" / "images" / "camera_after.exr").shape == (6, 8, 3)


def results(path):
    state = load_checkpoint(path / FILE_NAME, 2**20)
    tensors = state["parameters"] | {f"{name}/{key}": value for name, held in state["moments"].items()
                                     for key, value in held.items()}
    rows = [",".join(line.split(",")[:2]) for line in (path / "metrics.csv").read_text().splitlines()]
    return tensors, rows


@pytest.mark.parametrize("steps", [(2, 5), deep((1, 3))])
def test_a_run_that_is_interrupted_in_any_stage_continues_bit_for_bit(steps, staged, monkeypatch):
    start(staged, "whole")
    whole, rows = results(staged.parent / "whole")
    assert f"{TEXELS}:base" in whole and f"{TEXELS}/momentum_buffer" in whole
    render = optimize.render_buffers

    def interrupted(recovery, at):
        buffers = render(recovery, at)
        if at == step:
            raise KeyboardInterrupt
        return buffers

    for step in steps:
        name = f"broken_at_{step}"
        with monkeypatch.context() as patch:
            patch.setattr(optimize, "render_buffers", interrupted)
            assert start(staged, name)["step"] == step
        start(staged, name, resume=True)
        broken, rows_again = results(staged.parent / name)
        assert rows == rows_again and whole.keys() == broken.keys()
        assert all(torch.equal(value, broken[name]) for name, value in whole.items())


def test_a_grid_of_another_step_is_no_state_of_the_run(staged):
    start(staged, "run", ["steps=3"])
    recovery, path = Recovery(read_recipe(staged)), staged.parent / "run" / FILE_NAME
    state = load_checkpoint(path, state_bytes(recovery))
    check_state(path, state, recovery)
    state["parameters"][TEXELS] = torch.zeros(4, 4, 3)
    with pytest.raises(CheckpointError, match=r"data is \(4, 4, 3\) float32 instead of \(2, 2, 3\) float32"):
        check_state(path, state, recovery)
    state["parameters"][TEXELS] = torch.zeros(2, 2, 3)
    state["moments"]["paint.reflectance.value"]["step"] += 1
    with pytest.raises(CheckpointError, match="step is 2 after 1 steps that were not skipped"):
        check_state(path, state, recovery)
