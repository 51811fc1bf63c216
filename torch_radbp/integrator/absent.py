"""Integrators of Mitsuba that are missing here, and what to use instead."""

from __future__ import annotations

from torch_radbp.plugin import absent

for name, reason in {
    "depth": "for the distance of what is seen use an integrator of type aov with aovs=\"dd:depth\", or "
             "renderer.aovs([\"depth\"])",
    "stokes": "light has no polarisation here",
    "acoustic_ad": "sound is not rendered",
    "volprim_rf_basic": "volumetric primitives are not supported",
}.items():
    absent("integrator", name, reason)
