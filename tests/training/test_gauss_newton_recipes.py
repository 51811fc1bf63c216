"""`optimizer = "gauss-newton"` in recipes: least squares of all parameters together, within bounds, resumed to the bit."""

import json
import os
import shutil
import signal

import pytest
import torch
from rich.console import Console

from tests.deep import deep
from tests.training.conftest import write_files
from torch_radbp.formats.image import save_image
from torch_radbp.optim import GaussNewton
from torch_radbp.training.recipe_file import RecipeError, read_recipe
from torch_radbp.training.recovery.checkpoint import FILE_NAME, load_checkpoint, save_checkpoint
from torch_radbp.training.recovery.gauss_newton import JointSteps
from torch_radbp.training.recovery.metrics import MetricsFile
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.run import run

TRUTH = [0.2, 0.5, 0.7]
QUIET = Console(quiet=True)
GAUSS_NEWTON = 'optimizer = "gauss-newton"\n'


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The recipe with Gauss-Newton, and a target that is an image of its scene by other samples."""
    folder = write_files(tmp_path_factory.mktemp("files"))
    path = folder / "recipe.toml"
    text = path.read_text()
    for old, new in (('[optimizer]\nname = "adam"\nlearning_rate = 0.05\n\n[schedule]\nname = "cosine"\n', ""),
                     ("steps = 6\n", f"steps = 6\n{GAUSS_NEWTON}"), ("spp = 4\nmax_depth = 3", "spp = 16\nmax_depth = 3")):
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text)
    recovery = Recovery(read_recipe(path, [f"parameters.0.initial={TRUTH}"]))
    with torch.no_grad():
        save_image(folder / "target.exr", recovery.renderer(seed=10**6, spp=1024)[0])
    return folder


@pytest.fixture
def joint(files, tmp_path):
    return shutil.copytree(files, tmp_path / "joint", ignore=shutil.ignore_patterns("whole"))


NOISY = ["optimizer={name='gauss-newton', max_spp=16}", "report.checkpoint_every=1", "steps=8"]  # keeps Jacobians


@pytest.fixture(scope="module")
def whole(files):
    """The folder of a run that keeps Jacobians, and that nothing has interrupted."""
    start(files, "whole", *NOISY)
    return files / "whole"


def start(folder, out, *overrides, resume=False):
    """The summary of a run."""
    return run(folder / "recipe.toml", list(overrides), folder / out, resume, QUIET)[0]


def results(path):
    """All that must not depend on interruptions."""
    state = load_checkpoint(path / FILE_NAME, 2**20)
    rows = [{key: value for key, value in row.items() if "seconds" not in key}
            for row in MetricsFile(path / "metrics.csv").rows()]
    return {key: value for key, value in state.items() if key not in ("seconds", "parameters")}, state["parameters"], rows


@pytest.mark.parametrize("parametrisation", [deep("clamp"), "sigmoid"])
def test_few_steps_find_what_an_image_shows(parametrisation, joint):
    summary = start(joint, "run", f"parameters.0.parametrisation={parametrisation}")
    found = summary["parameters"][0]
    assert found["before"] == [0.5] * 3 and found["largest_error"] < 0.01
    rows = MetricsFile(joint / "run" / "metrics.csv").rows()
    assert len(rows) == 6 and abs(rows[-1]["loss"]) < 0.05 * rows[0]["loss"], "but for the noise of 48 pixels"
    assert rows[0]["loss"] == pytest.approx(rows[0]["loss.two_buffer_l2"], rel=1e-5)
    assert rows[-1]["gauss_newton.spp"] >= rows[0]["gauss_newton.spp"] >= 16


def test_bounds_of_a_recipe_are_kept_to(joint):
    found = start(joint, "run", "parameters.0.bounds=[0.3, 0.6]", "steps=3")["parameters"][0]["recovered"]
    assert found[0] == pytest.approx(0.3) and 0.3 <= found[1] <= 0.6 and found[2] == pytest.approx(0.6)


def test_without_bounds_the_range_of_the_scene_is_kept_to(joint):
    path = joint / "recipe.toml"
    path.write_text(path.read_text().replace("bounds = [0.0, 1.0]\n", ""))
    recovery = Recovery(read_recipe(path))
    assert recovery.joint.optimizer.low.tolist() == [0.0] * 3 and recovery.joint.optimizer.high.tolist() == [1.0] * 3
    recovery = Recovery(read_recipe(path, ["parameters.0.parametrisation=log"]))
    assert recovery.joint.optimizer.low.tolist() == [-float("inf")] * 3


def test_masks_losses_and_weights_are_in_the_residuals(joint):
    mask = torch.ones(3, 6, 8)
    mask[:, :, :4] = 0.0
    save_image(joint / "mask.png", mask)
    recovery = Recovery(read_recipe(joint / "recipe.toml", [
        "targets.0.mask=mask.png", "loss=[{name='two_buffer_l2', weight=3.0}, {name='l2', tone_mapping='log1p'}]"]))
    with torch.no_grad():
        pair = recovery.joint.residuals(0, 16), recovery.joint.residuals(1, 16)
        images = [recovery.renderer(seed=seed, spp=16, sensors=[0])[:, :, :, 4:] for seed in (0, 1)]
    target = recovery.targets.images[:, :, :, 4:]
    found = torch.cat([one.flatten() for one in pair[0]]) @ torch.cat([one.flatten() for one in pair[1]]) / (2 * 3 * 6 * 8)
    logs = [image.log1p() - target.log1p() for image in images]
    expected = 3 * ((images[0] - target) * (images[1] - target)).mean() + (logs[0] * logs[1]).mean()
    assert expected.isfinite() and expected > 0
    torch.testing.assert_close(found, expected)


def interrupting(stop: int, call: int):
    """`JointSteps.residuals` with a signal at a call within a step."""
    residuals, steps = JointSteps.residuals, []

    def interrupted(self, seed, spp):
        if self.recovery.step == stop:
            steps.append(seed)
            if len(steps) == call:
                os.kill(os.getpid(), signal.SIGINT)
        return residuals(self, seed, spp)

    return interrupted


@pytest.mark.parametrize("stops", [[(0, 5), (6, 1)], deep([(4, 1)])])  # the last two have Jacobians of an earlier step
def test_a_resumed_run_is_bit_identical(stops, joint, whole, monkeypatch):
    for stop, call in stops:
        with monkeypatch.context() as patch:
            patch.setattr(JointSteps, "residuals", interrupting(stop, call))
            summary = start(joint, "broken", *NOISY, resume=(joint / "broken").exists())
        assert summary["status"] == "interrupted" and summary["step"] == stop
    start(joint, "broken", *NOISY, resume=True)
    whole, broken = results(whole), results(joint / "broken")
    assert whole[0] == broken[0] and whole[2] == broken[2] and len(whole[2]) == 8
    for name, value in whole[1].items():
        assert torch.equal(value, broken[1][name])
    assert whole[2][0]["paint.reflectance.value[0]"] != 0.5


def test_jacobians_that_are_kept_are_in_a_checkpoint_as_their_place(whole):
    rows = MetricsFile(whole / "metrics.csv").rows()
    assert max(row["gauss_newton.noise_share"] for row in rows) > 0.3, "or noise limited no step, and nothing was kept"
    state = load_checkpoint(whole / FILE_NAME, 2**20)["joint"]
    assert state["search"]["averaged"] > 0 and state["seed"] == 8
    assert state["kept_at"] is None or len(state["kept_at"]["position"]) == 3


def test_an_optimizer_continues_from_its_state():
    def noisy(seed, spp):
        generator = torch.Generator().manual_seed(seed)
        noise = torch.randn(20, 2, generator=generator, dtype=torch.float64) / spp ** 0.5
        matrix = torch.linspace(1, 2, 40, dtype=torch.float64).view(20, 2).cos()
        return (matrix + 0.3 * noise) @ (here.exp() - 1.0) + noise[:, 0]

    def optimizer():
        return GaussNewton([here], spp=1, max_spp=4)

    here = torch.tensor([0.7, -0.4], dtype=torch.float64, requires_grad=True)
    one = optimizer()
    states = []
    for _ in range(12):
        states.append((one.state_dict(), here.detach().clone()))
        one.step(noisy)
    end, search = here.detach().clone(), dict(one.search)
    assert any(state["kept_at"] is not None for state, _ in states) and not torch.equal(end, states[0][1])
    for state, at in states:
        with torch.no_grad():
            here.copy_(at)
        other = optimizer()
        other.load_state_dict(state)
        for _ in range(12 - states.index((state, at))):
            other.step(noisy)
        assert torch.equal(here.detach(), end) and other.search == search


def test_a_state_of_another_optimizer_is_refused():
    here = torch.zeros(2, requires_grad=True)
    with pytest.raises(ValueError, match="none of GaussNewton: search, seed, kept_for, kept_at"):
        GaussNewton([here]).load_state_dict(torch.optim.Adam([here]).state_dict())


UNFIT = {
    "a loss that is no sum of squares": (["loss=[{name='l1'}]"], "the loss l1: it takes two_buffer_l2 and l2"),
    "a schedule": (["schedule={name='cosine'}"], "a schedule: it chooses its steps itself"),
    "a learning rate": (["parameters.0.learning_rate=0.1"], "an optimizer, learning_rate or schedule of a parameter"),
    "its own learning rate": (["optimizer={name='gauss-newton', learning_rate=0.1}"], "unknown key 'learning_rate'"),
    "one parameter": (["optimizer=adam", "parameters.0.optimizer=gauss-newton"], "moves all parameters together"),
    "stages": (["stages=[{from_step=3, spp=8}]"], "stages"),
    "priors": (["priors=[{name='white_balance', parameter='paint.*', weight=1.0}]"], "priors"),
    "an unknown optimiser": (["optimizer=newton"], "got 'newton'"),
}


@pytest.mark.parametrize("case", UNFIT)
def test_what_does_not_go_together_is_one_message(case, joint):
    overrides, words = UNFIT[case]
    with pytest.raises(RecipeError) as error:
        read_recipe(joint / "recipe.toml", overrides)
    assert words in str(error.value) and len(str(error.value).splitlines()) == 1
    if "unknown optimiser" in case:
        assert "'gauss-newton'" in str(error.value) and "'adam'" in str(error.value)


FORGED = {
    "no table": (lambda joint: None, "joint is no table"),
    "no seed": (lambda joint: {key: value for key, value in joint.items() if key != "seed"}, "joint.seed is missing"),
    "words": (lambda joint: joint | {"seed": "one"}, "joint.seed is 'one'"),
    "below zero": (lambda joint: joint | {"search": joint["search"] | {"damping": -1.0}}, "joint.search.damping is -1.0"),
    "a place of others": (lambda joint: joint | {"kept_at": {"position": [0.1], "seed": 1, "spp": 4}},
                          "instead of 3 finite numbers"),
}


def test_a_forged_state_is_one_message(joint):
    start(joint, "run", "steps=2")
    path = joint / "run" / FILE_NAME
    state = load_checkpoint(path, 2**20)
    for forge, words in FORGED.values():
        save_checkpoint(path, state | {"joint": json.loads(json.dumps(forge(state["joint"])))})
        with pytest.raises(ValueError, match=words.replace(".", r"\.")):
            start(joint, "run", "steps=4", resume=True)


def test_steps_that_are_not_finite_are_skipped_and_leave_nothing(joint, monkeypatch):
    residuals = JointSteps.residuals

    def broken(self, seed, spp):
        found = residuals(self, seed, spp)
        return [each * float("nan") for each in found] if self.recovery.step == 2 else found

    monkeypatch.setattr(JointSteps, "residuals", broken)
    with pytest.warns(UserWarning, match="step 2: residuals must be finite"):
        summary = start(joint, "run")
    rows = MetricsFile(joint / "run" / "metrics.csv").rows()
    assert summary["skipped"] == 1 and summary["parameters"][0]["largest_error"] < 0.02
    assert rows[2]["paint.reflectance.value[0]"] == rows[1]["paint.reflectance.value[0]"]
