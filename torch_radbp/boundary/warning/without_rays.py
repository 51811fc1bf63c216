"""Warns of cameras whose lens projects no direction onto most of the image."""

from __future__ import annotations

from collections.abc import Set

from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.warning.view_rays import rays_of
from torch_radbp.plugin import SceneWarning

FEW = 0.1  # share of the image with a ray below which it is warned of; a whole fisheye's circle in a wide image has 0.4


def views_without_rays(rendering: Rendering, known: Set[int]) -> SceneWarning | None:
    """The warning that hardly any pixel has a ray, because of the lens's distortion; or None.

    Args:
        rendering: that is about to start.
        known: ids of sensors that were warned of before.
    """
    for sensor, sight in zip(rendering.sensors, rendering.sights):
        share = 1.0 if id(sensor) in known else float(rays_of(sight)[2].double().mean())
        if share < FEW:
            return SceneWarning(f"the distortion of `{rendering.names[id(sensor)]}` projects no direction onto "
                                f"{100 * (1 - share):.0f}% of its image, which is black there, and has no derivatives: its "
                                f"coefficients are OpenCV's, of image coordinates divided by the focal length, and rarely "
                                f"larger than 1")
    return None
