"""The integrator `path` (path tracing), and Mitsuba's differentiable integrators, which render the same."""

from __future__ import annotations

from torch_radbp.integrator.settings import IntegratorSettings, depths
from torch_radbp.plugin import register


@register("integrator", "path")
class Path(IntegratorSettings):
    """Path tracing with next-event estimation.

    Args:
        max_depth: 1 = emission only, 2 = direct light, -1 = unlimited.
        rr_depth: number of scattering events after which Russian roulette begins.
    """

    def __init__(self, *, max_depth: int = -1, rr_depth: int = 5, hide_emitters: bool = False, block_size: int = 0,
                 samples_per_pass: int = -1, timeout: float = -1.0):
        super().__init__(hide_emitters=hide_emitters, block_size=block_size, samples_per_pass=samples_per_pass,
                         timeout=timeout)
        self.max_depth, self.rr_depth = depths(max_depth, rr_depth)


@register("integrator", "prb")
class PathReplay(Path):
    """Mitsuba's path replay backpropagation. Here `adjoint=` of `Renderer` chooses how derivatives are computed; the name
    sets what is rendered, which is what `path` renders, to another default depth."""

    def __init__(self, *, max_depth: int = 6, rr_depth: int = 5, hide_emitters: bool = False, block_size: int = 0,
                 samples_per_pass: int = -1, timeout: float = -1.0):
        super().__init__(max_depth=max_depth, rr_depth=rr_depth, hide_emitters=hide_emitters, block_size=block_size,
                         samples_per_pass=samples_per_pass, timeout=timeout)


@register("integrator", "prb_basic")
class BasicPathReplay(PathReplay):
    """Mitsuba's path replay without next-event estimation of derivatives and roulette: the same expectation as `prb`."""
