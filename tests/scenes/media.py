"""Media that scatter, and what stands in them."""

from __future__ import annotations

from tests.scenes import diffuse, rgb

BLACK = diffuse(0, 0, 0)


def haze(sigma_t=(0.3, 0.6, 1.2), albedo=(0.9, 0.5, 0.2), g=0.4) -> dict:
    return {"type": "homogeneous", "sigma_t": rgb(*sigma_t), "albedo": rgb(*albedo), "phase": {"type": "hg", "g": g}}


DULL = haze((0.3, 0.4, 0.5), (0.9, 0.6, 0.3), 0.4)
