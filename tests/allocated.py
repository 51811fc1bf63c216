"""The memory that torch allocates."""

from torch.profiler import ProfilerActivity, profile

import torch_radbp as rb


def allocated(renderer: rb.Renderer) -> int:
    """The most bytes that torch holds during a forward and backward pass, over those before it."""
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as profiler:
        renderer(seed=1).sum().backward()
    held = peak = 0
    for event in profiler.profiler.kineto_results.events():
        if event.name() == "[memory]":
            held += event.nbytes()
            peak = max(peak, held)
    return peak
