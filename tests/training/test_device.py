"""Recipes and commands name the device that renders; what this machine lacks is an error that says what to do."""

import pytest
import torch
from rich.console import Console
from typer.testing import CliRunner

from torch_radbp.training.cli import app
from torch_radbp.training.device import usable_device
from torch_radbp.training.ranks import ALONE
from torch_radbp.training.recipe_file import RecipeError, read_recipe
from torch_radbp.training.recovery.checkpoint import FILE_NAME, load_checkpoint, save_checkpoint
from torch_radbp.training.recovery.continuation import check_state
from torch_radbp.training.recovery.optimizers import make_optimizers, moments_of
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.run import run

QUIET = Console(quiet=True)


@pytest.fixture
def two_gpus(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)


@pytest.fixture
def no_gpu(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


def start(folder, overrides=(), resume=False):
    return run(folder / "recipe.toml", ["steps=3", *overrides], folder / "run", resume, QUIET)[0]


def test_a_recipe_names_the_cpu(folder):
    summary = start(folder, ["render.device=cpu"])
    assert summary["status"] == "finished" and summary["machine"]["device"] == "cpu"
    assert read_recipe(folder / "run" / "recipe.toml", allow_outside=True).render.device == "cpu"


@pytest.mark.parametrize("cuda, advice", [(None, "built without CUDA; install one built for it"), ("12.9", "nvidia-smi")])
def test_a_device_that_is_not_there_is_an_error_that_says_what_to_do(cuda, advice, folder, no_gpu, monkeypatch):
    monkeypatch.setattr(torch.version, "cuda", cuda)
    with pytest.raises(ValueError, match=rf"device 'cuda' cannot be used: .*{advice}.*or take the device 'cpu'"):
        start(folder, ["render.device=cuda"])
    assert not (folder / "run").exists(), "nothing is written"


@pytest.mark.parametrize("name", ["gpu", "cuda:x", "meta", "cpu:1", "mps"])
def test_a_device_that_nothing_renders_on_is_an_error_of_the_recipe(name, folder):
    with pytest.raises(RecipeError, match=rf"render.device: device must be 'cpu', 'cuda' or .*'cuda:1', got '{name}'"):
        read_recipe(folder / "recipe.toml", [f"render.device={name}"])


COMMANDS = {"render": ["scene.xml", "-o", "image.png"], "optimize": ["recipe.toml"],
            "check": ["scene.xml", "--param", "paint.reflectance.value"]}


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_have_the_option(command, folder, no_gpu, monkeypatch):
    monkeypatch.chdir(folder)
    result = CliRunner().invoke(app, [command, *COMMANDS[command], "--device", "cuda"])
    assert result.exit_code == 2 and "device 'cuda' cannot be used" in result.output


def test_an_image_is_rendered_on_the_cpu_by_name(folder, monkeypatch):
    monkeypatch.chdir(folder)
    result = CliRunner().invoke(app, ["render", "scene.xml", "-o", "image.png", "--device", "cpu"])
    assert result.exit_code == 0 and (folder / "image.png").is_file()


def test_one_of_several_gpus_is_named_by_its_number(two_gpus):
    assert usable_device("cuda:1") == torch.device("cuda", 1) and usable_device("cuda") == torch.device("cuda", 0)
    with pytest.raises(ValueError, match="'cuda:2' cannot be used: this machine has 2 GPUs, counted from 'cuda:0'"):
        usable_device("cuda:2")


def test_processes_of_a_machine_take_turns_with_its_gpus(two_gpus, monkeypatch):
    found = []
    for rank in range(3):
        monkeypatch.setenv("LOCAL_RANK", str(rank))
        found.append(usable_device("cuda").index)
    assert found == [0, 1, 0]


def test_a_run_continues_on_another_device(folder):
    start(folder)
    assert start(folder, ["render.device=cpu", "steps=4"], resume=True)["step"] == 4


def test_the_state_of_the_optimiser_follows_to_the_device_of_the_parameters(folder):
    """From the CPU to `meta`, which every torch has."""
    start(folder)
    state = load_checkpoint(folder / "run" / FILE_NAME, 2**20)
    recovery = Recovery(read_recipe(folder / "recipe.toml", []), ALONE)
    recovery.scene.to("meta")
    recovery.optimizers = make_optimizers(recovery.parameters, recovery.recipe)
    recovery.load_state_dict(state)
    moments = [value for optimizer in recovery.optimizers.values() for name, value in moments_of(optimizer).items()
               if name != "step"]
    assert moments and all(value.is_meta for value in moments)
    assert all(value.device.type == "cpu" for held in state["moments"].values() for value in held.values())


def test_checkpoints_are_read_to_the_memory_of_the_host(folder):
    start(folder)
    path = folder / "run" / FILE_NAME
    state = load_checkpoint(path, 2**20)
    save_checkpoint(path, state)
    recovery = Recovery(read_recipe(folder / "recipe.toml", []), ALONE)
    check_state(path, load_checkpoint(path, 2**20), recovery)
    assert all(value.device.type == "cpu" for value in state["parameters"].values())
