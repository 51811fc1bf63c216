"""What is not public of torch may be missing in a version: the module is imported without it, renderings are the same."""

import sys
from importlib.util import module_from_spec, spec_from_file_location
from types import SimpleNamespace

import pytest
import torch

import torch_radbp as rb
from tests.gradients import assert_informative
from tests.scenes import cornell, parameters
from torch_radbp.tensors import torch_internals

NAME = "white.reflectance.value"
IMPORTED = {"torch._C._functorch": "get_interpreter_stack", "torch._functorch.pyfunctorch": "get_interpreter_stack",
            "torch._C._dynamo.eval_frame": "set_eval_frame"}  # and what then stands for None


@pytest.mark.parametrize("missing", IMPORTED)
def test_the_module_is_imported_without_a_private_one(missing, monkeypatch):
    monkeypatch.setitem(sys.modules, missing, None)  # which Python refuses to import
    spec = spec_from_file_location("imported_again", torch_internals.__file__)
    again = module_from_spec(spec)
    spec.loader.exec_module(again)
    assert getattr(again, IMPORTED[missing]) is None and getattr(torch_internals, IMPORTED[missing]) is not None


def image_and_gradient() -> list[torch.Tensor]:
    scene = cornell(torch.float32, 4)
    parameters(scene, [NAME])
    image = rb.Renderer(scene, spp=2, max_depth=3, compile=False)(seed=1)
    image.square().sum().backward()
    return [image.detach(), scene.get_parameter(NAME).grad]


def test_a_rendering_is_the_same_without_private_names(monkeypatch):
    expected = image_and_gradient()
    for name in sorted(set(IMPORTED.values())):
        monkeypatch.setattr(torch_internals, name, None)
    monkeypatch.delattr(torch._C, "_dispatch_key_set")
    monkeypatch.setattr(torch_internals, "forward_ad", SimpleNamespace())
    found = image_and_gradient()
    assert_informative(expected[0], expected[1:])
    assert all(map(torch.equal, found, expected))
    assert torch_internals.transforms() == [] and torch_internals.inside_dual_level()
    assert not torch_internals.batched(found[0])
