"""The renderer of a run, from a recipe's `[render]`."""

import torch

import torch_radbp as rb
from torch_radbp.rendering.memory import parse_budget
from torch_radbp.training import recipe as schema
from torch_radbp.training.ranks import on_this_machine


def make_renderer(scene, spec: schema.Render) -> rb.Renderer:
    """Returns the renderer that a recipe's `[render]` describes."""
    return rb.Renderer(
        scene,
        spp=spec.spp,
        max_depth=spec.max_depth,
        rr_depth=spec.rr_depth,
        adjoint=None if spec.adjoint is None else make_adjoint(spec.adjoint),
        sampling=spec.sampling,
        chunk=spec.chunk,
        memory_budget=own_budget(spec.memory_budget, scene.device),
        compile=spec.compile,
        caster=spec.caster,
        **({} if spec.terms is None else {"terms": spec.terms}),
        light_paths=spec.light_paths,
        share_samples=True,  # two independent buffers take each other's part
    )


def own_budget(budget: int | str | None, device: torch.device) -> int | None:
    """The bytes of a recipe's `memory_budget`, which is that of a device, that are this process's own."""
    if budget is None:
        return None
    devices = torch.cuda.device_count() if device.type == "cuda" else 1
    return parse_budget(budget) // max(1, -(-on_this_machine() // devices))


def make_adjoint(spec: schema.Adjoint):
    """Returns the strategy of a recipe's `[render] adjoint`."""
    match spec.strategy:
        case "memoized":
            return rb.MemoizedAdjoint(stride=spec.stride, keep_hits=spec.keep_hits)
        case "replay":
            return rb.ReplayAdjoint()
        case "quadratic":
            return rb.QuadraticAdjoint()
        case "tape":
            return rb.TapeAdjoint()
    raise TypeError(f"no strategy for {spec!r}")
