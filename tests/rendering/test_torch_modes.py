"""What torch is set to change for a whole program changes nothing here: default dtype, default device, autocast.

A device of type "meta" holds no numbers, so that a tensor that is made on the default device by mistake cannot go unseen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.func import functional_call

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import assert_informative, cotangent, unwarned_renderer
from tests.scenes import cornell, diffuse, load, rectangle, rgb, sensor, texels
from tests.scenes.everything import EVERYTHING, build_everything
from torch_radbp.io.values.transform import rotate, scale

SETTINGS = {"spp": 2, "max_depth": 4, "rr_depth": 2}
STRATEGIES = (rb.MemoizedAdjoint(), rb.MemoizedAdjoint("log", keep_hits=False), rb.ReplayAdjoint(), rb.QuadraticAdjoint(),
              rb.TapeAdjoint())
pytestmark = [pytest.mark.hostile, pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")]


@contextmanager
def default_dtype(dtype: torch.dtype) -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


@contextmanager
def default_device(name: str) -> Iterator[None]:
    torch.set_default_device(name)
    try:
        yield
    finally:
        torch.set_default_device(None)


@contextmanager
def deterministic_algorithms() -> Iterator[None]:
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(False)


@contextmanager
def fast_matrix_products() -> Iterator[None]:
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


MODES: dict[str, Callable] = {
    "default dtype float64": lambda: default_dtype(torch.float64),
    "default dtype float16": lambda: default_dtype(torch.float16),
    "default device meta": lambda: default_device("meta"),
    "device meta": lambda: torch.device("meta"),
    "autocast to bfloat16": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "autocast to float16": lambda: torch.autocast("cpu", dtype=torch.float16),
    "matrix products in bfloat16": fast_matrix_products,
    "deterministic algorithms": deterministic_algorithms,
}
UNLIKE = [name for name in MODES if name not in ("device meta", "autocast to float16")]  # each other
SOME = deep_but(["default dtype float64", "default device meta", "autocast to bfloat16"], MODES)  # of each sort
MAKING = ("default dtype float64", "default device meta")  # by which tensors are made otherwise, as each strategy makes some


def objects_of_a_room() -> dict[str, Any]:
    """Four pixels of an image on a floor, a block of rough metal and a box, under a spot and a sky."""
    floor = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels(3, 4)}}
    metal = {"type": "roughconductor", "alpha": {"type": "bitmap", "data": texels(2, 2)}}
    return dict(
        sensor=sensor(2, (0, 0.7, 3), (0, 0, 0), rfilter="gaussian"),
        floor=rectangle((0, -0.5, 0), 1.5, angle=-90, bsdf=floor),
        block={"type": "cube", "to_world": rotate((1, 2, 0), 30) @ scale((0.5, 0.4, 0.3)), "bsdf": metal},
        box={"type": "cube", "to_world": [[0.3, 0, 0, 0.8], [0, 0.4, 0.1, 0], [0, -0.1, 0.4, 0.2], [0, 0, 0, 1]],
             "bsdf": diffuse(0.3, 0.5, 0.2)},
        spot={"type": "spot", "to_world": [[1, 0, 0, 0.1], [0, 0, -1, 2], [0, 1, 0, 0], [0, 0, 0, 1]],
              "intensity": rgb(5, 6, 7), "cutoff_angle": 60},
        sky={"type": "envmap", "bitmap": texels(3, 6)})


def lit_room() -> rb.Scene:
    return load(torch.float32, **objects_of_a_room())


def gradients(scene: rb.Scene, adjoint, **settings) -> list[Tensor]:
    """An image, and the gradients of all floating-point parameters that it depends on."""
    wanted = [parameter.requires_grad_() for parameter in scene.parameters()]
    make = rb.Renderer if adjoint == STRATEGIES[0] else unwarned_renderer  # which look for jumps alike
    image = make(scene, adjoint=adjoint, **SETTINGS | settings)(seed=3)
    found = torch.autograd.grad(image, wanted, cotangent(image.detach()), allow_unused=True)
    return [image.detach(), *(gradient for gradient in found if gradient is not None)]


def same(found: list[Tensor], expected: list[Tensor]) -> bool:
    assert len(found) == len(expected) > 1
    return all(a.dtype == b.dtype and a.device == b.device and torch.equal(a, b) for a, b in zip(found, expected))


@pytest.fixture(scope="module")
def references() -> dict[str, list[Tensor]]:
    return {repr(adjoint): gradients(lit_room(), adjoint) for adjoint in STRATEGIES}


@pytest.mark.parametrize("mode, adjoint", [
    (mode, adjoint) if mode in MAKING or (mode in UNLIKE and adjoint == STRATEGIES[0]) else deep(mode, adjoint)
    for mode in MODES for adjoint in STRATEGIES], ids=str)
def test_images_and_gradients_are_the_same(mode, adjoint, references):
    scene, expected = lit_room(), references[repr(adjoint)]
    assert_informative(expected[0], [gradient for gradient in expected[1:] if gradient.abs().max() > 0])
    with MODES[mode]():
        assert same(gradients(scene, adjoint), expected)


@pytest.mark.deep
@pytest.mark.parametrize("name", EVERYTHING)
def test_gradients_of_all_parameters_ignore_autocast(name):
    """Those of poses run through matrix products, whose derivatives run while the user's own `backward()` does."""
    adjoint, settings = rb.MemoizedAdjoint(), {"spp": 1, "max_depth": 3, "sampling": "hybrid"}
    expected = gradients(build_everything(name, torch.float32), adjoint, **settings)
    scene = build_everything(name, torch.float32)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert same(gradients(scene, adjoint, **settings), expected)


TANGENTS = {"box.to_world": torch.ones(4, 4), "floor.bsdf.reflectance.data": torch.ones(3, 4, 3)}


@pytest.fixture(scope="module")
def expected_derivative() -> Tensor:
    return rb.jvp(lit_room(), TANGENTS, seed=1, **SETTINGS)


@pytest.mark.parametrize("mode", SOME)
def test_derivative_images_are_the_same(mode, expected_derivative):
    scene, expected = lit_room(), expected_derivative
    with MODES[mode]():
        found = rb.jvp(scene, TANGENTS, seed=1, **SETTINGS)
    assert expected.abs().max() > 0 and torch.equal(found, expected) and found.dtype == expected.dtype


@pytest.mark.parametrize("mode", SOME)
def test_checks_of_a_gradient_are_the_same(mode, expected_check):
    scene = cornell(torch.float32, 2)
    with MODES[mode]():
        assert check(scene) == expected_check


def check(scene: rb.Scene) -> str:
    return str(rb.check_gradient(scene, "white.reflectance.value", spp=8, batches=8, max_depth=2))


@pytest.fixture(scope="module")
def expected_check() -> str:
    return check(cornell(torch.float32, 2))


@pytest.fixture(scope="module")
def expected_plan() -> tuple[Any, Tensor]:
    renderer = rb.Renderer(lit_room(), memory_budget="64MiB", **SETTINGS)
    return renderer.memory_plan(), renderer(seed=2)


@pytest.mark.parametrize("mode", SOME)
def test_plans_and_calls_within_a_memory_budget_are_the_same(mode, expected_plan):
    renderer = rb.Renderer(lit_room(), memory_budget="64MiB", **SETTINGS)
    with MODES[mode]():
        assert renderer.memory_plan() == expected_plan[0]
        assert torch.equal(renderer(seed=2), expected_plan[1])


@pytest.mark.parametrize("mode", [name for name in MODES if not name.startswith("default dtype")])
def test_scenes_are_loaded_the_same(mode, tmp_path):
    description = {"type": "scene", **objects_of_a_room()}

    def loaded() -> list[rb.Scene]:
        return [rb.load_dict(description), rb.load(tmp_path / "scene.xml")]

    rb.save(lit_room(), tmp_path / "scene.xml")
    expected = loaded()
    with MODES[mode]():
        for scene, other in zip(loaded(), expected):
            assert same(list(scene.state_dict().values()), list(other.state_dict().values()))
            assert same(list(scene.buffers()), list(other.buffers()))


@pytest.mark.parametrize("mode", MODES)
def test_scenes_are_saved_the_same(mode, tmp_path):
    def save(scene: rb.Scene) -> None:
        rb.save(scene, tmp_path / "scene.xml")
        rb.save_image(tmp_path / "image.png", scene.get_parameter("floor.bsdf.reflectance.data").movedim(2, 0))

    save(lit_room())
    expected = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    scene = lit_room()
    with MODES[mode]():
        save(scene)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == expected
    assert b'type="cube"' in expected["scene.xml"]


def test_scenes_have_the_default_dtype_throughout():
    wide = {"type": "scene", **objects_of_a_room(), "pane": {"type": "rectangle", "bsdf": {"type": "dielectric"}}}
    with default_dtype(torch.float64):
        scene = rb.load_dict(wide)
        tensors = [*scene.parameters(), *(buffer for buffer in scene.buffers() if buffer.is_floating_point())]
        assert len(tensors) > 20 and all(tensor.dtype == torch.float64 for tensor in tensors)
    assert rb.render(scene, **SETTINGS).dtype == torch.float64


def test_a_default_dtype_that_no_scene_can_have_is_refused():
    with default_dtype(torch.bfloat16), pytest.raises(TypeError, match="float32 or float64.*default dtype is torch.bfl"):
        rb.load_dict({"type": "scene", **objects_of_a_room()})


@pytest.mark.parametrize("mode", MODES)
def test_rigid_motions_have_the_dtype_and_device_of_their_arguments(mode):
    rotation, translation = torch.tensor([0.3, -0.2, 0.5]), torch.tensor([1.0, 2.0, 3.0])
    expected = [rb.se3(rotation, translation), rb.look_at(rotation, translation, [0, 1, 0])]
    with MODES[mode]():
        assert same([rb.se3(rotation, translation), rb.look_at(rotation, translation, [0, 1, 0])], expected)


def test_images_of_inference_mode_are_the_same():
    scene, expected = lit_room(), rb.render(lit_room(), seed=1, **SETTINGS)
    with torch.inference_mode():
        assert torch.equal(rb.render(scene, seed=1, **SETTINGS), expected)


@pytest.mark.parametrize("how", ["loaded", "converted", "copied"])
def test_a_parameter_of_inference_mode_that_requires_a_gradient_is_an_error(how):
    """Of such tensors torch records nothing: the image would have no gradient, and nobody were told."""
    scene = lit_room()
    with torch.inference_mode():
        scene = {"loaded": lit_room, "converted": scene.double, "copied": lambda: deepcopy(scene)}[how]()
        scene.box.bsdf.reflectance.value.requires_grad_()
    renderer = rb.Renderer(scene, **SETTINGS)
    with pytest.raises(RuntimeError, match=r"bsdf.reflectance.value' .* under torch.inference_mode\(\).*load the scene"):
        renderer(seed=1)
    with torch.no_grad():
        assert torch.equal(renderer(seed=1), rb.render(lit_room().to(scene.dtype), seed=1, **SETTINGS))


def test_rays_of_inference_mode_that_require_a_gradient_are_an_error():
    with torch.inference_mode():
        origins = torch.zeros(2, 3, requires_grad=True)
    with pytest.raises(RuntimeError, match=r"'origins' .* under torch.inference_mode\(\)"):
        rb.Renderer(lit_room(), **SETTINGS).radiance(origins, torch.ones(2, 3), seed=1)


def test_a_scene_of_inference_mode_has_the_gradients_of_parameters_that_are_given():
    with torch.inference_mode():
        scene = lit_room()
    name, found = "box.bsdf.reflectance.value", []
    for room in (scene, lit_room()):
        colour = torch.tensor([0.3, 0.5, 0.2], requires_grad=True)
        image = functional_call(rb.Renderer(room, **SETTINGS), {f"scene.{name}": colour}, kwargs={"seed": 1})
        found.append(torch.autograd.grad(image.sum(), colour)[0])
    assert torch.equal(*found) and found[0].abs().max() > 0


def test_what_inference_mode_rendered_first_has_gradients_outside():
    scene = lit_room()
    renderer, colour = rb.Renderer(scene, **SETTINGS), scene.box.bsdf.reflectance.value.requires_grad_()
    with torch.inference_mode():
        renderer(seed=1)
    renderer(seed=1).sum().backward()
    assert colour.grad.abs().max() > 0
