"""`torch.compile` of programs that render: the renderer runs as it is, and what is around it is compiled.

Another thing than `Renderer(compile=True)`, which compiles the functions of a bounce.
"""

from collections import Counter

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import assert_informative
from tests.scenes import cornell, parameters

NAMES = ("white.reflectance.value", "box.to_world")
SETTINGS = {"spp": 2, "max_depth": 3}
pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")


@pytest.fixture(autouse=True)
def compiler_counts() -> dict[str, Counter]:
    """What torch's compiler has counted since the test began; nothing was compiled before."""
    from torch._dynamo.utils import counters  # here, since it takes a second, which collecting tests need not wait for

    torch._dynamo.reset()
    counters.clear()
    return counters


def scene_and_renderer(**settings) -> tuple[rb.Scene, rb.Renderer]:
    scene = cornell(torch.float32, 4)
    parameters(scene, NAMES)
    return scene, rb.Renderer(scene, **SETTINGS | settings)


def step(renderer, seed: int) -> torch.Tensor:
    """What people compile: a loss around a rendering, and its gradient."""
    image = renderer(seed=seed)
    loss = (image * image.cos()).mean()
    loss.backward()
    return loss.detach()


def gradients(scene: rb.Scene) -> list[torch.Tensor]:
    return [scene.get_parameter(name).grad for name in NAMES]


@pytest.mark.parametrize("backend", ["eager", deep("aot_eager")])
@pytest.mark.parametrize("adjoint", [None, rb.MemoizedAdjoint("sqrt", keep_hits=False), rb.TapeAdjoint()], ids=repr)
def test_a_compiled_renderer_gives_the_same_image_and_gradient(backend, adjoint, compiler_counts):
    scene, renderer = scene_and_renderer(adjoint=adjoint)
    other, plain = scene_and_renderer(adjoint=adjoint)
    compiled = torch.compile(renderer, backend=backend)
    for seed in range(3):
        image, expected = compiled(seed=seed), plain(seed=seed)
        assert torch.equal(image, expected)
        image.square().sum().backward()
        expected.square().sum().backward()
    assert_informative(image.detach(), gradients(other))
    assert all(torch.equal(found, wanted) for found, wanted in zip(gradients(scene), gradients(other)))
    assert compiler_counts["stats"]["unique_graphs"] == 0  # nothing of the tracer


@pytest.mark.parametrize("backend", ["eager", deep("aot_eager")])
def test_a_compiled_step_has_the_same_loss_and_gradient(backend, compiler_counts):
    scene, renderer = scene_and_renderer()
    other, plain = scene_and_renderer()
    compiled = torch.compile(step, backend=backend)
    for seed in range(3):
        assert compiled(renderer, seed).item() == pytest.approx(step(plain, seed).item(), rel=1e-6)
    for found, wanted in zip(gradients(scene), gradients(other)):
        assert wanted.abs().max() > 0 and torch.allclose(found, wanted, rtol=1e-5, atol=1e-6 * float(wanted.abs().max()))
    assert compiler_counts["stats"]["unique_graphs"] <= 4  # of the loss


def test_the_other_public_functions_may_be_called_in_compiled_code(tmp_path, compiler_counts):
    scene, tangents = cornell(torch.float32, 4), {"white.reflectance.value": torch.ones(3)}

    def everything() -> list[torch.Tensor]:
        rb.save(scene, tmp_path / "scene.xml")
        image = rb.render(rb.load(tmp_path / "scene.xml"), **SETTINGS)
        return [2 * image, rb.jvp(scene, tangents, **SETTINGS)]

    found, expected = torch.compile(everything, backend="eager")(), everything()
    assert all(torch.equal(a, b) for a, b in zip(found, expected))
    assert compiler_counts["stats"]["unique_graphs"] <= 4
