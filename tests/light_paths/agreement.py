"""Images by paths from the camera and from lamps, and whether they agree."""

from __future__ import annotations

import torch
from torch import Tensor

import torch_radbp as rb

SEEDS, SPP = 12, 64


def images(scene: rb.Scene, light_paths: str, spp: int = SPP, **settings) -> Tensor:
    renderer = rb.Renderer(scene, light_paths=light_paths, **settings)
    with torch.no_grad():
        return torch.cat([renderer(seed=seed, spp=spp) for seed in range(SEEDS)])


def assert_agree(one: Tensor, other: Tensor, most: float = 4.5) -> None:
    """Means over seeds agree, by their standard errors: of the whole image, of its quarters, and of its pixels."""
    assert one.mean() > 1e-3 and torch.isfinite(other).all()
    for size in (one.shape[-1], one.shape[-1] // 2):
        parts = [torch.nn.functional.avg_pool2d(each.double(), size) for each in (one, other)]
        error = (sum(part.var(0) for part in parts) / SEEDS).sqrt() + 1e-6 * parts[0].mean()
        assert ((parts[0].mean(0) - parts[1].mean(0)).abs() / error).max() < most
    pixels = [each.double() for each in (one, other)]
    error = (sum(part.var(0) for part in pixels) / SEEDS).sqrt() + 1e-4 * one.mean()
    assert (((pixels[0].mean(0) - pixels[1].mean(0)) / error) ** 2).mean() < 2.5
