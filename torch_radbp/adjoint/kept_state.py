"""The part of a path state that the backward pass reads once all decisions of a bounce are known."""

from __future__ import annotations

from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState


def part_kept(integrand: Integrand, state: PathState) -> PathState:
    """The part of a state that is differentiated, and all that is kept of it where no bounce is replayed.

    Lights are selected. Rays are cast, and their origins are read only where rays carry derivatives or pass media. Random
    numbers are drawn by the key that the lane has had from the start, of which a chunk has one record; but where textures of
    lights are evaluated outside these are drawn there, too, and the state has its own.
    """
    layout = integrand.proposal.layout
    ray = state.ray if integrand.settings.moving or layout.media else state.ray._replace(o=None)
    return state._replace(ray=ray, key=state.key if layout.lit else None, vantage=None)
