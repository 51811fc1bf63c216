"""Mitsuba's particle tracer `ptracer`, rendered by path tracing."""

from __future__ import annotations

import warnings

from torch_radbp.integrator.path import Path
from torch_radbp.plugin import register


@register("integrator", "ptracer")
class ParticleTracer(Path):
    """Path tracing in the place of particle tracing: paths start at the camera, not at the lights.

    The expectation of the image is the same, but for lights without extent seen in mirrors and through glass, which only
    particles find. Noise differs: caustics are noisier here, everything else is quieter. There is no `block_size`.
    """

    def __init__(self, *, max_depth: int = -1, rr_depth: int = 5, hide_emitters: bool = False, samples_per_pass: int = -1,
                 timeout: float = -1.0):
        super().__init__(max_depth=max_depth, rr_depth=rr_depth, hide_emitters=hide_emitters,
                         samples_per_pass=samples_per_pass, timeout=timeout)
        warnings.warn("ptracer is rendered as path: from the camera, not from the lights; the image is the same in "
                      "expectation, its noise is not, and caustics of lights without extent are missing", stacklevel=2)
