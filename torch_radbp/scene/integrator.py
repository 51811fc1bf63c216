"""The integrator element of a scene: the defaults of `Renderer`."""

from __future__ import annotations

from torch_radbp.plugin import Integrator, boolean, integer, register


@register("integrator", "path")
class Path(Integrator):
    """Path tracing with next-event estimation.

    Args:
        max_depth: 1 = emission only, 2 = direct light, -1 = unlimited.
        rr_depth: number of scattering events after which Russian roulette begins.
        hide_emitters: do not show emitters that the camera sees directly.
    """

    def __init__(self, *, max_depth: int = -1, rr_depth: int = 5, hide_emitters: bool = False):
        super().__init__()
        self.max_depth, self.rr_depth = depths(max_depth, rr_depth)
        self.hide_emitters = boolean("hide_emitters", hide_emitters)


@register("integrator", "prb")
class PathReplay(Path):
    """Mitsuba's differentiable integrator; here the same as `path`, since `adjoint=` chooses the method."""


def depths(max_depth: int, rr_depth: int) -> tuple[int, int]:
    """Both depths as integers.

    Raises:
        ValueError: if one is not an integer, or out of range.
    """
    max_depth, rr_depth = integer("max_depth", max_depth), integer("rr_depth", rr_depth)
    if max_depth < -1:
        raise ValueError(f"max_depth must be -1 (unlimited) or at least 0, got {max_depth}")
    if rr_depth < 1:
        raise ValueError(f"rr_depth must be at least 1, got {rr_depth}")
    return max_depth, rr_depth
