"""The functions of one bounce, as they are or compiled.

Only these are compiled, never the whole path: depth and seed are tensors and the number of lanes is dynamic, so that
bounces, chunks and iterations share one compiled function.
"""

from __future__ import annotations

import functools
from typing import NamedTuple
from collections.abc import Callable

import torch

from torch_radbp.adjoint.sweep import bounce_adjoint
from torch_radbp.path import bounce, sample_camera

# Below this many lanes a compiled function gains nothing, and one or zero lanes would compile a special case.
FEWEST_LANES = 64

# Indices into tables are right by construction.
INDUCTOR_OPTIONS = {"assert_indirect_indexing": False}
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
    return Stages(*(compile_stage(stage) for stage in EAGER))


def compile_stage(stage: Callable) -> Callable:
    fast = torch.compile(stage, dynamic=True, fullgraph=True, options=INDUCTOR_OPTIONS)

    @functools.wraps(stage)
    def call(*arguments):
        lanes = next(a for a in arguments if hasattr(a, "lane") or isinstance(a, torch.Tensor) and a.ndim == 1)
        if len(getattr(lanes, "lane", lanes)) < FEWEST_LANES:
            return stage(*arguments)
        with torch._dynamo.config.patch(DYNAMO_OPTIONS):
            return fast(*arguments)

    return call
