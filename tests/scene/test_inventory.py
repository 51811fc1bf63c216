"""What a rendering finds unchanged at once: the attributes of modules, the kinds of tensors, and parts that hang on them."""

import pytest
import torch
from torch import nn
from torch.nn.utils import parametrize

from tests.scenes.one_of_each import Half, scene_of
from torch_radbp.plugin import Texture
from torch_radbp.scene.cache.inventory import Inventory
from torch_radbp.scene.cache.pack_cache import PackCache

CHANGES = {
    "plain value": lambda scene: setattr(scene.lamp, "flip_normals", True),
    "parameter replaced": lambda scene: setattr(scene.ball, "to_world", nn.Parameter(scene.ball.to_world.clone(), False)),
    "data of another dtype": lambda scene: setattr(scene.ball.to_world, "data", scene.ball.to_world.data.float()),
    "data of another shape": lambda scene: setattr(scene.sky.data, "data", scene.sky.data.data[:2]),
    "gradient wanted": lambda scene: scene.spot.intensity.value.requires_grad_(),
    "object removed": lambda scene: scene._modules.pop("ball"),
    "object exchanged": lambda scene: setattr(scene.hills.bsdf, "reflectance", scene.ball.bsdf.specular_reflectance),
    "new attribute": lambda scene: scene.hills.add_attribute("vertex_x", torch.ones(len(scene.hills.vertex_positions), 1,
                                                                                    dtype=torch.float64)),
    "stray tensor": lambda scene: vars(scene.hills).__setitem__("vertex_position", torch.ones(3)),
    "parametrisation": lambda scene: parametrize.register_parametrization(scene.hills, "vertex_positions", Half()),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_an_inventory_holds_until_something_else_than_a_number_changes(change):
    scene = scene_of()
    inventory = Inventory(scene)
    assert inventory.lasts and inventory.holds(scene)
    scene.hills.vertex_positions.data.mul_(0.9)
    assert inventory.holds(scene) and not inventory.holds(scene_of())
    change(scene)
    assert not inventory.holds(scene)
    assert Inventory(scene).holds(scene)


def test_a_scene_has_an_inventory_without_its_sensors():
    scene = scene_of()
    own, camera = Inventory(scene), Inventory(scene.camera)
    scene.camera.far_clip = 3.0
    assert own.holds(scene) and not camera.holds(scene.camera)


def test_geometry_is_reached_without_the_material_of_a_shape():
    scene = scene_of()
    reach = Inventory(scene).reach((scene.hills,))
    assert id(scene.hills.vertex_positions) in reach
    assert not {id(parameter) for parameter in scene.hills.bsdf.parameters()} & reach


class Steps(nn.Module):
    """A module that computes with a list."""

    def __init__(self):
        super().__init__()
        self.levels = [0.2, 0.7]

    def forward(self) -> torch.Tensor:
        return torch.tensor(self.levels, dtype=torch.float64)[:, None, None].expand(-1, 1, 3)


class Stepped(Texture):
    """A table that such a module computes."""

    wrap_mode, filter_type = "repeat", "nearest"

    def __init__(self):
        super().__init__()
        self.steps = Steps()

    def texels(self) -> torch.Tensor:
        return self.steps()


def test_what_a_module_computes_that_has_a_list_is_asked_for_each_time():
    scene, kept, made = scene_of(), PackCache(), []
    scene.hills.bsdf.reflectance = texture = Stepped()

    def texels(cache: PackCache, texture: Texture) -> torch.Tensor:
        made.append(texture.texels())
        return made[-1]

    for _ in range(2):
        reach = kept.inventory(scene).reach((texture,))
        kept.part("texels", texels, scene, reach, texture)
        texture.steps.levels[0] += 0.1
        kept = PackCache(kept.close())
    assert len(made) == 2 and not torch.equal(*made)


def test_a_part_is_made_again_when_what_it_reaches_has_other_bits():
    scene, kept, made = scene_of(), PackCache(), []
    ball = scene.ball

    def largest(cache: PackCache, ball: nn.Module) -> float:
        made.append(float(ball.to_world.detach().max()))
        return made[-1]

    def number_after(change) -> int:
        nonlocal kept
        change()
        kept.part("largest", largest, scene, kept.inventory(scene).reach((ball,)), ball)
        kept = PackCache(kept.close())
        return len(made)

    assert number_after(lambda: None) == number_after(lambda: scene.hills.vertex_positions.data.mul_(0.9)) == 1
    assert number_after(lambda: ball.to_world.data.mul_(2.0)) == 2 == number_after(lambda: None)
    assert made[1] == 2 * made[0] != 0
    ball.to_world.requires_grad_()
    assert number_after(lambda: None) == 3 and number_after(lambda: None) == 4  # an optimiser may change it
