"""Mitsuba's integrators for participating media, which are path tracing here, as all are."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

from torch_radbp.integrator.path import Path, PathReplay
from torch_radbp.plugin import BSDF, boolean, register


class VolumetricPath(Path):
    """Base class of Mitsuba's volumetric integrators: here all path tracing goes through media.

    It agrees with Mitsuba's volumetric integrators in expectation, but for one thing: there, light that passes straight
    through a surface (`null`, `mask`, `thindielectric`) is not counted towards `max_depth`, and next-event estimation looks
    through; here that is so in scenes with media, and in others it is a bounce, as in `path`.
    """

    def check(self, materials: Iterable[BSDF]) -> None:
        """Warns if a path of limited depth may pass straight through one of the materials."""
        if self.max_depth != -1 and any(material.kind().straight for material in materials):
            warnings.warn(f"{self.type} is rendered as path: light that passes straight through a surface counts towards "
                          f"max_depth={self.max_depth}, which it does not in Mitsuba's {self.type}; set max_depth to -1 if "
                          "that matters", stacklevel=2)


@register("integrator", "volpath")
class VolumePath(VolumetricPath):
    """Mitsuba's volumetric path tracer: what `path` renders, media included.

    Light that passes straight through a surface (`null`, `mask`, `thindielectric`) is a bounce in scenes without media, as
    in `path`; in Mitsuba's it is never counted towards `max_depth`.
    """


@register("integrator", "volpathmis")
class SpectralVolumePath(VolumetricPath):
    """Mitsuba's volumetric path tracer with spectral multiple importance sampling: what `path` renders, media included.

    Light that passes straight through a surface (`null`, `mask`, `thindielectric`) is a bounce in scenes without media, as
    in `path`; in Mitsuba's it is never counted towards `max_depth`.

    Args:
        use_spectral_mis: without effect: distances are always weighted against all three colours.
    """

    def __init__(self, *, max_depth: int = -1, rr_depth: int = 5, use_spectral_mis: bool = True,
                 hide_emitters: bool = False, block_size: int = 0, samples_per_pass: int = -1, timeout: float = -1.0):
        super().__init__(max_depth=max_depth, rr_depth=rr_depth, hide_emitters=hide_emitters, block_size=block_size,
                         samples_per_pass=samples_per_pass, timeout=timeout)
        self.use_spectral_mis = boolean("use_spectral_mis", use_spectral_mis)  # of media alone


@register("integrator", "prbvolpath")
class VolumePathReplay(PathReplay, VolumetricPath):
    """Mitsuba's path replay backpropagation through media: what `prb` renders, media included.

    Light that passes straight through a surface (`null`, `mask`, `thindielectric`) is a bounce in scenes without media, as
    in `path`; in Mitsuba's it is never counted towards `max_depth`.
    """
