"""The functions of one bounce, as they are or compiled.

Only these are compiled, never the whole path: depth and seed are tensors and the number of lanes is dynamic, so that
bounces, chunks and iterations share one compiled function.
"""

from __future__ import annotations

import functools
import hashlib
import sys
import time
import typing
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch
from torch.utils._pytree import tree_flatten

from torch_radbp import vec
from torch_radbp.adjoint.sweep import bounce_adjoint
from torch_radbp.path import PathState, bounce, sample_camera

# Below this many lanes a compiled function gains nothing, and one or zero lanes would compile a special case.
FEWEST_LANES = 64

# Indices into tables are right by construction.
# Products of a vector and a tensor stay in Dynamo's graph as they are: what is compiled depends on the code of the vectors.
VECTORS = {f"{kind.__module__}.{kind.__name__}": hashlib.sha256(Path(vec.__file__).read_bytes()).hexdigest()
           for kind in (vec.Vec2, vec.Vec3)}
INDUCTOR_OPTIONS = {"assert_indirect_indexing": False, "unsafe_marked_cacheable_functions": VECTORS}
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
    """A stage under `torch.compile`, which says so when it has to compile a special case that it has not met."""

    def __init__(self, stage: Callable):
        self.stage = stage
        self.returns = typing.get_type_hints(stage)["return"]

        @functools.wraps(stage)
        def plain_stage(*arguments):
            return plain(stage(*arguments))

        self.compiled = torch.compile(plain_stage, dynamic=True, fullgraph=True, options=INDUCTOR_OPTIONS)
        self.met: set = set()

    def __call__(self, *arguments):
        if lanes_of(arguments) < FEWEST_LANES:
            return self.stage(*arguments)
        with torch._dynamo.config.patch(DYNAMO_OPTIONS):
            case = special_case(arguments)
            if case in self.met:
                return self.fast(*arguments)
            print(f"torch_radbp: compiling {self.stage.__name__} ...", end="", file=sys.stderr, flush=True)
            began = time.perf_counter()
            result = self.fast(*arguments)
            print(f" {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
            self.met.add(case)
            return result


    def fast(self, *arguments):
        return typed(self.returns, self.compiled(*arguments))


def plain(value):
    """`value` with plain tuples for named ones: torch keeps no compiled function on disk that makes others."""
    if isinstance(value, (tuple, list)):
        return tuple(plain(part) for part in value)
    return value


def typed(kind, value):
    """The inverse of `plain`, for a value of the annotated type `kind`."""
    arguments = typing.get_args(kind)
    if typing.get_origin(kind) is list:
        return [typed(arguments[0], part) for part in value]
    if typing.get_origin(kind) is tuple:
        return tuple(typed(part_kind, part) for part_kind, part in zip(arguments, value))
    if hasattr(kind, "_fields"):
        return kind(*(typed(hint, part) for hint, part in zip(hints_of(kind), value)))
    return value


@functools.cache
def hints_of(kind) -> tuple:
    """The annotated types of a named tuple's fields."""
    return tuple(typing.get_type_hints(kind).values())


def lanes_of(arguments: tuple) -> int:
    """The number of lanes that a stage is called with."""
    state = next((argument for argument in arguments if isinstance(argument, PathState)), None)
    return len(arguments[2] if state is None else state.lane)


def special_case(arguments: tuple) -> tuple:
    """What a stage is compiled for: all that is not a tensor, and dtype and device."""
    leaves = tree_flatten(arguments)[0]
    tensors = [leaf for leaf in leaves if isinstance(leaf, torch.Tensor)]
    return (*(leaf for leaf in leaves if not isinstance(leaf, torch.Tensor)),
            *{(tensor.dtype, tensor.device.type) for tensor in tensors if tensor.is_floating_point()})
