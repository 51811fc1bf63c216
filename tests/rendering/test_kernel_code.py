"""Renderings by code that is made quickly, by code that is made well, and by both in turn have the same bits."""

from collections.abc import Iterator

import pytest
import torch

from tests.deep import deep, deep_but
from tests.rendering.taped import SCENES, rendered
from tests.scenes.media import NAMES, room
from torch_radbp.jit.cpu import kernel_code
from torch_radbp.jit.cpu.kernel_code import CpuLoop
from torch_radbp.jit.stages import CompiledStages

GLASS = {"type": "dielectric", "int_ior": 1.3}
BUILT = {**SCENES, "fog behind glass": lambda dtype: room(GLASS).to(dtype)}


def loops_of(stages: CompiledStages) -> Iterator[CpuLoop]:
    """The loops of all stages that were called."""
    for stage in stages:
        for function in (stage.fused, stage.dual.fused):
            for compiled in function.compiled.values():
                if compiled.loop is not None:
                    yield compiled.loop.result()


@pytest.mark.parametrize("name", deep_but(["closed box"], BUILT))
@pytest.mark.parametrize("dtype", [torch.float32, deep(torch.float64)], ids=str)
@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
def test_images_and_gradients_are_the_same_by_any_code(dtype, name, fresh_stages, monkeypatch):
    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off")
    names = NAMES if name == "fog behind glass" else None
    found = []
    for enough in (kernel_code.ENOUGH, 1, 1):
        monkeypatch.setattr(kernel_code, "ENOUGH", enough)
        found.append(rendered(BUILT[name](dtype), names))
        loops = list(loops_of(fresh_stages))
        assert len(loops) > 10
        for loop in loops if enough == 1 else ():
            assert not loop.takes(1) or loop.improving.result() is None
    assert not any(loop.may_improve for loop in loops) and all(len(loop.loaded) == 2 for loop in loops)
    image, gradients = found[0]
    for again, others in found[1:]:
        assert torch.equal(again, image) and others.keys() == gradients.keys()
        assert all(torch.equal(other, gradient) for gradient, other in zip(gradients.values(), others.values()))
