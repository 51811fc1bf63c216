"""No stage holds a tensor of the wrong device: the stages are traced for arguments of another device, and stay there.

Tensors on `meta` have a device, a shape and a dtype, and no values. They stand for any device that is not the host: fake
tensors of CUDA would do, but torch without CUDA cannot take derivatives of them.
"""

from __future__ import annotations

from importlib import import_module

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

import torch_radbp as rb
from tests.derivatives.everything import EVERYTHING, build_everything
from tests.gradients import cotangent
from tests.texture.networks import room
from torch_radbp.jit.structure import flatten
from torch_radbp.record import leaves_of, with_leaves
from torch_radbp.stages import EAGER

ELSEWHERE = "meta"


class Elsewhere(TorchDispatchMode):
    """Fails where an operation of torch reads or makes a tensor of the host."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        result = function(*args, **kwargs or {})
        for tensor in leaves_of((args, list((kwargs or {}).values()), result)):
            if isinstance(tensor, Tensor) and tensor.device.type != ELSEWHERE:
                raise AssertionError(f"{function}: a tensor on {tensor.device} where all are elsewhere")
        return result


def trace_elsewhere(stage, arguments: tuple) -> list[Tensor]:
    """The tensors that a stage returns for arguments that are moved to another device, without their values."""
    moved = [torch.empty_like(leaf, device=ELSEWHERE) if isinstance(leaf, Tensor) else leaf for leaf in leaves_of(arguments)]
    with torch.no_grad(), Elsewhere():
        return [leaf for leaf in leaves_of(stage(*with_leaves(arguments, moved))) if isinstance(leaf, Tensor)]


@pytest.fixture
def calls(monkeypatch) -> dict[str, dict[tuple, tuple]]:
    """The arguments of all calls of the eager stages, by the stage's name and their structure."""
    found: dict[str, dict[tuple, tuple]] = {name: {} for name in EAGER._fields}

    def recording(name: str, stage):
        def call(*arguments):
            key: list = []
            flatten(arguments, [], key)
            found[name].setdefault(tuple(key), arguments)
            return stage(*arguments)
        return call

    watched = EAGER._make(recording(name, stage) for name, stage in EAGER._asdict().items())
    monkeypatch.setattr(import_module("torch_radbp.render"), "EAGER", watched)
    return found


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")
@pytest.mark.parametrize("sampling", ["hybrid", "attached"])
@pytest.mark.parametrize("name", [*EVERYTHING, "networks"])
def test_every_stage_of_every_appearance_stays_on_its_device(name, sampling, calls):
    scene = (room() if name == "networks" else build_everything(name)).requires_grad_()
    image = rb.Renderer(scene, spp=2, max_depth=4, rr_depth=2, sampling=sampling, compile=False)()
    image.backward(cotangent(image.detach()))
    needed = {"bounce", "bounce_adjoint", "places"} if name == "networks" else calls.keys() - {"places"}
    assert all(calls[stage] for stage in needed)
    appearances = {arguments[0].layout.appearances for arguments in calls["bounce"].values()}
    assert {appearance for part in appearances for appearance in part} == set(rb.scene.pack.pack(scene).layout.appearances)
    for name, cases in calls.items():
        for arguments in cases.values():
            assert {tensor.device.type for tensor in trace_elsewhere(getattr(EAGER, name), arguments)} <= {ELSEWHERE}


CONSTANT = torch.tensor(0.5)
BAD = {
    "a number": lambda x: x * torch.tensor(0.5),
    "lanes": lambda x: torch.zeros(len(x)) + 1,
    "a constant of the module": lambda x: x * CONSTANT,
    "a copy": lambda x: x.cpu(),
}


@pytest.mark.parametrize("stage", BAD.values(), ids=BAD)
def test_a_stage_that_makes_or_reads_a_tensor_of_the_host_is_found(stage):
    arguments = (torch.ones(8),)
    assert [tensor.device.type for tensor in trace_elsewhere(lambda x: x.sin(), arguments)] == [ELSEWHERE]
    with pytest.raises((AssertionError, NotImplementedError)):
        trace_elsewhere(stage, arguments)
