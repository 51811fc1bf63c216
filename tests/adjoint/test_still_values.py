"""Values of a material that nobody differentiates, beside others in the same table that somebody does."""

import pytest
import torch

import torch_radbp as rb
from tests.gradients import cotangent, unwarned_renderer
from tests.scenes import load, rectangle, rgb, sensor
from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.scene.packing.pack import pack

ROUGH = {"type": "roughconductor", "alpha": 0.3, "eta": 0.9, "k": 2.4, "specular_reflectance": 0.8}
ALPHA, REFLECTANCE = "{}.bsdf.alpha.value", "{}.bsdf.specular_reflectance.value"


def plates() -> rb.Scene:
    """Two plates of one appearance under a lamp, of which nothing is differentiated."""
    lamp = rectangle((0.3, 0.2, 5), 3.0, (0, 1, 0), 180, emitter={"type": "area", "radiance": rgb(4, 5, 6)})
    scene = load(torch.float32, eye=sensor(12), lamp=lamp,
                 left=rectangle((-0.5, 0, 0), 0.5, (0, 1, 0), 20, bsdf=ROUGH),
                 right=rectangle((0.5, 0, 0), 0.5, (0, 1, 0), -20, bsdf=ROUGH | {"alpha": 0.2}))
    return scene.requires_grad_(False)


def still_of(scene: rb.Scene) -> tuple[bool, ...]:
    """Which values of the plates' material are still."""
    layout = pack(scene).layout
    kinds = [type(look.kind).__name__ for look in layout.appearances]
    return layout.still[kinds.index("RoughConductorKind")]


def gradients(renderer: rb.Renderer, *names: str) -> dict[str, torch.Tensor]:
    """Those of parameters that are differentiated from now on, by name."""
    wanted = [renderer.scene.get_parameter(name).requires_grad_() for name in names]
    image = renderer(seed=2)
    return dict(zip(names, torch.autograd.grad(image, wanted, cotangent(image.detach()))))


def test_values_are_still_if_they_are_so_in_all_materials_of_an_appearance():
    scene = plates()
    assert len(still_of(scene)) >= 4 and all(still_of(scene))
    scene.get_parameter(ALPHA.format("right")).requires_grad_()
    moving = still_of(scene).count(False)
    assert moving in (1, 2)  # one value, or one for each direction
    scene.get_parameter(REFLECTANCE.format("left")).requires_grad_()
    assert still_of(scene).count(False) == moving + 1


@pytest.mark.parametrize("inside", [False, True], ids=["bitmap", "colour of a checkerboard"])
def test_a_bitmap_that_moves_over_a_surface_is_not_still(inside):
    bitmap = {"type": "bitmap", "data": torch.rand(4, 4, 1), "raw": True}
    alpha = {"type": "checkerboard", "color0": bitmap, "color1": 0.3} if inside else bitmap
    scene = load(torch.float32, eye=sensor(12), sky={"type": "constant", "radiance": 1.0},
                 plate=rectangle((0, 0, 0), 1.0, (0, 1, 0), 20, bsdf=ROUGH | {"alpha": alpha}))
    scene.requires_grad_(False)
    assert all(still_of(scene))
    name, = [name for name, _ in scene.named_parameters() if name.endswith("to_uv")]
    scene.get_parameter(name).requires_grad_()
    assert not all(still_of(scene))


@pytest.mark.parametrize("compile", [True, False])
def test_gradients_are_the_same_whatever_else_is_differentiated(compile):
    few = gradients(unwarned_renderer(plates(), spp=4, compile=compile), ALPHA.format("left"))
    all_names = [name.format(side) for name in (ALPHA, REFLECTANCE) for side in ("left", "right")]
    many = gradients(unwarned_renderer(plates(), spp=4, compile=compile), *all_names)
    assert all(gradient.abs().max() > 0 for gradient in many.values())
    assert torch.equal(few[ALPHA.format("left")], many[ALPHA.format("left")])


def test_a_value_that_is_differentiated_later_has_its_gradient():
    renderer, reflectance = unwarned_renderer(plates(), spp=4), REFLECTANCE.format("right")
    assert gradients(renderer, ALPHA.format("left"))[ALPHA.format("left")].abs().max() > 0
    expected = gradients(unwarned_renderer(plates(), spp=4), reflectance)[reflectance]
    assert expected.abs().max() > 0 and torch.equal(gradients(renderer, reflectance)[reflectance], expected)


def test_still_values_add_nothing(monkeypatch):
    numbers = []
    add = Gradients.add

    def watched(self, contributions):
        own = list(contributions)
        numbers.append(len(own))
        add(self, own)

    monkeypatch.setattr(Gradients, "add", watched)
    settings = {"spp": 1, "max_depth": 2, "compile": False}
    gradients(unwarned_renderer(plates(), **settings), ALPHA.format("left"))
    few, numbers[:] = max(numbers), []
    gradients(unwarned_renderer(plates(), **settings), ALPHA.format("left"), REFLECTANCE.format("left"))
    assert 0 < few < max(numbers)
