"""Mitsuba's particle tracer `ptracer`: paths begin at the lamps."""

from __future__ import annotations

from torch_radbp.integrator.path import Path
from torch_radbp.plugin import register


@register("integrator", "ptracer")
class ParticleTracer(Path):
    """Particle tracing: paths begin at the lamps, and each of their vertices is connected to the camera.

    There are as many paths as the image has samples. What is seen in mirrors and through glass, which cannot be connected
    and is missing in Mitsuba's image, comes by paths from the camera, as do lamps that are seen directly:
    `Renderer(light_paths="all")`.
    There is no `block_size`.

    Reference: Veach 1997, "Robust Monte Carlo Methods for Light Transport Simulation", chapter 4.
    """

    light_paths = "all"

    def __init__(self, *, max_depth: int = -1, rr_depth: int = 5, hide_emitters: bool = False, samples_per_pass: int = -1,
                 timeout: float = -1.0):
        super().__init__(max_depth=max_depth, rr_depth=rr_depth, hide_emitters=hide_emitters,
                         samples_per_pass=samples_per_pass, timeout=timeout)
