"""Rendering by the kernels of a GPU: images and gradients are those of plain torch.

No GPU is needed: the kernels run on the processor, one thread after another, from the text that PTX is made of
(`tests/jit/emulated.py`). So all but the translation to PTX, the driver and the rays of `warp` is what a GPU would run.
"""

import pytest
import torch

import torch_radbp as rb
from tests.gradients import assert_informative, image_and_gradients, relative_error
from tests.jit.emulated import Emulated
from tests.rendering.on_gpu import render_on
from tests.scenes import CASES, cornell
from tests.scenes.everything import EVERYTHING, build_everything
from torch_radbp.jit.nvidia.gpu import Gpu

pytestmark = pytest.mark.filterwarnings("error:.*runs eagerly:RuntimeWarning",
                                        "ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")
SETTINGS = {"spp": 4, "max_depth": 5, "rr_depth": 3}


@pytest.fixture
def gpu(monkeypatch) -> Gpu:
    """A GPU on which compiled renderings run during the test; it begins with nothing compiled."""
    device = Gpu(Emulated())
    render_on(device, monkeypatch)
    return device


def test_the_image_and_gradients_of_the_kernels_are_the_eager_ones(gpu):
    """Fusing changes roundings of 6e-8, some thousands of which add up; a lane in ten thousand may decide otherwise."""
    names = CASES["cornell"].parameters
    (expected, gradients), (image, found) = (
        image_and_gradients(cornell(torch.float32, 16), names, compile=compile, **SETTINGS) for compile in (False, True))
    assert {launch.name for launch in gpu.launcher.launches} == {"lanes", "put", "scatter"}
    assert_informative(expected, list(gradients))
    differs = ((image - expected).abs() > 1e-4 * expected.max()).any(dim=1)
    assert differs.sum() <= 2  # of 256 pixels
    for name, gradient, wanted in zip(names, found, gradients):
        assert relative_error(gradient, wanted) < (1e-3 if differs.any() else 1e-4), name


@pytest.mark.deep
@pytest.mark.parametrize("sampling", ["hybrid", "attached"])
@pytest.mark.parametrize("name", EVERYTHING)
def test_every_plugin_and_parameter_comes_out_of_the_kernels_as_it_is_eagerly(name, sampling, gpu):
    settings, results = {"spp": 2, "max_depth": 4, "rr_depth": 2, "sampling": sampling}, []
    for compile in (False, True):
        scene = build_everything(name)
        names = [name for name, _ in scene.named_parameters()]
        results.append(image_and_gradients(scene, names, compile=compile, **settings))
    (expected, gradients), (image, found) = results
    assert_informative(expected, [gradient for gradient in gradients if gradient.abs().max() > 1e-9])
    assert relative_error(image, expected) < 1e-12
    for name, gradient, wanted in zip(names, found, gradients):
        # Below that it is rounding, as of texture coordinates that nothing reads.
        assert relative_error(gradient, wanted) < 1e-9 if wanted.abs().max() > 1e-9 else gradient.abs().max() < 1e-8, name


class OnCuda:
    """A scene that says that it is on CUDA; all else is that of another."""

    def __init__(self, scene: rb.Scene):
        self.scene, self.device = scene, torch.device("cuda", 0)

    def __getattr__(self, name: str):
        return getattr(self.scene, name)


@pytest.mark.parametrize("settings, fused", [
    ({}, True), ({"compile": False}, False), ({"adjoint": rb.TapeAdjoint()}, False)])
def test_on_cuda_rendering_is_compiled_unless_the_caller_says_otherwise(settings, fused):
    renderer = rb.Renderer(cornell(torch.float32, 8), **settings)
    assert renderer.runs_compiled() == fused
    del renderer.scene
    renderer.__dict__["scene"] = OnCuda(cornell(torch.float32, 8))
    assert renderer.runs_compiled() == fused
    renderer.scene.device = torch.device("mps")
    assert not renderer.runs_compiled()
