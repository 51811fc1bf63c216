"""Compiled stages are kept on disk under names that change with every function that was run to trace them."""

import sys
from pathlib import Path
from types import CodeType, FunctionType

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import unwarned_renderer
from tests.scenes.every_plugin import subjects
from tests.scenes.everything import EVERYTHING, build_everything
from torch_radbp.jit import compiled, run
from torch_radbp.jit.fingerprint import DefinitionReader
from torch_radbp.tensors import torch_internals

PACKAGE = Path(rb.__file__).parent
pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")


def run_while(function) -> set[CodeType]:
    """The functions of this package, its compiler left out, that run while another one does."""
    met: set[CodeType] = set()

    def note(frame, event, argument):
        if event == "call":
            met.add(frame.f_code)

    sys.setprofile(note)
    try:
        function()
    finally:
        sys.setprofile(None)
    return {code for code in met if Path(code.co_filename).is_relative_to(PACKAGE)
            and PACKAGE / "jit" not in Path(code.co_filename).parents and code.co_filename != torch_internals.__file__}


def codes(code: CodeType) -> set[CodeType]:
    """A code object and those inside of it."""
    return {code}.union(*(codes(constant) for constant in code.co_consts if isinstance(constant, CodeType)))


def told(*things) -> set[CodeType]:
    """The functions that a fingerprint depends on."""
    reader = DefinitionReader()
    reader.words(things)
    for thing in reader.named:
        reader.definition(thing)
    return set().union(*(codes(thing.__code__) for thing in reader.named if isinstance(thing, FunctionType)))


@pytest.mark.parametrize("name, sampling", [("textures", "hybrid"), deep("materials", "attached"),
                                            *(deep(name, "hybrid") for name in EVERYTHING if name != "textures")])
def test_every_function_that_is_traced_belongs_to_the_name(name, sampling, fresh_stages, monkeypatch):
    named, missing, traced = [], {}, run.LaneFunction.traced
    name_of = compiled.code_name

    def watched(function, given):
        found = []
        met = run_while(lambda: found.append(traced(function, given)))
        structures = tuple(form.structure for form in given.forms)
        for code in met - told(function.function, structures):
            missing[code.co_qualname if hasattr(code, "co_qualname") else code.co_name] = code.co_filename
        return found[0]

    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off")
    monkeypatch.setattr(run.LaneFunction, "traced", watched)
    monkeypatch.setattr(compiled, "code_name", lambda *arguments: named.append(name_of(*arguments)) or named[-1])
    scene = build_everything(name, torch.float32)
    wanted = [scene.get_parameter(parameter).requires_grad_() for parameter in subjects(scene)]
    image = unwarned_renderer(scene, spp=2, max_depth=4, rr_depth=2, sampling=sampling)(seed=3)
    torch.autograd.grad(image.sum(), wanted)
    assert len(named) > 10 and None not in named and len(set(named)) == len(named)
    assert not missing
