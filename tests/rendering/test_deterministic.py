"""`torch.use_deterministic_algorithms` on a GPU: gradients are the same bit for bit, and torch refuses no operation.

The kernels run on the processor, here with their threads in one order and in the other.
"""

from importlib import import_module

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import assert_informative, image_and_gradients, unwarned_renderer
from tests.jit.emulated import Emulated
from tests.rendering.host import place
from tests.scenes import CASES, cornell
from tests.scenes.everything import build_everything
from torch_radbp.check.statistics import Cotangent, Estimates, compare
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.stages import CompiledStages
from torch_radbp.sampling import running_sum
from torch_radbp.training.false_colour import error_scale, false_colour

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")

ON_HOST = ("film/filter.py", "sampling/alias.py")  # what is summed there is summed in one order, whatever the device
# What torch's documentation of `use_deterministic_algorithms` says it refuses on CUDA, of what a renderer might call.
REFUSED = ("put_", "put", "histc", "kthvalue", "median.dim", "grid_sampler", "reflection_pad", "upsample", "avg_pool3d",
           "adaptive", "max_unpool", "_embedding_bag", "scatter_reduce.prod", "cumsum", "bincount")


@pytest.fixture
def deterministic():
    torch.use_deterministic_algorithms(True)
    yield
    torch.use_deterministic_algorithms(False)


def by_threads(backwards: bool, monkeypatch):
    """An image and gradients by the kernels of a GPU, whose threads run in the order of the lanes or from the last on."""
    device = Gpu(Emulated(backwards=backwards))
    with monkeypatch.context() as patch:
        patch.setattr(import_module("torch_radbp.rendering.renderer"), "compiled", lambda: fused)
        fused = CompiledStages()
        for module in ("order", "scatter", "run", "stages"):
            patch.setattr(import_module(f"torch_radbp.jit.{module}"), "target_of", lambda of: device)
        found = image_and_gradients(cornell(torch.float64, 8), CASES["cornell"].parameters, spp=8, max_depth=4)
    return found, {launch.name for launch in device.launcher.launches}


def test_gradients_do_not_depend_on_the_order_of_the_threads(deterministic, monkeypatch):
    ((image, gradients), names), ((other_image, others), _) = (by_threads(way, monkeypatch) for way in (False, True))
    assert_informative(image, list(gradients))
    assert names == {"lanes", "put"} and torch.equal(image, other_image)
    assert all(map(torch.equal, gradients, others))


def test_without_it_they_do(monkeypatch):
    ((image, gradients), names), ((other_image, others), _) = (by_threads(way, monkeypatch) for way in (False, True))
    assert "scatter" in names and torch.equal(image, other_image)
    assert not all(map(torch.equal, gradients, others))
    for gradient, other in zip(gradients, others):
        torch.testing.assert_close(gradient, other, rtol=1e-12, atol=1e-15)


class Refusals(TorchDispatchMode):
    """Notes the operations that torch would refuse on CUDA."""

    def __init__(self):
        super().__init__()
        self.found = set()

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name = function.name().removeprefix("aten::")
        exact = name.startswith("cumsum") and not args[0].is_floating_point()  # of integers
        weighed = name.startswith("bincount") and len(args) > 1 and args[1] is not None
        if name.startswith(REFUSED) and not exact and (weighed or not name.startswith("bincount")):
            where = place()
            if not where.startswith(ON_HOST):
                self.found.add((name, where))
        return function(*args, **kwargs or {})


@pytest.mark.parametrize("name, terms", [("materials", {"terms": ("interior",)}), ("lamps", {}), deep("materials", {})],
                         ids=["materials", "lamps", "materials, all terms"])
def test_no_plugin_calls_what_torch_refuses(name, terms, monkeypatch):
    monkeypatch.setattr(torch, "are_deterministic_algorithms_enabled", lambda: True)
    monkeypatch.setattr(running_sum, "sums_in_any_order", lambda device: True)
    scene = build_everything(name)
    wanted = [parameter.requires_grad_() for _, parameter in scene.named_parameters()]
    with Refusals() as refusals:
        make = unwarned_renderer if terms else rb.Renderer  # which looks for jumps
        image = make(scene, spp=1, max_depth=2, caster="brute", compile=False, **terms)(seed=1)
        gradients = torch.autograd.grad(image.sum(), wanted, allow_unused=True)
    assert any(gradient is not None and gradient.any() for gradient in gradients)
    assert not refusals.found


def test_neither_a_check_nor_an_error_image_calls_what_torch_refuses(monkeypatch):
    monkeypatch.setattr(torch, "are_deterministic_algorithms_enabled", lambda: True)
    monkeypatch.setattr(running_sum, "sums_in_any_order", lambda device: True)
    draw = torch.Generator().manual_seed(5)
    truth, *noise = (torch.rand(n, 1, 3, 9, 8, generator=draw, dtype=torch.float64) for n in (1, 16, 16))
    samples = Estimates(*(truth + each for each in noise), torch.zeros_like(truth[0]))
    with Refusals() as refusals:
        result = compare(samples, [Cotangent("ones", torch.ones_like(truth[0]))], [0.0], 1e-16)
        colours = false_colour(truth[0, 0], error_scale(truth[0, 0]))
    assert 0 < result.pixels.concentration < 0.5 and colours.any()
    assert not refusals.found


def test_refusals_are_found():
    with Refusals() as refusals:
        torch.rand(4).cumsum(0), torch.arange(4).cumsum(0), torch.arange(4).bincount()
    assert {name for name, _ in refusals.found} == {"cumsum"}
