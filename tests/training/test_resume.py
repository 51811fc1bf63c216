"""Interrupted runs: whatever moment Ctrl-C comes at, the run continues as if nothing had happened."""

import os
import signal

import pytest
import torch
from rich.console import Console

from tests.deep import deep
from tests.training.conftest import write_files
from torch_radbp.training.recovery import optimize
from torch_radbp.training.recovery.checkpoint import FILE_NAME, load_checkpoint
from torch_radbp.training.recovery.metrics import MetricsFile
from torch_radbp.training.run import run

QUIET = Console(quiet=True)


def start(folder, out, resume=False, overrides=()):
    """Runs the recipe of the fixture; returns the summary."""
    summary, report = run(folder / "recipe.toml", list(overrides), folder / out, resume, QUIET)
    assert report.is_file()
    return summary


def results(path):
    """All that must not depend on interruptions: parameters, optimiser state, metrics without times."""
    checkpoint = load_checkpoint(path / FILE_NAME, 2**20)
    rows = MetricsFile(path / "metrics.csv").rows()
    metrics = [{key: value for key, value in row.items() if "seconds" not in key} for row in rows]
    return checkpoint["parameters"], checkpoint["moments"], metrics


def assert_same_results(path_a, path_b):
    parameters_a, moments_a, metrics_a = results(path_a)
    parameters_b, moments_b, metrics_b = results(path_b)
    assert metrics_a == metrics_b
    for name, value in parameters_a.items():
        assert torch.equal(value, parameters_b[name])
    for name, moments in moments_a.items():
        for key, value in moments.items():
            assert torch.equal(value, moments_b[name][key])
    assert (path_a / "parameters.safetensors").read_bytes() == (path_b / "parameters.safetensors").read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a run that nothing has interrupted."""
    folder = write_files(tmp_path_factory.mktemp("files"))
    start(folder, "whole")
    return folder / "whole"


def interrupt_rendering_at(monkeypatch, interrupted_step):
    render = optimize.render_buffers

    def interrupted(recovery, step):
        if step == interrupted_step:
            raise KeyboardInterrupt
        return render(recovery, step)

    monkeypatch.setattr(optimize, "render_buffers", interrupted)


SIGMOID, RMSPROP = ['parameters.0.parametrisation="sigmoid"'], ["optimizer={name='rmsprop'}"]


@pytest.mark.parametrize("overrides, step", [(SIGMOID, 0), (RMSPROP, 3), deep([], 0), deep([], 3), deep(SIGMOID, 3),
                                             deep(RMSPROP, 0)])
def test_resumed_run_is_bit_identical(step, overrides, folder, monkeypatch):
    whole = start(folder, "whole", overrides=overrides)
    with monkeypatch.context() as patch:
        interrupt_rendering_at(patch, step)
        summary = start(folder, "broken", overrides=overrides)
    assert summary["status"] == "interrupted" and summary["step"] == step
    assert (folder / "broken" / "scene" / "scene.xml").is_file()
    resumed = start(folder, "broken", resume=True, overrides=overrides)
    assert resumed["status"] == "finished" and resumed["step"] == whole["step"] == 6
    assert_same_results(folder / "whole", folder / "broken")
    recovered = [each["recovered"] for each in resumed["parameters"]]
    assert recovered[0] != [0.5, 0.5, 0.5], "the run must have moved something for this to mean anything"


def test_interrupt_during_the_update_waits_for_its_end(folder, whole, monkeypatch):
    adam_step = torch.optim.Adam.step
    count = 0

    def step(self, *args):
        nonlocal count
        count += 1
        result = adam_step(self, *args)
        if count == 4:
            # As Ctrl-C between the optimiser's step and the scheduler's.
            os.kill(os.getpid(), signal.SIGINT)
        return result

    with monkeypatch.context() as patch:
        patch.setattr(torch.optim.Adam, "step", step)
        summary = start(folder, "broken")
    assert summary["status"] == "interrupted" and summary["step"] == 4
    start(folder, "broken", resume=True)
    assert_same_results(whole, folder / "broken")


def test_crash_after_the_last_checkpoint_repeats_the_lost_steps(folder, whole, monkeypatch):
    render = optimize.render_buffers

    def crash(recovery, step):
        if step == 5:
            raise MemoryError("no memory left")
        return render(recovery, step)

    with monkeypatch.context() as patch:
        patch.setattr(optimize, "render_buffers", crash)
        with pytest.raises(MemoryError):
            start(folder, "broken")
    with (folder / "broken" / "metrics.csv").open("a") as file:
        file.write("5,0.1")  # a line that the crash cut off
    assert load_checkpoint(folder / "broken" / FILE_NAME, 2**20)["step"] == 4
    start(folder, "broken", resume=True)
    assert_same_results(whole, folder / "broken")


def test_interrupt_before_the_first_image_is_resumable(folder, whole, monkeypatch):
    from torch_radbp.training import run as run_module

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(run_module, "save_before", interrupted)
        with pytest.raises(KeyboardInterrupt):
            start(folder, "broken")
    start(folder, "broken", resume=True)
    assert_same_results(whole, folder / "broken")
    assert (folder / "broken" / "images" / "camera_before.png").is_file()


def test_finished_run_takes_more_steps(folder):
    overrides = ["schedule={name='constant'}"]
    start(folder, "whole", overrides=overrides)
    start(folder, "longer", overrides=[*overrides, "steps=4"])
    start(folder, "longer", resume=True, overrides=overrides)
    assert_same_results(folder / "whole", folder / "longer")


def test_resume_with_another_recipe_is_refused(folder):
    start(folder, "first", overrides=["steps=1"])
    with pytest.raises(ValueError, match="another recipe: render.spp was 4 and is 8; a resumed run may only"):
        start(folder, "first", resume=True, overrides=["steps=2", "render.spp=8"])


def test_resume_with_fewer_steps_is_refused(folder):
    start(folder, "first", overrides=["steps=2"])
    with pytest.raises(ValueError, match="at step 2 already, beyond steps = 1"):
        start(folder, "first", resume=True, overrides=["steps=1"])


def test_resume_without_a_run_is_refused_and_writes_nothing(folder):
    with pytest.raises(ValueError, match="holds no checkpoint"):
        start(folder, "nothing", resume=True)
    assert not (folder / "nothing").exists()


def test_folder_in_use_is_refused(folder):
    start(folder, "first", overrides=["steps=1"])
    with pytest.raises(FileExistsError, match="is not empty; .*--resume"):
        start(folder, "first")


def test_bad_scene_leaves_no_folder(folder):
    (folder / "scene.xml").write_text("<scene version='3.0.0'/>")
    with pytest.raises(ValueError, match="sensor"):
        start(folder, "nothing")
    assert not (folder / "nothing").exists()
