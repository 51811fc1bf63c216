"""Compiled code outlives its process: it is found again, damaged or not, and whatever the disk does."""

import os
import shutil
import stat
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch

from tests.jit.programs import arguments, mixed
from torch_radbp.jit import LaneFunction, run
from torch_radbp.jit.store import code_cache

ROOT = Path(__file__).parents[2]
RENDER = """
import copy, sys, warnings
warnings.simplefilter("error")
import torch
import torch_radbp as rb
import torch_radbp.public
from torch_radbp.jit.store.fingerprint import fingerprint
from torch_radbp.tensors.stage import DECLARED
from torch_radbp.tensors.vec import Vec3
early = [fingerprint(stage) for stage in DECLARED] if "early" in sys.argv else None
copy.copy(Vec3(1, 2, 3))  # leaves something in the class
from torch_radbp.jit.cpu import machine; from torch_radbp.jit import run
traced = []
trace = run.traced_program
run.traced_program = lambda function, *rest: traced.append(1) or trace(function, *rest)
emit = machine.object_code
machine.object_code = lambda text, **how: traced.append("machine code") or emit(text, **how)
scene = rb.load(r"{root}/assets/cornell_box/scene.xml", resolution=8)
value = scene.get_parameter("green.reflectance.value").requires_grad_()
image = rb.Renderer(scene, spp=2, max_depth=4)(seed=3)
image.square().sum().backward()
stages = early or [fingerprint(stage) for stage in DECLARED]
print(len(traced), float(image.detach().double().sum()).hex(), float(value.grad.double().sum()).hex(), len(stages),
      fingerprint(stages))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where code is kept during the test."""
    place = tmp_path / "kept"
    monkeypatch.setenv("RADBP_KERNEL_CACHE", str(place))
    return place


def entries(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.code"))


def call():
    """What a new function of lanes returns, and whether it was traced for that."""
    traced = []
    with pytest.MonkeyPatch.context() as patch:
        trace = run.traced_program
        patch.setattr(run, "traced_program", lambda *arguments: traced.append(1) or trace(*arguments))
        return LaneFunction(mixed, tables=("colours",))(*arguments(100)), bool(traced)


def as_it_is(x):
    return x


def assert_right(found) -> None:
    for value, expected in zip(leaves(found), leaves(mixed(*arguments(100)))):
        torch.testing.assert_close(value, expected)


def leaves(results) -> list[torch.Tensor]:
    return [leaf for part in results for leaf in (part if isinstance(part, (tuple, list)) else [part])
            if isinstance(leaf, torch.Tensor)]


def rendered(folder, *when: str, hashes: str = "random") -> list[str]:
    """What another process prints: how much it traced and compiled; sums of an image and a gradient; fingerprints of stages.

    Args:
        folder: for kernels.
        when: "early" for fingerprints that are taken before anything is rendered.
        hashes: the seed of Python's.
    """
    done = subprocess.run([sys.executable, "-c", RENDER.format(root=ROOT), *when], capture_output=True, text=True, cwd=ROOT,
                          env={**os.environ, "RADBP_KERNEL_CACHE": str(folder), "PYTHONHASHSEED": hashes})
    assert done.returncode == 0 and not done.stderr, done.stderr
    return done.stdout.split()


def test_two_processes_that_write_at_once_leave_a_third_nothing_to_compile_and_all_render_the_same(tmp_path):
    """All stages have the same fingerprints in all of them, whatever was run before, and whatever Python's hashes are."""
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(rendered, [tmp_path / "kept"] * 2))
    last = rendered(tmp_path / "kept", "early", hashes="1")
    assert max(int(one[0]) for one in found) > 10 and last[0] == "0"
    assert found[0][1:3] == found[1][1:3] == last[1:3]
    assert found[0][3:] == found[1][3:] == last[3:] and int(last[3]) > 50
    assert not list((tmp_path / "kept").glob("*.part"))


@pytest.mark.deep  # what was compiled is rendered above, too
def test_a_process_that_keeps_nothing_renders_the_same(tmp_path):
    found, alone = rendered(tmp_path / "kept"), rendered("off")
    assert int(alone[0]) > 10 and found[1:] == alone[1:]


def test_a_function_is_read_from_disk(folder):
    found, traced = call()
    assert traced and len(entries(folder)) == 1
    assert_right(found)
    again, traced = call()
    assert not traced
    assert_right(again)


def test_a_function_that_computes_nothing_is_read_from_disk(folder, monkeypatch):
    x, traced, trace = torch.rand(5), [], run.traced_program
    monkeypatch.setattr(run, "traced_program", lambda *arguments: traced.append(1) or trace(*arguments))
    assert all(LaneFunction(as_it_is)(x) is x for _ in range(2)) and len(traced) == 1


@pytest.mark.parametrize("damage", [
    lambda code: b"", lambda code: code[:-1], lambda code: code[:20], lambda code: code[:-1] + bytes([code[-1] ^ 1]),
    lambda code: b"something else", lambda code: code + b"x"], ids=["empty", "cut", "head", "a bit", "foreign", "longer"])
def test_a_damaged_file_is_made_anew(folder, damage, recwarn):
    call()
    path, = entries(folder)
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    found, traced = call()
    assert traced and path.read_bytes() == whole and not recwarn.list
    assert_right(found)


def test_an_entry_under_the_name_of_another_is_not_taken(folder):
    call()
    mine, = entries(folder)
    LaneFunction(lambda x: x + 1)(torch.ones(5))
    other, = set(entries(folder)) - {mine}
    shutil.copy(other, mine)
    found, traced = call()
    assert traced
    assert_right(found)


@pytest.mark.parametrize("owner, name", [(os, "replace"), (tempfile, "mkstemp")], ids=["full", "read-only"])
def test_a_disk_that_takes_nothing_is_left_as_it_is(folder, monkeypatch, recwarn, owner, name):
    def refused(*arguments, **settings):
        raise OSError("No space left on device, or read-only file system")

    monkeypatch.setattr(owner, name, refused)
    found, _ = call()
    assert_right(found)
    assert not list(folder.iterdir()) and not recwarn.list


def test_where_no_folder_can_be_made_code_is_compiled_each_time(folder, monkeypatch, recwarn):
    folder.write_text("a file")
    for _ in range(2):
        found, traced = call()
        assert traced
        assert_right(found)
    assert not recwarn.list


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="POSIX only")
def test_code_that_others_may_write_is_not_run(folder):
    call()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    folder.chmod(0o777)
    code_cache.belongs_to_user.cache_clear()
    _, traced = call()
    assert traced


def test_off_keeps_nothing(monkeypatch, tmp_path):
    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off")
    monkeypatch.chdir(tmp_path)
    call()
    _, traced = call()
    assert traced and not list(tmp_path.iterdir()) and code_cache.clear() == (0, 0)


def test_what_was_not_used_for_longest_goes_first(folder, monkeypatch):
    for k in range(8):
        code_cache.write_code(f"{k}", os.urandom(1000))
        os.utime(folder / f"{k}.code", (k, k))
    assert code_cache.read_code("0") is not None  # used now
    monkeypatch.setattr(code_cache, "LIMIT", 5000)
    code_cache.make_room.cache_clear()
    code_cache.make_room(folder)
    assert sorted(path.stem for path in entries(folder)) == ["0", "6", "7"]
    assert code_cache.clear()[0] == 3 and not entries(folder)


def test_machine_code_is_told_by_its_text_and_by_the_architecture(folder):
    for text, architecture, code in (("a", "sm_80", b"1"), ("a", "sm_90", b"2"), ("b", "sm_90", b"3")):
        assert code_cache.machine_code(text, architecture, lambda text, code=code: code) == code
    assert code_cache.machine_code("b", "sm_90", lambda text: b"other") == b"3"
    assert len(entries(folder)) == 3


@pytest.mark.parametrize("platform, variable, place", [
    ("linux", "XDG_CACHE_HOME", "torch_radbp/kernels"), ("win32", "LOCALAPPDATA", "torch_radbp/kernels")])
def test_the_folder_is_that_of_the_platform(monkeypatch, tmp_path, platform, variable, place):
    monkeypatch.delenv("RADBP_KERNEL_CACHE")
    monkeypatch.setenv(variable, str(tmp_path))
    monkeypatch.setattr(sys, "platform", platform)
    assert code_cache.folder() == tmp_path / place
