"""The fuzzer's own tests, and a short run of it with a fixed seed."""

import json
import os
import random
import shutil
import struct
import sys
import warnings
from pathlib import Path

import pytest
import torch

from tests.deep import deep
from tests.fuzz.__main__ import Tally, write_mutant
from tests.fuzz.corpus import FAMILIES, PLY, SERIALIZED, build_corpus
from tests.fuzz.judge import check_saved, judge, load_mutant, silent_change
from tests.fuzz.mutation import mutate
from tests.fuzz.worker import Worker
from tests.io.documents import TRIANGLE_OBJ, scene_dict
from tests.io.gltf_files import GltfFile
from torch_radbp.io.load import load_dict
from torch_radbp.plugin import REGISTRY
from torch_radbp.training.recovery.checkpoint import HEADER

GREY_NORMALS = "normalmap must have three channels"  # what a picture is used for depends on its bytes
CASES = 12  # of each family and part; `python -m tests.fuzz --minutes 60` is the long run
SEED = 16  # by which some of each family and part load, and some do not


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return build_corpus(tmp_path_factory.mktemp("corpus"))


@pytest.mark.parametrize("family", [deep(family) if family == "xml" else family for family in FAMILIES])
def test_every_seed_loads(corpus, family):
    for number, seed in enumerate(dict.fromkeys(corpus[family])):
        path = seed.folder / f"seed{number}{FAMILIES[family]}"
        path.write_bytes(seed.content)
        # Of scenes that are alike, large pictures, and recipes that `training/test_recipe.py` reads all of, every seventh.
        alike = path.parent.name.startswith(("camera_", "cornell_", "recipes")) or (
            family == "png" and len(seed.content) > 10_000)
        if alike and number % 7:
            continue
        verdict = judge(family, path)
        if GREY_NORMALS not in verdict.detail:
            assert verdict == ("loaded", "", "")


def test_the_scenes_have_every_plugin_that_a_file_can_name(corpus):
    text = b" ".join(seed.content for seed in corpus["xml"]).decode()
    named = {name for plugins in REGISTRY.values() for name in plugins} - {"mesh", "rgb"}  # from arrays; <rgb>
    assert not [name for name in sorted(named) if f'type="{name}"' not in text]


@pytest.mark.parametrize("part", [0, deep(1)])
@pytest.mark.parametrize("family", FAMILIES)
def test_mutants_load_or_are_refused(corpus, family, part):
    outcomes = set()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number in range(part * CASES, (part + 1) * CASES):
            path = write_mutant(corpus, family, SEED, number)
            verdict = judge(family, path)
            assert verdict.outcome != "fault", f"{family} {number}: {verdict.kind}\n{verdict.detail}"
            outcomes.add(verdict.outcome)
    assert "refused" in outcomes
    assert "loaded" in outcomes or family == "checkpoint"  # of which nearly every change is seen


def test_mutants_are_a_function_of_seed_family_and_number(corpus):
    first = [write_mutant(corpus, "xml", 3, number).read_bytes() for number in range(5)]
    assert first == [write_mutant(corpus, "xml", 3, number).read_bytes() for number in range(5)]
    assert first != [write_mutant(corpus, "xml", 4, number).read_bytes() for number in range(5)]


def test_what_a_mutation_has_broken_is_mutated_further():
    text = json.dumps({"__metadata__": {HEADER: [1, 2, 3]}}).encode()  # of which the header is a text
    broken = struct.pack("<Q", len(text)) + text
    mutants = {mutate("checkpoint", random.Random(seed), broken, [broken]) for seed in range(20)}
    assert len(mutants) > 10 and broken not in mutants


@pytest.mark.parametrize("fault, kind", [
    (KeyError("x"), "KeyError at "),
    (ValueError("no name"), "ValueError that does not name the file"),
    (ValueError("mesh.obj: " + "x" * 9000), "ValueError of 9000 characters"),
    (MemoryError(), "MemoryError at "),
])
def test_undocumented_errors_are_faults(monkeypatch, tmp_path, fault, kind):
    def raise_fault(*_, **__):
        raise fault

    monkeypatch.setattr("tests.fuzz.judge.load_mutant", raise_fault)
    verdict = judge("obj", tmp_path / "mesh.obj")
    assert verdict.outcome == "fault" and verdict.kind.startswith(kind)


@pytest.mark.parametrize("value, kind", [(torch.nan, "pixels that are not finite"), (-1.0, "pixels below 0")])
def test_senseless_pixels_are_faults(monkeypatch, tmp_path, value, kind):
    (tmp_path / "mesh.obj").write_text(TRIANGLE_OBJ)
    monkeypatch.setattr("tests.fuzz.judge.render_small", lambda scene: torch.full((1, 3, 4, 4), value))
    assert judge("obj", tmp_path / "mesh.obj")[:2] == ("fault", kind)


@pytest.mark.parametrize("family, content", [
    ("obj", TRIANGLE_OBJ.encode()), ("ply", PLY), ("serialized", SERIALIZED[0]), ("gltf", None), ("glb", None)])
def test_a_silent_change_is_a_fault(monkeypatch, tmp_path, family, content):
    """Of every family: a scene that has twice the triangles, or corners elsewhere."""
    path = tmp_path / f"a.{family}"
    if content is None:
        file = GltfFile()
        file.node(file.square())
        file.save(path)
    else:
        path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert silent_change(family, path, load_mutant(family, path), told=False) == ""
        moved, fewer = load_mutant(family, path), load_mutant(family, path)
    moved_mesh, mesh = (next(shape for shape in scene.shapes if hasattr(shape, "faces")) for scene in (moved, fewer))
    moved_mesh.vertex_positions.data[mesh.faces[0, 0]] += 0.001
    mesh.faces = mesh.faces.repeat(2, 1)
    for scene, found in ((moved, "positions differ"), (fewer, "in the file, ")):
        monkeypatch.setattr("tests.fuzz.judge.load_mutant", lambda *_, scene=scene, **__: scene)
        verdict = judge(family, path)
        assert verdict[:2] == ("fault", "silent change") and found in verdict.detail


def test_what_is_left_out_without_a_word_is_a_fault(monkeypatch, tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(TRIANGLE_OBJ + "f 1 2\n")
    assert judge("obj", path).outcome == "loaded"
    monkeypatch.setattr("torch_radbp.formats.leniency.warnings.warn", lambda *_, **__: None)
    assert "loads without a warning, but not strictly" in judge("obj", path).detail


def test_a_scene_that_is_saved_wrongly_is_a_fault(monkeypatch):
    scene = load_dict(scene_dict(ball={"type": "sphere"}))
    check_saved(scene)
    other = load_dict(scene_dict(ball={"type": "sphere", "bsdf": {"type": "dielectric"}}))
    monkeypatch.setattr("tests.fuzz.judge.rb.load", lambda path: other)
    with pytest.raises(AssertionError, match=r"what was saved has other parameters: \['ball.bsdf"):
        check_saved(scene)


@pytest.mark.parametrize("program, kind", [
    ("import os; input(); os.abort()", "process ended by SIGABRT"),
    ("input(); import ctypes; ctypes.string_at(0)", "process ended by SIGSEGV"),
    ("input(); raise SystemExit(3)", "process ended by exit code 3"),
    ("input(); import time; time.sleep(60)", "hangs for 0.2 s"),
    ("import signal; signal.setitimer(signal.ITIMER_PROF, 0.05)\nwhile True: pass", "process ended by SIGPROF: more than"),
])
def test_crashes_and_hangs_are_faults_and_the_next_mutant_is_judged(program, kind):
    worker = Worker([sys.executable, "-c", program], wall_seconds=0.2 if "sleep" in program else 60)
    for _ in range(2):
        verdict = worker.judge("obj", Path("x"))
        assert verdict[0] == "fault" and verdict[1].startswith(kind)
    worker.close()


def test_faults_are_saved_and_summed_up(tmp_path):
    (tmp_path / "mutant.obj").write_text("x")
    tally = Tally(tmp_path / "faults")
    for number in range(5):
        tally.add("obj", number, 0, tmp_path / "mutant.obj", ["fault", "KeyError at a.py:3", "trace"])
    tally.add("obj", 5, 0, tmp_path / "mutant.obj", ["refused", "SceneError", "message"])
    assert sorted(os.listdir(tmp_path / "faults")) == [f"obj_0_{n}.{end}" for n in range(3) for end in ("obj", "txt")]
    for line in ("obj: 6 cases", "1 refused SceneError", "5 faults of 1 kinds", "5 obj: KeyError at a.py:3"):
        assert line in str(tally)
    shutil.rmtree(tmp_path / "faults")
