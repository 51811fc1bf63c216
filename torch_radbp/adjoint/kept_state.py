"""The part of a path state that the backward pass reads once all decisions of a bounce are known."""

from __future__ import annotations

from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState


def part_kept(integrand: Integrand, state: PathState) -> PathState:
    """The fields of a path state that the backward pass reads if it replays no bounce.

    Lights are selected already. Ray origins are read only where rays carry derivatives or pass media. The keys of random
    numbers are kept once for a chunk; only where lights have network textures each state keeps its own.
    """
    layout = integrand.proposal.layout
    ray = state.ray if integrand.settings.moving or layout.media else state.ray._replace(o=None)
    return state._replace(ray=ray, key=state.key if layout.lit else None, vantage=None)
