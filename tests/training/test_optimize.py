"""The training loop: it recovers what it should, and survives gradients that are not finite."""

import warnings
from importlib import import_module

import pytest
import torch
from rich.console import Console

import torch_radbp as rb
from tests.deep import deep
from torch_radbp.bsdf.diffuse import DiffuseKind
from torch_radbp.formats.image import save_image
from torch_radbp.tensors.stage import EAGER
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recipe_optimizer import Constant, Cosine, Exponential, Step
from torch_radbp.training.recovery import optimize
from torch_radbp.training.recovery.metrics import MetricsFile
from torch_radbp.training.recovery.optimize import step_seed
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.recovery.schedule import learning_rate_factor
from torch_radbp.training.run import run


def write_true_target(folder, spp=256):
    """Replaces the random target by what the scene really looks like."""
    scene = rb.load(folder / "scene.xml")
    save_image(folder / "target.exr", rb.render(scene, spp=spp, seed=123, max_depth=3, caster="brute")[0])


def run_quietly(folder, overrides=()):
    summary, _ = run(folder / "recipe.toml", list(overrides), folder / "run", False, Console(quiet=True))
    return summary


@pytest.mark.parametrize("parametrisation", [deep("clamp"), deep("sigmoid"), "log"])
def test_reflectance_is_recovered(parametrisation, folder, edit_recipe):
    write_true_target(folder)
    if parametrisation == "log":
        edit_recipe("bounds = [0.0, 1.0]", 'parametrisation = "log"')
    else:
        edit_recipe("bounds = [0.0, 1.0]", f'bounds = [0.0, 1.0]\nparametrisation = "{parametrisation}"')
    rate = 0.05 if parametrisation == "clamp" else 0.2
    summary = run_quietly(folder, ["steps=80", f"optimizer.learning_rate={rate}", "render.spp=8"])
    # The start is off by 0.3; 48 noisy pixels leave a hundredth or two.
    assert summary["parameters"][0]["largest_error"] < 0.03
    recovered = torch.tensor(summary["parameters"][0]["recovered"])
    written = rb.load(folder / "run" / "scene" / "scene.xml").get_parameter("paint.reflectance.value")
    torch.testing.assert_close(written.detach(), recovered, atol=1e-6, rtol=0)


def test_bitmap_is_recovered(folder, edit_recipe):
    write_true_target(folder)
    edit_recipe("paint.reflectance.value", "picture.reflectance.data")
    summary = run_quietly(folder, ["steps=40", "optimizer.learning_rate=0.1", "render.spp=16"])
    picture = summary["parameters"][0]
    assert picture["shape"] == [4, 4, 3]
    assert picture["rmse"] < 0.5 * picture["rmse_before"]
    for role in ("before", "recovered", "true"):
        assert (folder / "run" / "textures" / f"picture.reflectance.data_{role}.png").is_file()


def test_values_stay_within_bounds(folder):
    save_image(folder / "target.exr", torch.full((3, 6, 8), 50.0))  # brighter than any reflectance can make it
    summary = run_quietly(folder, ["optimizer.learning_rate=0.5"])
    assert summary["parameters"][0]["recovered"] == [1.0, 1.0, 1.0]


def spoil_gradient(monkeypatch, steps):
    render = optimize.render_buffers

    def spoiled(recovery, step):
        buffers = render(recovery, step)
        return [buffer * float("nan") for buffer in buffers] if step in steps else buffers

    monkeypatch.setattr(optimize, "render_buffers", spoiled)


def test_steps_with_nan_are_skipped_and_counted(folder, monkeypatch):
    spoil_gradient(monkeypatch, {1, 3})
    with pytest.warns(UserWarning, match="not finite; the step is skipped") as caught:
        summary = run_quietly(folder)
    messages = [str(each.message) for each in caught]
    assert any("step 1:" in message and "(1 so far)" in message for message in messages)
    assert any("step 3:" in message and "(2 so far)" in message for message in messages)
    assert summary["skipped"] == 2 and summary["step"] == 6
    recovered = torch.tensor(summary["parameters"][0]["recovered"])
    assert recovered.isfinite().all() and not torch.equal(recovered, torch.full((3,), 0.5))


@pytest.mark.parametrize("where", ["image", "gradient"])
def test_a_rendering_that_is_not_finite_skips_its_step_and_says_what_it_was(where, folder, monkeypatch):
    """The renderer's own errors: a material gives NaN, in its value or in its derivative only, at the third rendering."""
    sample = DiffuseKind.eval_pdf

    def spoiled(kind, values, wi, wo):
        value, pdf = sample(kind, values, wi, wo)
        if step != 2 or (where == "gradient") != value.x.requires_grad:
            return value, pdf
        return value * (torch.sqrt(values[0].x * 0.0) * 0.0 + (1.0 if where == "gradient" else float("nan"))), pdf

    render = optimize.render_buffers

    def counted(recovery, number):
        nonlocal step
        step = number
        return render(recovery, number)

    step = -1
    monkeypatch.setattr(DiffuseKind, "eval_pdf", spoiled)
    # What is compiled would stay as it was when it was compiled.
    monkeypatch.setattr(import_module("torch_radbp.rendering.renderer"), "compiled", lambda: EAGER)
    monkeypatch.setattr(optimize, "render_buffers", counted)
    with pytest.warns(UserWarning, match="the step is skipped") as caught:
        summary = run_quietly(folder)
    message, = (str(each.message) for each in caught)
    assert message.startswith("step 2: the ") and "bounce" in message and "diffuse `" in message
    assert ("gradient of `paint.reflectance.value`" in message) == (where == "gradient")
    assert summary["skipped"] == 1 and summary["step"] == 6
    rows = MetricsFile(folder / "run" / "metrics.csv").rows()
    assert [row["skipped"] for row in rows] == [0, 0, 1, 1, 1, 1]
    assert torch.tensor(summary["parameters"][0]["recovered"]).isfinite().all()


def test_run_without_any_usable_gradient_gives_up(folder, monkeypatch):
    spoil_gradient(monkeypatch, set(range(100)))
    message = "10 steps in a row .* because the loss is not finite; give"
    with pytest.raises(RuntimeError, match=message), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run_quietly(folder, ["steps=100"])


def test_seeds_of_a_run_are_all_different():
    seeds = {step_seed(0, step, stream) for step in range(-1, 1000) for stream in range(2)}
    assert len(seeds) == 2 * 1001
    assert all(0 <= seed < 2**31 for seed in seeds)
    assert step_seed(1, 5, 0) not in seeds


def test_every_setting_of_render_reaches_the_renderer(folder):
    overrides = [
        "render={spp=3, max_depth=2, rr_depth=9, chunk=64, caster='brute', adjoint={stride='sqrt', keep_hits=false}, "
        "terms=['interior', 'shadow']}"
    ]
    renderer = Recovery(read_recipe(folder / "recipe.toml", overrides)).renderer
    assert (renderer.spp, renderer.max_depth, renderer.rr_depth, renderer.chunk) == (3, 2, 9, 64)
    assert (renderer.adjoint.stride, renderer.adjoint.keep_hits) == ("sqrt", False)
    assert list(renderer.terms) == ["interior", "shadow"]
    assert len(Recovery(read_recipe(folder / "recipe.toml", ["render.caster=brute"])).renderer.terms) == 3


def test_depth_of_the_scene_is_used_unless_the_recipe_says_one(folder, edit_recipe):
    recovery = Recovery(read_recipe(edit_recipe("max_depth = 3\n", "")))
    assert recovery.renderer.max_depth == 3


@pytest.mark.parametrize("name", ["replay", "quadratic", "tape"])
def test_strategies_are_chosen_by_name(name, folder):
    recipe = read_recipe(folder / "recipe.toml", [f"render.adjoint.strategy={name}"])
    assert type(Recovery(recipe).renderer.adjoint).__name__.lower() == f"{name}adjoint"


def test_buffers_are_independent_and_share_the_samples_of_an_image(folder):
    recovery = Recovery(read_recipe(folder / "recipe.toml", ["loss=[{name='l2'}]", "render.spp=8"]))
    buffers = optimize.render_buffers(recovery, 0)
    assert not torch.equal(*buffers)
    seed, spp = optimize.step_seed(recovery.recipe.render.seed, 0, 0), 4
    assert torch.equal(buffers[0], recovery.renderer(seed=seed, sensors=recovery.targets.sensors, spp=spp))


def test_scene_variables_are_passed_on(folder, edit_recipe):
    recipe = read_recipe(edit_recipe("steps = 6", "steps = 6\nvariables = { width = 5 }"))
    with pytest.raises(ValueError, match="target.exr is 8 x 6 pixels, .* is 5 x 6"):
        Recovery(recipe)


@pytest.mark.parametrize(
    ("schedule", "factors"),
    [
        (Constant(), [1, 1, 1]),
        (Cosine(name="cosine", final=0.2), [1, 0.6, 0.2]),
        (Exponential(name="exponential", final=0.01), [1, 0.1, 0.01]),
        (Step(name="step", every=5, factor=0.5), [1, 0.5, 0.25]),
    ],
)
def test_schedule_at_start_middle_and_end(schedule, factors):
    assert [learning_rate_factor(schedule, step, 11) for step in (0, 5, 10)] == pytest.approx(factors)
