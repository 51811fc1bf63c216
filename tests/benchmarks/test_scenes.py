"""The scenes of the benchmarks: both renderers can load them, and every gradient that is measured is there."""

import warnings

import pytest
import torch

import torch_radbp as rb
from benchmarks.scenes import ALL, QUICK, SCENES


@pytest.mark.parametrize("name", [name for name in ALL if not name.startswith("images")])
def test_every_measured_parameter_gets_a_gradient(name, tmp_path):
    scene = ALL[name].make(tmp_path, QUICK)
    renderer = scene.renderer(compiled=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.SilhouetteWarning)
        image = renderer(seed=0)
    assert image.shape == (1, 3, QUICK.resolution, QUICK.resolution)
    assert 0.01 < image.mean() < 1
    gradients = torch.autograd.grad(image.mean(), [renderer.scene.get_parameter(name) for name in scene.parameters])
    without = [name for name, gradient in zip(scene.parameters, gradients) if not gradient.any()]
    assert not without, f"no light of the image depends on {without}"


def test_the_mesh_has_the_size_that_is_claimed(tmp_path):
    scene = SCENES["metal-mesh"].make(tmp_path, QUICK).load()
    assert len(scene.mesh.faces) >= 70_000
