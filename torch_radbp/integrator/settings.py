"""The checked settings that all integrators share."""

from __future__ import annotations

from torch_radbp.plugin import Integrator, boolean, integer


class IntegratorSettings(Integrator):
    """Base class of all integrators: defaults of `Renderer`.

    Args:
        hide_emitters: do not show emitters that the camera sees directly.
        block_size, samples_per_pass: of Mitsuba's image blocks and passes; without effect here, where `chunk` and
            `memory_budget` of `Renderer` bound the memory.
        timeout: -1; a rendering always takes all of its samples.
    """

    max_depth = -1
    rr_depth = 5
    nee = True  # next-event estimation
    light_paths = "auto"  # see `Renderer`

    def __init__(self, *, hide_emitters: bool = False, block_size: int = 0, samples_per_pass: int = -1,
                 timeout: float = -1.0):
        super().__init__()
        self.hide_emitters = boolean("hide_emitters", hide_emitters)
        self.block_size = integer("block_size", block_size)
        self.samples_per_pass = integer("samples_per_pass", samples_per_pass)
        self.timeout = float(timeout)
        if self.timeout >= 0:
            raise ValueError(f"timeout is not supported but for -1, none, got {timeout}: a rendering always takes all of "
                             "its samples; set their number by sample_count or spp")

    def outputs(self) -> dict[str, str]:
        """The AOVs beside the image: the quantity of each name, see `torch_radbp.aov`."""
        return {}

    def alpha(self) -> str:
        """The AOV that becomes the alpha channel of the image."""
        return "alpha"


def depths(max_depth: int, rr_depth: int) -> tuple[int, int]:
    """Checks both depths, and converts them to integers.

    Raises:
        ValueError: if one is not an integer, or out of range.
    """
    max_depth, rr_depth = integer("max_depth", max_depth), integer("rr_depth", rr_depth)
    if max_depth < -1:
        raise ValueError(f"max_depth must be -1 (unlimited) or at least 0, got {max_depth}")
    if rr_depth < 1:
        raise ValueError(f"rr_depth must be at least 1, got {rr_depth}")
    return max_depth, rr_depth
