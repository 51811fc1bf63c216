"""The functions of one bounce, as they are or compiled.

Only these are compiled, never the whole path: depth and seed are tensors and the number of lanes is dynamic, so that
bounces, chunks and iterations share one compiled function.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import pickle
import platform
import sys
import threading
import time
import types
import typing
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch
from torch.utils._pytree import tree_flatten, tree_map_only

from torch_radbp import vec
from torch_radbp.adjoint.sweep import FEW_ENTRIES, bounce_adjoint
from torch_radbp.path import PathState, bounce, sample_camera
from torch_radbp.scene.tensors import SceneTensors

# Below this many lanes a compiled function gains nothing, and one or zero lanes would compile a special case.
FEWEST_LANES = 64
MOST_SCENES = 8  # of which a stage remembers what they contain

# Products of a vector and a tensor stay in Dynamo's graph as they are: what is compiled depends on the code of the vectors.
VECTORS = {f"{kind.__module__}.{kind.__name__}": hashlib.sha256(Path(vec.__file__).read_bytes()).hexdigest()
           for kind in (vec.Vec2, vec.Vec3)}
# Indices into tables are right by construction.
INDUCTOR_OPTIONS = {"assert_indirect_indexing": False, "unsafe_marked_cacheable_functions": VECTORS}
# On the CPU, called by C++ rather than Python: that lets go of the interpreter, so that chunks really run side by side.
BESIDE_EACH_OTHER = {"cpp_wrapper": True}
# The derivative in smaller kernels: compiled in a third of the time, and as fast. A bounce itself becomes 1.4 times slower.
SMALLER_KERNELS = {"realize_reads_threshold": 2, "realize_opcount_threshold": 16}
# Derivatives are taken inside a compiled function; Python numbers are constants of the integrand, not inputs.
DYNAMO_OPTIONS = {"trace_autograd_ops": True, "specialize_float": True}


class Stages(NamedTuple):
    """The three functions that run per chunk or per bounce."""

    sample_camera: Callable
    bounce: Callable
    bounce_adjoint: Callable


EAGER = Stages(sample_camera, bounce, bounce_adjoint)


@functools.cache
def compiled() -> Stages:
    """The stages under `torch.compile`; one set for the whole process, specialised by what a scene contains."""
    return Stages(*(CompiledStage(stage) for stage in EAGER))


class CompiledStage:
    """A stage that is compiled for each special case it meets; what is compiled is kept on disk, in torch's cache.

    A case may need several functions: sizes that happen to be equal the first time are taken to be always equal.

    Says on the standard error when it compiles, which takes some ten seconds; loading what was compiled before takes one.
    """

    compiling = threading.Lock()

    def __init__(self, stage: Callable):
        self.stage = stage
        self.typed = typed(typing.get_type_hints(stage)["return"])
        self.functions: dict[tuple, list] = {}
        self.case_of = SceneCases()

    def __call__(self, *arguments):
        if lanes_of(arguments) < FEWEST_LANES:
            return self.stage(*arguments)
        case = tuple(self.case_of(argument) if isinstance(argument, SceneTensors) else special_case((argument,))
                     for argument in arguments)
        if any(torch.float64 in part for part in case):
            arguments = tree_map_only(torch.Tensor, with_an_axis, arguments)
        functions = self.functions.setdefault(case, [])
        for number in itertools.count():
            if number == len(functions):
                with self.compiling:
                    if number == len(functions):  # still: other workers compile too
                        functions.append(self.loaded(case, number) or self.compile(case, number, arguments))
            if functions[number].guard_check(*arguments):
                return self.typed(functions[number].fn(*arguments))

    def path(self, case: tuple, number: int) -> Path:
        """Where a function is kept; another torch, machine or version of this package has another."""
        about = (self.stage.__name__, case, number, code_digest(), torch.__version__, sys.version, platform.machine(),
                 torch.backends.cpu.get_cpu_capability(), torch.get_num_threads())
        from torch._inductor.codecache import cache_dir  # seconds to import, for those only who compile

        return Path(cache_dir()) / "torch_radbp" / hashlib.sha256(repr(about).encode()).hexdigest()

    def loaded(self, case: tuple, number: int):
        """The function as it was compiled before, or None."""
        try:
            with self.path(case, number).open("rb") as file:
                return torch.compiler.load_compiled_function(file)
        except (OSError, EOFError, RuntimeError, pickle.UnpicklingError):
            return None

    def compiler(self, device: str) -> Callable:
        """`torch.compile` of the stage for a type of device."""
        stage = self.stage  # what is compiled must not hold `self`, which holds what was compiled

        @functools.wraps(stage)
        def plain_stage(*arguments):
            return plain(stage(*arguments))

        options = INDUCTOR_OPTIONS | (BESIDE_EACH_OTHER if device == "cpu" else {})
        options |= SMALLER_KERNELS if stage is bounce_adjoint else {}
        return torch.compile(plain_stage, dynamic=True, fullgraph=True, options=options)

    def compile(self, case: tuple, number: int, arguments: tuple):
        print(f"torch_radbp: compiling {self.stage.__name__} ...", end="", file=sys.stderr, flush=True)
        began = time.perf_counter()
        with torch._dynamo.config.patch(DYNAMO_OPTIONS):
            device = next(leaf.device.type for leaf in tree_flatten(arguments)[0] if isinstance(leaf, torch.Tensor))
            function = self.compiler(device).aot_compile((arguments, {}))
        path = self.path(case, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        function.save_compiled_function(str(path))
        print(f" {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
        if not function.guard_check(*arguments):
            raise RuntimeError(f"the compiled {self.stage.__name__} refuses the arguments that it was compiled for; "
                               "use compile=False")
        return function


def with_an_axis(value: torch.Tensor) -> torch.Tensor:
    """`value`, but (1,) for a () number in float64, which the compiler takes for a Python number, and fails."""
    return value.reshape(1) if value.dim() == 0 and value.dtype is torch.float64 else value


@functools.cache
def code_digest() -> str:
    """Changes with every line of this package."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def plain(value):
    """`value` with plain tuples for named ones: torch keeps no compiled function on disk that makes others."""
    if isinstance(value, (tuple, list)):
        return tuple(plain(part) for part in value)
    return value


@functools.cache
def typed(kind) -> Callable:
    """The inverse of `plain`, for values of the annotated type `kind`, which may be optional."""
    arguments, origin = typing.get_args(kind), typing.get_origin(kind)
    if origin is types.UnionType:
        some = typed(arguments[0])
        return lambda value: None if value is None else some(value)
    if origin is list:
        part = typed(arguments[0])
        return lambda value: [part(item) for item in value]
    if origin is tuple or hasattr(kind, "_fields"):
        hints = arguments if origin is tuple else tuple(typing.get_type_hints(kind).values())
        make = tuple if origin is tuple else kind._make
        if all(hint is torch.Tensor for hint in hints):
            return make
        parts = tuple(typed(hint) for hint in hints)
        return lambda value: make(part(item) for part, item in zip(parts, value))
    return lambda value: value


def lanes_of(arguments: tuple) -> int:
    """The number of lanes that a stage is called with."""
    state = next((argument for argument in arguments if isinstance(argument, PathState)), None)
    return len(arguments[2] if state is None else state.lane)


def special_case(arguments: tuple) -> tuple:
    """What a stage is compiled for: all that is not a tensor, and dtypes, devices and the sizes of small tables."""
    case = []

    def add(part) -> None:
        if isinstance(part, tuple):
            for item in part:
                add(item)
        elif isinstance(part, torch.Tensor):
            case.append(part.dtype)
            case.append(part.device.type)
            case.extend([min(size, FEW_ENTRIES + 1) for size in part.shape])
        else:
            case.append(part)

    add(arguments)
    return tuple(case)


class SceneCases:
    """`special_case` of the scenes that were seen last: they are large, and the same from call to call."""

    def __init__(self):
        self.known: dict[int, tuple[SceneTensors, tuple]] = {}

    def __call__(self, scene: SceneTensors) -> tuple:
        known, case = self.known.get(id(scene), (None, ()))
        if known is not scene:
            case = special_case(scene)
            if len(self.known) > MOST_SCENES:
                self.known.clear()
            self.known[id(scene)] = scene, case
        return case
