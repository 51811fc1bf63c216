"""Runs whose files were damaged, deleted or forged, and disks that are full: one message with the file's name."""

import io
import os
import pickle
import resource
import stat
import warnings
import zipfile

import pytest
import torch
from rich.console import Console

from torch_radbp.io.image import save_image
from torch_radbp.training.recipe_file import read_recipe, write_recipe
from torch_radbp.training.recovery.checkpoint import CheckpointError, save_checkpoint
from torch_radbp.training.recovery.metrics import MetricsFile
from torch_radbp.training.recovery.optimize import Recovery
from torch_radbp.training.recovery.run_folder import RunFolder
from torch_radbp.training.run import run

pytestmark = pytest.mark.hostile


class Hostile:
    """Creates a file where it is unpickled without protection."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def saved(thing) -> bytes:
    data = io.BytesIO()
    torch.save(thing, data)
    return data.getvalue()


def zipped(**files) -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return data.getvalue()


def edited(state, place, value):
    """The state with another value at a place; a value of `del` takes it away."""
    *parents, last = place
    holder = state
    for name in parents:
        holder = holder[name]
    if value == "del":
        del holder[last]
    else:
        holder[last] = value
    return saved(state)


PAINT = "paint.reflectance.value"
NAN = torch.full((3,), float("nan"))

# Name -> (bytes of checkpoint.pt from those of a good one and the folder, what the message says beside the file's name).
FILES = {
    "empty": (lambda good, folder: b"", ["is empty", "--out"]),
    "first half": (lambda good, folder: good[:len(good) // 2], ["cut short"]),
    "without its last byte": (lambda good, folder: good[:-1], ["cut short"]),
    "text": (lambda good, folder: b"hello\n" * 100, ["no checkpoint"]),
    "zeros": (lambda good, folder: bytes(5000), ["no checkpoint"]),
    "another zip": (lambda good, folder: zipped(a="b"), ["damaged"]),
    "flipped bytes": (lambda good, folder: good[:100] + b"\xff" * 60 + good[160:], ["damaged"]),
    "pickle": (lambda good, folder: pickle.dumps({"step": 1}), ["no checkpoint"]),
    "hostile pickle": (lambda good, folder: pickle.dumps(Hostile(folder / "hacked")), ["no checkpoint"]),
    "hostile torch file": (lambda good, folder: saved({"step": Hostile(folder / "hacked")}), ["more than tensors"]),
    "legacy torch file": (lambda good, folder: legacy({"step": Hostile(folder / "hacked")}), ["no checkpoint"]),
    "a module": (lambda good, folder: saved(torch.nn.Linear(2, 2)), ["more than tensors"]),
    "a model's state": (lambda good, folder: saved(torch.nn.Linear(2, 2).state_dict()), ["holds weight, bias", "step"]),
    "a list": (lambda good, folder: saved([1, 2]), ["top level holds list"]),
    "a number": (lambda good, folder: saved(3), ["top level holds int"]),
}  # fmt: skip


def legacy(thing) -> bytes:
    data = io.BytesIO()
    torch.save(thing, data, _use_new_zipfile_serialization=False)
    return data.getvalue()


# Name -> (place in the state, value, what the message says).
STATES = {
    "no step": (["step"], "del", ["holds skipped", "instead of step"]),
    "one key more": (["code"], 1, ["code"]),
    "step a float": (["step"], 1.5, ["step is no integer"]),
    "step a boolean": (["step"], True, ["step is no integer"]),
    "step negative": (["step"], -1, ["step is -1"]),
    "step beyond the end": (["step"], 99, ["step 99 already, beyond steps = 6"]),
    "seconds NaN": (["seconds"], float("nan"), ["seconds is no finite number"]),
    "skipped text": (["skipped"], "none", ["skipped is no integer"]),
    "another parameter": (["parameters"], {"paint.alpha": torch.zeros(3)}, ["holds paint.alpha instead of " + PAINT]),
    "no parameter": (["parameters"], {}, ["parameters holds nothing"]),
    "parameter of another shape": (["parameters", PAINT], torch.zeros(4), ["(4,)", "(3,)"]),
    "parameter of another dtype": (["parameters", PAINT], torch.zeros(3).double(), ["float64", "float32"]),
    "parameter NaN": (["parameters", PAINT], NAN, [f"parameters.{PAINT} is not finite"]),
    "parameter a list": (["parameters", PAINT], [0.1, 0.2, 0.3], [PAINT, "list"]),
    "no optimiser": (["optimizer"], None, ["optimizer holds NoneType"]),
    "optimiser without groups": (["optimizer", "param_groups"], [], ["optimizer.param_groups is not a list of 1"]),
    "moment of another shape": (["optimizer", "state", 0, "exp_avg"], torch.zeros(7), ["exp_avg", "(3,)"]),
    "moment NaN": (["optimizer", "state", 0, "exp_avg"], NAN, ["exp_avg is not finite"]),
    "moment of no parameter": (["optimizer", "state", 5], {}, ["optimizer.state.5 belongs to no parameter"]),
    "learning rate text": (["optimizer", "param_groups", 0, "lr"], "fast", ["lr is no finite number"]),
    "no schedule": (["scheduler"], {}, ["scheduler holds nothing"]),
}  # fmt: skip


@pytest.fixture(scope="module")
def good_run(tmp_path_factory):
    """The files of a run of two steps, made once, and the folder that they refer to."""
    from tests.training.conftest import RECIPE, SCENE

    folder = tmp_path_factory.mktemp("good")
    generator = torch.Generator().manual_seed(1)
    save_image(folder / "picture.png", torch.rand(3, 4, 4, generator=generator))
    save_image(folder / "target.exr", torch.rand(3, 6, 8, generator=generator))
    (folder / "scene.xml").write_text(SCENE)
    (folder / "recipe.toml").write_text(RECIPE)
    run(folder / "recipe.toml", ["steps=2"], folder / "run", False, Console(quiet=True))
    recipe = read_recipe(folder / "recipe.toml")
    write_recipe(recipe, folder / "run" / "recipe.toml")
    return folder, (folder / "run" / "checkpoint.pt").read_bytes(), recipe


def resume(folder):
    return run(folder / "recipe.toml", [], folder / "run", True, Console(quiet=True))


def check_refused(folder, content, expected):
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    path = folder / "run" / "checkpoint.pt"
    path.write_bytes(content)
    with pytest.raises(CheckpointError) as caught, warnings.catch_warnings():
        warnings.simplefilter("error")
        resume(folder)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and len(message.splitlines()) == 1 and "weights_only" not in message
    for fragment in expected:
        assert fragment in message
    path.write_bytes(before[path])
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before, "nothing else is touched"
    assert not (folder / "hacked").exists()


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_is_no_checkpoint_is_named(case, good_run):
    folder, good, _ = good_run
    make, expected = FILES[case]
    check_refused(folder, make(good, folder), expected)


@pytest.mark.parametrize("case", STATES)
def test_a_checkpoint_of_another_run_is_named(case, good_run):
    folder, good, _ = good_run
    place, value, expected = STATES[case]
    check_refused(folder, edited(torch.load(io.BytesIO(good), weights_only=True), place, value), expected)


# Name -> (metrics.csv from the good text, or None to delete it, what the warning or error says).
METRICS = {
    "deleted": (lambda text: None, ["is missing", "lack those steps"]),
    "empty": (lambda text: "", ["is missing"]),
    "one step lost": (lambda text: "\n".join(text.splitlines()[:2]) + "\n", ["holds 1 of the 2 steps so far"]),
}
BAD_METRICS = {
    "no numbers": (lambda text: text + "1,2,x\n", ["line 4", "numbers"]),
    "another table": (lambda text: "name,value\na,1\n", ["line 1", "columns step and loss", "name, value"]),
    "binary": (lambda text: b"\xff\xfe\x00\n", ["binary"]),
}


@pytest.mark.parametrize("case", METRICS)
def test_lost_metrics_are_a_warning(case, folder):
    run(folder / "recipe.toml", ["steps=2", "schedule={name='constant'}"], folder / "run", False, Console(quiet=True))
    path = folder / "run" / "metrics.csv"
    change, expected = METRICS[case]
    text = change(path.read_text())
    path.unlink() if text is None else path.write_text(text)
    with pytest.warns(UserWarning, match="metrics.csv") as caught:
        summary, _ = run(folder / "recipe.toml", ["steps=3", "schedule={name='constant'}"], folder / "run", True,
                         Console(quiet=True))
    assert all(fragment in str(caught[0].message) for fragment in expected)
    assert summary["step"] == 3 and MetricsFile(path).rows()[-1]["step"] == 2


@pytest.mark.parametrize("case", BAD_METRICS)
def test_foreign_metrics_are_an_error(case, tmp_path):
    path = tmp_path / "metrics.csv"
    change, expected = BAD_METRICS[case]
    content = change("step,loss,skipped\n0,0.5,0\n1,0.25,0\n")
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError) as caught:
        MetricsFile(path).rows()
    assert str(path) in str(caught.value) and all(fragment in str(caught.value) for fragment in expected)


@pytest.mark.parametrize(("content", "expected"), [(None, "no such recipe"), ("steps = ", "not valid TOML"),
                                                  ("steps = 3\n", "is required")])
def test_a_damaged_copy_of_the_recipe_is_named(content, expected, good_run):
    folder, *_ = good_run
    copy = folder / "run" / "recipe.toml"
    good = copy.read_text()
    copy.unlink() if content is None else copy.write_text(content)
    try:
        with pytest.raises((ValueError, OSError), match=expected) as caught:
            resume(folder)
        assert str(copy) in str(caught.value)
    finally:
        copy.write_text(good)


# What a run writes, by the name of the file.
WRITERS = {
    "recipe.toml": lambda run_folder, recovery: run_folder.save_recipe(recovery.recipe),
    "checkpoint.pt": lambda run_folder, recovery: save_checkpoint(run_folder.checkpoint, recovery.state_dict()),
    "metrics.csv": lambda run_folder, recovery: run_folder.metrics.append({"step": 0, "loss": 1.0}),
    "camera_after.exr": lambda run_folder, recovery: run_folder.save_image("camera", "after", torch.zeros(3, 6, 8)),
    "paint_true.png": lambda run_folder, recovery: run_folder.save_texture("paint", "true", torch.zeros(4, 4, 3)),
    "parameters.safetensors": lambda run_folder, recovery: run_folder.save_parameters({"a": torch.zeros(3)}),
    "summary.json": lambda run_folder, recovery: run_folder.save_summary({"a": list(range(100))}),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_told_with_the_name_of_the_file(name, good_run, tmp_path):
    folder, _, recipe = good_run
    recovery, run_folder = Recovery(recipe), RunFolder(tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4, hard))  # a write beyond fails, as on a full disk
    try:
        with pytest.raises(OSError, match=f"{name}: cannot be written: ") as caught:
            WRITERS[name](run_folder, recovery)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert len(str(caught.value).splitlines()) == 1
    assert not [path for path in tmp_path.rglob(".*")], "no temporary file is left"


def test_all_files_of_a_run_can_be_read_by_whom_the_umask_lets(folder):
    before = os.umask(0o027)
    try:
        run(folder / "recipe.toml", ["steps=1"], folder / "run", False, Console(quiet=True))
    finally:
        os.umask(before)
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in (folder / "run").rglob("*") if path.is_file()}
    assert {mode for mode in modes.values()} == {0o640}, modes
