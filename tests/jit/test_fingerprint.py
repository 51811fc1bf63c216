"""A digest of what functions depend on: the same for the same, another for whatever changes a result.

That it is the same in all processes is in `test_code_cache.py`.
"""

import functools
import importlib
import sys
import threading
from dataclasses import dataclass
from typing import NamedTuple

import pytest
import torch

from torch_radbp.jit.dual import with_tangents
from torch_radbp.jit.store.fingerprint import DefinitionReader, Opaque, fingerprint

MODULE = """
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple
{imported}

FACTOR = {factor}
TABLE = {{"a": [1.0, {table}]}}

class Pair(NamedTuple):
    x: float
    def both(self):
        return self.x {sign} 1

@dataclass(frozen=True)
class Kind:
    number: int = 1
    @property
    def twice(self):
        return {twice} * self.number

class Special(Kind):
    def other(self):
        return [k + {inner} for k in range(3)]

@lru_cache
def remembered(x):
    return x + {remembered}

def inner(x, y={default}):
    "{words}"
    return remembered(x) * FACTOR + y + TABLE["a"][1]

def outer(x):
    from {module}_two import helped
    return Pair(inner(x)).both() + Special(2).twice + math.sin(x) + helped(x)
"""
PARTS = {"imported": "", "factor": 2.0, "table": 3.0, "sign": "+", "twice": 2, "inner": 1, "remembered": 5, "default": 0,
         "words": "Says what it does."}
HELPER = "def helped(x):\n    return x + {}\n"


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Writes the module anew, with some parts exchanged, and returns the function `outer` of it."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(helped=1, **parts):
        (tmp_path / "told.py").write_text(MODULE.format(module="told", **PARTS | parts))
        (tmp_path / "told_two.py").write_text(HELPER.format(helped))
        for name in ("told", "told_two"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        for cached in tmp_path.rglob("*.pyc"):
            cached.unlink()
        importlib.import_module("told_two")
        return importlib.import_module("told").outer

    yield write
    for name in ("told", "told_two"):
        sys.modules.pop(name, None)


def test_the_same_source_has_the_same_fingerprint(written):
    assert fingerprint(written()) == fingerprint(written())
    outer = written()
    before = fingerprint(outer)
    outer(1.0)  # what functions remember does not count
    assert fingerprint(outer) == before


@pytest.mark.parametrize("change", [{"factor": 2.5}, {"table": 3.5}, {"sign": "-"}, {"twice": 3}, {"inner": 2},
                                    {"remembered": 6}, {"default": 1}, {"helped": 2}], ids=str)
def test_whatever_a_function_may_reach_counts(written, change):
    assert fingerprint(written(**change)) != fingerprint(written())


def test_what_is_exchanged_while_the_program_runs_counts(written):
    outer = written()
    before = fingerprint(outer)
    module = sys.modules["told"]
    changes = ((module, "FACTOR", 7.0), (module, "TABLE", {"a": [0.0, 0.0]}), (module, "inner", lambda x: x),
               (module.Pair, "both", lambda pair: 0), (sys.modules["told_two"], "helped", abs))
    for owner, name, value in changes:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(owner, name, value)
            assert fingerprint(outer) != before, name
    assert fingerprint(outer) == before


def test_what_is_changed_in_place_counts(written):
    outer = written()
    before, module = fingerprint(outer), sys.modules["told"]

    def keyword_default(value):
        module.inner.__kwdefaults__ = {"z": value}

    changes = (lambda: module.TABLE["a"].append(4.0), lambda: setattr(module.inner, "__defaults__", (3,)),
               lambda: keyword_default(1), lambda: keyword_default(2),
               lambda: setattr(module.inner, "__code__", (lambda x, y: y).__code__), lambda: setattr(module.Kind, "more", 1))
    found = [before]
    for change in changes:
        change()
        found.append(fingerprint(outer))
    assert len(set(found)) == len(found)


def test_functions_and_classes_are_read_once(written, monkeypatch):
    outer, read = written(), []
    for name in ("function", "type"):
        tell = getattr(DefinitionReader, name)
        monkeypatch.setattr(DefinitionReader, name, lambda reader, thing, parts, tell=tell: read.append(thing.__name__)
                            or tell(reader, thing, parts))
    fingerprint(outer)
    assert {"outer", "inner", "Pair", "Special", "helped"} <= {*read}
    read.clear()
    fingerprint(outer)
    assert read == ["inner"]  # which reads a dict, whose contents may be others


class Point(NamedTuple):
    x: float


@dataclass(frozen=True)
class Smooth:
    alpha: float


@dataclass(frozen=True)
class Rough:
    alpha: float


def test_values_are_told_apart():
    values = [None, True, 1, 1.0, 0.0, -0.0, "1", b"1", (1,), [1], (1, 1), ((1,), 1), {"a": 1}, {"a": 2}, {1},
              frozenset({2}),
              torch.float32, torch.float64, torch.ones(2), torch.ones(3), torch.ones(2).double(), torch.zeros(2),
              Point(1.0), Point(2.0), Smooth(1.0), Smooth(2.0), Rough(1.0), Point, Smooth,
              max, min, torch.sin, torch.cos, lambda: 1, lambda: 2, functools.partial(max, 1), functools.partial(max, 2)]
    assert len({fingerprint(value) for value in values}) == len(values)
    assert fingerprint({"b", "a", "c"}) == fingerprint({"c", "b", "a"})


def test_closures_count():
    def adds(number):
        return lambda x: x + number

    assert fingerprint(adds(1)) == fingerprint(adds(1)) != fingerprint(adds(2))


def test_what_cannot_be_told_is_refused_by_name():
    with pytest.raises(Opaque, match="_thread.lock"):
        fingerprint(threading.Lock())


def scaled_by(factor):
    def scaled(x):
        return x * factor

    return scaled


def test_a_function_with_tangents_is_told_by_what_the_function_depends_on():
    assert fingerprint(with_tangents(scaled_by(2.0))) == fingerprint(with_tangents(scaled_by(2.0)))
    assert fingerprint(with_tangents(scaled_by(2.0))) != fingerprint(with_tangents(scaled_by(3.0)))
