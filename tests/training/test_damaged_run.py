"""Runs whose files were damaged, deleted or forged, and disks that are full: one message with the file's name."""

import copy
import io
import json
import math
import os
import pickle
import resource
import shutil
import signal
import stat
import warnings
import zipfile

import pytest
import safetensors.torch
import torch
from rich.console import Console

from tests.training.conftest import write_files
from torch_radbp.formats.image import save_image
from torch_radbp.training.recipe_file import read_recipe, write_recipe
from torch_radbp.training.recovery.checkpoint import FILE_NAME, CheckpointError, load_checkpoint, save_checkpoint
from torch_radbp.training.recovery.continuation import check_state, state_bytes
from torch_radbp.training.recovery.folder_lock import FolderInUseError, FolderLock
from torch_radbp.training.recovery.metrics import MetricsFile
from torch_radbp.training.recovery.problem import Recovery
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
    state = copy.deepcopy(state)
    *parents, last = place
    holder = state
    for name in parents:
        holder = holder[name]
    if isinstance(value, str) and value == "del":
        del holder[last]
    else:
        holder[last] = value
    return state


def tensors(header=None, **named) -> bytes:
    return safetensors.torch.save(named, header)


def claims(shape, end) -> bytes:
    """A file whose header claims a tensor of a shape up to an offset, and that ends with the header."""
    header = json.dumps({"parameters/" + PAINT: {"dtype": "F32", "shape": shape, "data_offsets": [0, end]}}).encode()
    return len(header).to_bytes(8, "little") + header


PAINT = "paint.reflectance.value"
NAN = torch.full((3,), float("nan"))
ONE = torch.zeros(3)

# Name -> (bytes of the checkpoint from those of a good one and the folder, what the message says beside the file's name).
FILES = {
    "empty": (lambda good, folder: b"", ["is empty", "--out"]),
    "first half": (lambda good, folder: good[:len(good) // 2], ["cut short"]),
    "without its last byte": (lambda good, folder: good[:-1], ["cut short"]),
    "a byte more": (lambda good, folder: good + b"\0", ["cut short"]),
    "text": (lambda good, folder: b"hello\n" * 100, ["no checkpoint"]),
    "zeros": (lambda good, folder: bytes(5000), ["no checkpoint"]),
    "a zip": (lambda good, folder: zipped(a="b"), ["no checkpoint"]),
    "flipped bytes": (lambda good, folder: good[:100] + b"\xff" * 60 + good[160:], ["damaged"]),
    "hostile pickle": (lambda good, folder: pickle.dumps(Hostile(folder / "hacked")), ["no checkpoint"]),
    "hostile torch file": (lambda good, folder: saved({"step": Hostile(folder / "hacked")}), ["no checkpoint"]),
    "a header of 2^60 bytes": (lambda good, folder: (2**60).to_bytes(8, "little") + good[8:], ["no checkpoint"]),
    "a tensor of 4 GB in 100 bytes": (lambda good, folder: claims([2**30], 2**32), ["no checkpoint"]),
    "a shape that overflows": (lambda good, folder: claims([2**40, 2**40], 16), ["no checkpoint"]),
    "a shape beyond its bytes": (lambda good, folder: claims([2**20], 0), ["no checkpoint"]),
    "twenty megabytes": (lambda good, folder: good + bytes(20 * 2**20), ["at most", "was not read"]),
    "sparse moments": (lambda good, folder: saved({"moments": {PAINT: ONE.to_sparse()}}), ["no checkpoint"]),
    "moments on no device": (lambda good, folder: saved({"moments": {PAINT: ONE.to("meta")}}), ["no checkpoint"]),
    "a numpy file": (lambda good, folder: b"\x93NUMPY\x01\x00" + bytes(200), ["no checkpoint"]),
    "a state of numbers": (lambda good, folder: tensors({"state": "3"}), ["no state of a run"]),
    "a state of nothing": (lambda good, folder: tensors({"state": "null"}), ["no state of a run"]),
    "moments as text": (lambda good, folder: tensors({"state": '{"moments": "abc", "step": 2}'}), ["skipped is missing"]),
    "a model's state": (lambda good, folder: tensors(weight=torch.zeros(2, 2)), ["holds tensors, but no state of a run"]),
    "a state that is no JSON": (lambda good, folder: tensors({"state": "{"}), ["no state of a run"]),
    "a state without end": (lambda good, folder: tensors({"state": "[" * 9000}), ["no state of a run"]),
    "a list": (lambda good, folder: tensors({"state": "[1, 2]"}), ["no state of a run"]),
    "a foreign tensor": (lambda good, folder: tensors({"state": "{}"}, bias=ONE), ["tensor 'bias' belongs to no"]),
    "an empty state": (lambda good, folder: tensors({"state": "{}"}), ["step is missing"]),
}  # fmt: skip

MOMENT = ["moments", PAINT]
# Name -> (place in the state, value, what the message says).
STATES = {
    "no step": (["step"], "del", ["step is missing"]),
    "one key more": (["code"], 1, ["'code' is no field of a checkpoint", "step, skipped"]),
    "step a float": (["step"], 1.5, ["step is 1.5 instead of a whole number"]),
    "step a boolean": (["step"], True, ["step is True instead of a whole number"]),
    "step negative": (["step"], -1, ["step is -1 instead of a whole number, at least 0"]),
    "step beyond the end": (["step"], 99, ["step 99 already, beyond steps = 6"]),
    "step of another length": (["step"], 3, [f"moments.{PAINT}.step is 2 after 3 steps"]),
    "steps before the first": (["step"], 0, [f"moments.{PAINT} is there, but moments has nothing"]),
    "seconds NaN": (["seconds"], float("nan"), ["seconds is nan instead of a number"]),
    "seconds negative": (["seconds"], -1.0, ["seconds is -1.0"]),
    "seconds without end": (["seconds"], math.inf, ["seconds is inf"]),
    "skipped text": (["skipped"], "none", ["skipped is 'none'"]),
    "more skipped than taken": (["skipped"], 3, ["skipped is 3, more than the 2 steps so far"]),
    "some skipped": (["skipped"], 1, [f"moments.{PAINT}.step is 2 after 1 steps that were not skipped"]),
    "no processes": (["processes"], 0, ["processes is 0 instead of a whole number, at least 1"]),
    "processes huge text": (["processes"], "x" * 9999, ["processes is 'xxx", "..."]),
    "another parameter": (["parameters"], {"paint.alpha": ONE}, [f"parameters.{PAINT} is missing"]),
    "one parameter more": (["parameters", "paint.alpha"], ONE, ["paint.alpha is there, but parameters has " + PAINT]),
    "no parameter": (["parameters"], {}, [f"parameters.{PAINT} is missing"]),
    "parameter of another shape": (["parameters", PAINT], torch.zeros(4), ["(4,) float32 instead of (3,) float32"]),
    "parameter of another dtype": (["parameters", PAINT], ONE.double(), ["(3,) float64 instead of (3,) float32"]),
    "parameter of booleans": (["parameters", PAINT], ONE.bool(), ["(3,) bool instead of (3,) float32"]),
    "parameter of half precision": (["parameters", PAINT], ONE.bfloat16(), ["(3,) bfloat16 instead of (3,) float32"]),
    "parameter NaN": (["parameters", PAINT], NAN, [f"parameters.{PAINT} is not finite"]),
    "parameter out of bounds": (["parameters", PAINT], ONE + 1.5, [f"parameters.{PAINT} is 1.5, out of the bounds [0, 1]"]),
    "no moments": (["moments"], {}, [f"moments.{PAINT} is missing"]),
    "no exp_avg_sq": ([*MOMENT, "exp_avg_sq"], "del", [f"moments.{PAINT}.exp_avg_sq is missing"]),
    "no counter": ([*MOMENT, "step"], "del", [f"moments.{PAINT}.step is missing"]),
    "moment of another optimiser": ([*MOMENT, "square_avg"], ONE, ["square_avg is there, but", "exp_avg, exp_avg_sq"]),
    "moment of another shape": ([*MOMENT, "exp_avg"], torch.zeros(7), ["exp_avg is (7,) float32 instead of (3,) float32"]),
    "moment of another dtype": ([*MOMENT, "exp_avg"], ONE.half(), ["exp_avg is (3,) float16"]),
    "moment NaN": ([*MOMENT, "exp_avg"], NAN, ["exp_avg is not finite"]),
    "square negative": ([*MOMENT, "exp_avg_sq"], ONE - 1, ["exp_avg_sq is -1, and a mean of squares is at least 0"]),
    "counter negative": ([*MOMENT, "step"], torch.tensor(-2.0), ["step is -2 after 2 steps"]),
    "counter a vector": ([*MOMENT, "step"], ONE, ["step is (3,) float32 instead of () float32"]),
    "counter of 1e300": ([*MOMENT, "step"], torch.tensor(1e300), [f"moments.{PAINT}.step is not finite"]),
    "counter infinite": ([*MOMENT, "step"], torch.tensor(math.inf), [f"moments.{PAINT}.step is not finite"]),
    "step text": (["step"], "2", ["step is '2' instead of a whole number"]),
    "step none": (["step"], None, ["step is None instead of a whole number"]),
    "step of 400 digits": (["step"], 10**400, ["step"]),
    "skipped negative": (["skipped"], -1, ["skipped is -1"]),
    "processes a fraction": (["processes"], 1.5, ["processes is 1.5"]),
    "a final factor of 1e300": (["recipe", "schedule.final"], 1e300, ["schedule.final was 1e+300 and is 0.0"]),
    "moment of no parameter": (["moments", "lamp"], {"exp_avg": ONE}, ["moments.lamp is there"]),
    "another learning rate": (["recipe", "optimizer.learning_rate"], 0.1, ["optimizer.learning_rate was 0.1 and is 0.05"]),
    "a learning rate in words": (["recipe", "optimizer.learning_rate"], "fast", ["learning_rate was 'fast' and is 0.05"]),
    "another optimiser": (["recipe", "optimizer.name"], "sgd", ["optimizer.name was 'sgd' and is 'adam'"]),
    "other betas": (["recipe", "optimizer.betas"], [0.5, 0.9], ["optimizer.betas was [0.5, 0.9] and is [0.9, 0.999]"]),
    "other bounds": (["recipe", "parameters[0].bounds"], [0, 2], ["parameters[0].bounds was [0, 2] and is [0.0, 1.0]"]),
    "no bounds": (["recipe", "parameters[0].bounds"], "del", ["parameters[0].bounds was not set and is [0.0, 1.0]"]),
    "another loss": (["recipe", "loss[0].name"], "l1", ["loss[0].name was 'l1' and is 'two_buffer_l2'"]),
    "another schedule": (["recipe", "schedule.final"], 0.5, ["schedule.final was 0.5 and is 0.0"]),
    "a key more": (["recipe", "render.magic"], 1, ["render.magic was 1 and is not set"]),
    "recipe a list": (["recipe"], [1], ["recipe is no table"]),
    "sources text": (["sources"], "none", ["sources is no table"]),
    "another target": (["sources", "target.exr"], "0" * 64, ["the file target.exr has changed", "was 000000000000 and is"]),
    "a digest of no text": (["sources", "target.exr"], 3, ["the file target.exr has changed", "was 3 and is"]),
    "one file less": (["sources", "picture.png"], "del", ["picture.png was not read when the run began and is read now"]),
    "one file more": (["sources", "a.ply"], "00", ["the file a.ply was read when the run began and is not read now"]),
}  # fmt: skip


@pytest.fixture(scope="module")
def good_run(tmp_path_factory):
    """The files of a run of two steps, made once, and the folder that they refer to."""
    folder = write_files(tmp_path_factory.mktemp("good"))
    run(folder / "recipe.toml", ["steps=2"], folder / "run", False, Console(quiet=True))
    recipe = read_recipe(folder / "recipe.toml")
    write_recipe(recipe, folder / "run" / "recipe.toml")
    return folder, (folder / "run" / FILE_NAME).read_bytes(), recipe


def resume(folder):
    return run(folder / "recipe.toml", [], folder / "run", True, Console(quiet=True))


def check_refused(folder, content, expected):
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    path = folder / "run" / FILE_NAME
    path.write_bytes(content)
    with pytest.raises(CheckpointError) as caught, warnings.catch_warnings():
        warnings.simplefilter("error")
        resume(folder)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and len(message.splitlines()) == 1
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


@pytest.fixture(scope="module")
def checked(good_run):
    """Returns a function that checks a state as `--resume` does, and the state of the good run."""
    folder, _, recipe = good_run
    path, recovery = folder / "run" / FILE_NAME, Recovery(recipe)

    def check(state):
        check_state(path, state, recovery)

    return check, load_checkpoint(path, state_bytes(recovery))


def test_the_state_of_the_run_is_taken(checked):
    check, state = checked
    check(state)


@pytest.mark.parametrize("case", STATES)
def test_a_state_of_another_run_is_named(case, checked):
    check, state = checked
    place, value, expected = STATES[case]
    with pytest.raises(CheckpointError) as caught:
        check(edited(state, place, value))
    message = str(caught.value)
    assert FILE_NAME in message and len(message.splitlines()) == 1 and len(message) < 1000
    assert "--out" in message or "beyond steps" in message
    for fragment in expected:
        assert fragment in message


def test_nothing_of_a_refused_state_is_taken(good_run, checked):
    folder, *_ = good_run
    path = folder / "run" / FILE_NAME
    good = path.read_bytes()
    save_checkpoint(path, edited(checked[1], [*MOMENT, "exp_avg_sq"], "del"))
    check_refused(folder, path.read_bytes(), ["exp_avg_sq is missing"])
    path.write_bytes(good)


CHANGES = {
    "target.exr": lambda path: save_image(path, torch.zeros(3, 6, 8)),
    "picture.png": lambda path: save_image(path, torch.zeros(3, 4, 4)),
    "scene.xml": lambda path: path.write_text(path.read_text().replace('value="6"/></emitter>', 'value="7"/></emitter>')),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_file_that_has_changed_since_is_named(name, good_run):
    folder, good, _ = good_run
    content = (folder / name).read_bytes()
    CHANGES[name](folder / name)
    try:
        check_refused(folder, good, [f"the file {name} has changed since the run began", "SHA-256 was", "put the former"])
    finally:
        (folder / name).write_bytes(content)


def test_a_folder_in_use_is_refused_with_the_name_of_the_process(good_run):
    folder, good, _ = good_run
    lock = FolderLock(folder / "run")
    lock.acquire()
    try:
        with pytest.raises(FolderInUseError) as caught:
            resume(folder)
        message = str(caught.value)
        assert message.startswith(f"{folder / 'run'} is in use by process {os.getpid()} on ")
        assert message.endswith("; wait for its end, stop it, or choose another --out")
        assert (folder / "run" / FILE_NAME).read_bytes() == good
    finally:
        lock.release()
    assert not (folder / "run" / "run.lock").exists()


def test_a_killed_process_leaves_no_lock(tmp_path):
    process = os.fork()
    if process == 0:
        FolderLock(tmp_path).acquire()
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(process, 0)
    assert (tmp_path / "run.lock").exists()
    lock = FolderLock(tmp_path)
    lock.acquire()
    assert (tmp_path / "run.lock").read_text().startswith(f"process {os.getpid()} on ")
    lock.release()


def test_a_run_that_ends_gives_its_folder_back(good_run):
    folder, *_ = good_run
    assert not (folder / "run" / "run.lock").exists()


# Name -> (metrics.csv from the good text, or None to delete it, what the warning or error says).
METRICS = {
    "deleted": (lambda text: None, ["is missing", "lack those steps"]),
    "empty": (lambda text: "", ["is missing"]),
    "rows twice": (lambda text: text + text.splitlines()[-1] + "\n", ["held 1 rows of steps that it had already"]),
    "one step lost": (lambda text: "\n".join(text.splitlines()[:2]) + "\n", ["holds 1 of the 2 steps so far"]),
}
BAD_METRICS = {
    "no numbers": (lambda text: text + "1,2,x\n", ["line 4", "numbers"]),
    "another table": (lambda text: "name,value\na,1\n", ["line 1", "columns step and loss", "name, value"]),
    "binary": (lambda text: b"\xff\xfe\x00\n", ["binary"]),
}


@pytest.fixture(scope="module")
def two_steps(tmp_path_factory):
    """A folder with a recipe and a run of two steps of it, to which steps can be added."""
    folder = write_files(tmp_path_factory.mktemp("two"))
    run(folder / "recipe.toml", ["steps=2", "schedule={name='constant'}"], folder / "run", False, Console(quiet=True))
    return folder


@pytest.mark.parametrize("case", METRICS)
def test_lost_metrics_are_a_warning(case, two_steps, tmp_path):
    folder = shutil.copytree(two_steps, tmp_path / "copy")
    path = folder / "run" / "metrics.csv"
    change, expected = METRICS[case]
    text = change(path.read_text())
    path.unlink() if text is None else path.write_text(text)
    with pytest.warns(UserWarning, match="metrics.csv") as caught:
        summary, _ = run(folder / "recipe.toml", ["steps=3", "schedule={name='constant'}"], folder / "run", True,
                         Console(quiet=True))
    assert all(fragment in str(caught[0].message) for fragment in expected)
    steps = [row["step"] for row in MetricsFile(path).rows()]
    assert summary["step"] == 3 and steps[-1] == 2 and len({*steps}) == len(steps)


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
    FILE_NAME: lambda run_folder, recovery: save_checkpoint(run_folder.checkpoint, recovery.state_dict()),
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
