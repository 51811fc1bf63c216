"""Gradients of renderings are finite over the whole range of every parameter, in both precisions; if not, errors tell."""

import warnings

import pytest
import torch

import torch_radbp as rb
from tests.derivatives.extremes import CASES
from torch_radbp.plugin import REGISTRY

# Parameters that no picture of these scenes can depend on.
STILL = {"envmap.scale", "projector.scale"}


def gradients(scene: rb.Scene, dtype: torch.dtype, sampling: str, **settings) -> dict[str, torch.Tensor]:
    """Of every parameter, for random cotangents."""
    scene.requires_grad_()
    renderer = rb.Renderer(scene, spp=3, max_depth=4, rr_depth=3, sampling=sampling, **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.SilhouetteWarning)
        image = renderer(seed=5)
    assert image.dtype == dtype and torch.isfinite(image).all() and image.max() > 0
    cotangent = torch.randn(image.shape, generator=torch.Generator().manual_seed(1)).to(dtype)
    image.backward(cotangent)
    return {name: parameter.grad for name, parameter in scene.named_parameters() if parameter.grad is not None}


@pytest.mark.parametrize("sampling", ["hybrid", "attached"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", CASES)
def test_gradients_are_finite(name, dtype, sampling):
    found = gradients(CASES[name](dtype), dtype, sampling)
    bad = {name: int((~torch.isfinite(gradient)).sum()) for name, gradient in found.items()}
    assert not any(bad.values()), {name: count for name, count in bad.items() if count}
    assert sum(bool((gradient != 0).any()) for gradient in found.values()) > 8


def test_every_plugin_takes_part():
    """A new plugin has to appear in one of these scenes."""
    scenes = [CASES[name](torch.float32) for name in (*list(CASES)[:1], "conductor black", "dielectric black",
                                                      "roughconductor ggx brushed", "roughdielectric ggx brushed",
                                                      "sphere, constant sky")]
    there = {(module.category, module.type) for scene in scenes for module in scene.modules() if hasattr(module, "category")}
    categories = ("bsdf", "texture", "emitter", "sensor", "shape")
    known = {(category, name) for category in categories for name in REGISTRY[category]}
    assert known - there == {("shape", "obj"), ("shape", "ply")}  # meshes once they are read
