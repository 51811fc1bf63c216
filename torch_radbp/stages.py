"""The functions of one bounce, as they are or compiled.

Only these are compiled, never the whole path: depth and seed are tensors and the number of lanes is dynamic, so that
bounces, chunks and iterations share one compiled function.
"""

from __future__ import annotations

import functools
from typing import Callable, NamedTuple

import torch

from torch_radbp.adjoint.sweep import bounce_adjoint
from torch_radbp.path import bounce, camera_path

# Below this many lanes a compiled function gains nothing, and one or zero lanes would compile a special case.
FEWEST_LANES = 64

# Inductor inlines the history of every output by default; cutting it at shared values compiles three times faster.
INDUCTOR_OPTIONS = {"realize_reads_threshold": 2, "realize_opcount_threshold": 16}


class Stages(NamedTuple):
    """The three functions that run per chunk or per bounce."""

    camera_path: Callable
    bounce: Callable
    bounce_adjoint: Callable


EAGER = Stages(camera_path, bounce, bounce_adjoint)


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
        with torch._dynamo.config.patch(trace_autograd_ops=True):
            return fast(*arguments)

    return call
