"""Compiled stages are kept on disk under names that change with every function that was run to trace them."""

import sys
from importlib import import_module
from pathlib import Path
from types import CodeType, FunctionType

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import unwarned_renderer
from tests.rendering.recorded import recording, stages_of_the_package
from tests.scenes.every_plugin import subjects
from tests.scenes.everything import EVERYTHING, build_everything
from torch_radbp.jit.arguments import Arguments
from torch_radbp.jit.compiled import code_name
from torch_radbp.jit.stages import CompiledStages
from torch_radbp.jit.store.fingerprint import definitions_reached
from torch_radbp.jit.target import target_of
from torch_radbp.tensors import torch_internals

PACKAGE = Path(rb.__file__).parent
pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")


def run_while(function) -> set[CodeType]:
    """The functions of this package, its compiler left out, that run while another one does."""
    met: set[CodeType] = set()

    def note(frame, event, argument):  # of calls alone: it returns nothing that asks for more
        met.add(frame.f_code)

    before = sys.gettrace()
    sys.settrace(note)
    try:
        function()
    finally:
        sys.settrace(before)
    return {code for code in met if Path(code.co_filename).is_relative_to(PACKAGE)
            and not {PACKAGE / "jit", PACKAGE / "threads"} & {*Path(code.co_filename).parents}
            and code.co_filename != torch_internals.__file__}


def codes(code: CodeType) -> set[CodeType]:
    """A code object and those inside of it."""
    return {code}.union(*(codes(constant) for constant in code.co_consts if isinstance(constant, CodeType)))


def told(*things) -> set[CodeType]:
    """The functions that a fingerprint depends on."""
    _, named = definitions_reached(*things)
    return set().union(*(codes(thing.__code__) for thing in named if isinstance(thing, FunctionType)))


@pytest.mark.parametrize("name, sampling, every", [("textures", "hybrid", 4), deep("materials", "attached", 1),
                                                   *(deep(name, "hybrid", 1) for name in EVERYTHING)])
def test_every_function_that_is_traced_belongs_to_the_name(name, sampling, every, monkeypatch):
    """Of the arguments with which a rendering calls stages; it runs them in plain torch, for nothing has to be compiled.

    Of those of a stage each so many, `every`.
    """
    stages, calls = recording()
    monkeypatch.setattr(import_module("torch_radbp.rendering.renderer"), "EAGER", stages)
    scene = build_everything(name, torch.float32)
    wanted = [scene.get_parameter(parameter).requires_grad_() for parameter in subjects(scene)]
    image = unwarned_renderer(scene, spp=2, max_depth=4, rr_depth=2, sampling=sampling, compile=False)(seed=3)
    torch.autograd.grad(image.sum(), wanted)

    named, missing, compiled = [], {}, CompiledStages()
    for stage in (stage for stage in stages_of_the_package() if calls[stage.__name__]):
        function = compiled(stage).fused
        for arguments in [*calls[stage.__name__].values()][::every]:
            given = Arguments(function.parameters, arguments)
            named.append(code_name(function.function, function.tables, given, target_of(given.device)))
            met = run_while(lambda: function.traced(given))  # noqa: B023
            structures = tuple(form.structure for form in given.forms)
            for code in met - told(function.function, structures):
                missing[code.co_qualname if hasattr(code, "co_qualname") else code.co_name] = code.co_filename
    assert len(named) > 10 and None not in named and len(set(named)) == len(named)
    assert not missing
