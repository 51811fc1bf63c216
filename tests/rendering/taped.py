"""Renderings whose bounces are recorded, and the same without that."""

from __future__ import annotations

import pytest
import torch

import torch_radbp as rb
from tests.gradients import cotangent, unwarned_renderer
from tests.scenes import parameters
from torch_radbp.adjoint import taped_sweep
from torch_radbp.boundary.reflections import ideal_steps
from torch_radbp.path import taped_bounces, whole_paths

SETTINGS = {"spp": 4, "max_depth": 5, "rr_depth": 2, "compile": True, "terms": ("interior",)}


def singly(monkeypatch: pytest.MonkeyPatch) -> None:
    """From here on nothing is recorded of bounces."""
    for module in (taped_bounces, taped_sweep, whole_paths, ideal_steps):
        monkeypatch.setattr(module, "recordable", lambda integrand: False)


def rendered(scene: rb.Scene, **settings) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """An image, and the gradients of all parameters that it depends on."""
    named = dict(scene.named_parameters())
    wanted = parameters(scene, named)
    image = unwarned_renderer(scene, **SETTINGS | settings)(seed=3)
    found = torch.autograd.grad(image, wanted, cotangent(image.detach()), allow_unused=True)
    return image.detach(), {name: gradient for name, gradient in zip(named, found) if gradient is not None}
