"""Plugins of Mitsuba that are missing here, why, and what to use instead; integrators have a table of their own."""

from __future__ import annotations

from torch_radbp.plugin import absent

POLARISED = "light has no polarisation here"
CLOUDS = "shapes are no clouds of kernels; a heterogeneous medium with a gridvolume is one"
NO_IMAGE = "it takes no image; a perspective or orthographic sensor does"
CURVES = "there are no curves; convert them to a mesh"

for category, reasons in {
    "bsdf": {"circular": POLARISED, "polarizer": POLARISED, "retarder": POLARISED, "measured_polarized": POLARISED,
             "pplastic": f"{POLARISED}; use plastic or roughplastic",
             "measured": "tables of measurements are not read; fit a principled to it", "hair": CURVES},
    "emitter": {"timed_sunsky": "a sky over a span of time is not there; use sunsky at one time"},
    "shape": {"bsplinecurve": CURVES, "linearcurve": CURVES, "ellipsoids": CLOUDS, "ellipsoidsmesh": CLOUDS,
              "merge": "it is not needed, meshes are one already: put its shapes directly into the scene",
              "blender": "it is read from Blender's memory; save the mesh as PLY or OBJ, or the scene as glTF"},
    "sensor": {"distant": NO_IMAGE, "irradiancemeter": NO_IMAGE, "radiancemeter": NO_IMAGE},
    "film": {"specfilm": "light has three colours and no spectrum; use hdrfilm"},
}.items():
    for name, reason in reasons.items():
        absent(category, name, reason)
