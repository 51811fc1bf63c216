"""`Scene.clamp_`: every parameter is brought into its own range, and nothing else is touched."""

import math

import pytest
import torch
from torch import nn
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.scenes import cornell, diffuse, load, rectangle, rgb, sensor, texels
from tests.scenes.everything import EVERYTHING, build_everything
from torch_radbp.scene.modules.bounds import range_of
from torch_radbp.scene.modules.parameters import held_values

GREEN = "green.reflectance.value"


def room() -> rb.Scene:
    return cornell(torch.float32, 4)


def render(scene: rb.Scene) -> torch.Tensor:
    return rb.render(scene, spp=1, max_depth=2, seed=0)


@pytest.mark.parametrize("name", EVERYTHING)
def test_every_parameter_of_every_plugin_is_brought_inside(name):
    """From both sides; what was inside keeps its bits."""
    scene = build_everything(name, torch.float32)
    ranged = {each: held for each, held in held_values(scene).items() if held.attribute in held.owner._parameters
              and range_of(held.domains, True) != (-math.inf, math.inf)}
    before = {each: value.clone() for each, value in scene.named_parameters()}
    scene.requires_grad_().clamp_()
    assert len(ranged) > 2
    for each, held in ranged.items():
        assert torch.equal(held.value, before[each].clamp(*range_of(held.domains, True))), each
    for each, held in ranged.items():
        for end, beyond in zip(range_of(held.domains, True), (-1, 1)):
            if not math.isfinite(end):
                continue
            kept = held.value.detach().clone()
            held.value.data.fill_(end + beyond * max(1, abs(end)))
            scene.clamp_(each)
            assert torch.equal(held.value, torch.full_like(kept, end)), each
            for domain in held.domains:
                domain.check(each, held.value)
            held.value.data.copy_(kept)


def test_the_message_of_a_value_out_of_range_names_what_mends_it():
    scene = room()
    scene.get_parameter(GREEN).data[1] = -0.2
    with pytest.raises(ValueError, match=r"'green.reflectance.value' must be at least 0, got -0.2; .* scene.clamp_\(\) "
                                         r"after each step, rb.optim.bounded\(optimizer, scene\)"):
        render(scene)
    assert scene.clamp_() is scene
    assert scene.get_parameter(GREEN)[1] == 0 and torch.isfinite(render(scene)).all()


def test_a_list_leaves_the_others():
    scene = room()
    colours = [scene.get_parameter(f"{name}.reflectance.value") for name in ("green", "red", "white")]
    for colour in colours:
        colour.data.fill_(-1)
    scene.clamp_([GREEN, "red.reflectance.value"])
    assert [float(colour.sum()) for colour in colours] == [0, 0, -3]
    with pytest.raises(AttributeError, match="no parameter 'gren.reflectance.value'; did you mean 'green.refl"):
        scene.clamp_(["gren.reflectance.value"])


def test_a_frozen_reflectance_above_one_stays_unless_it_is_named():
    scene = room()
    green, red = (scene.get_parameter(f"{name}.reflectance.value") for name in ("green", "red"))
    green.data.fill_(1.5)
    red.requires_grad_().data.fill_(1.5)
    scene.clamp_()
    assert (green == 1.5).all() and (red == 1).all()
    scene.clamp_(GREEN)
    assert (green == 1).all()


def test_what_is_not_finite_is_left_for_the_rendering_to_tell():
    scene = room()
    green, red = (scene.get_parameter(f"{name}.reflectance.value").data for name in ("green", "red"))
    green.copy_(torch.tensor([math.nan, -1, 2]))
    red.copy_(torch.tensor([math.inf, -math.inf, -1]))
    scene.clamp_([GREEN, "red.reflectance.value"])
    assert green.isnan().sum() == 1 and red.isinf().sum() == 2 and red[2] == 0
    with pytest.raises(ValueError, match="NaN or infinite"):
        render(scene)


def test_ends_that_are_not_in_a_range_are_kept_away_from():
    scene = load(torch.float32, sensor=sensor(4), sky={"type": "constant"},
                 pane=rectangle((0, 0, 0), bsdf={"type": "thindielectric", "int_ior": 1.5}))
    fov, eta = scene.sensor.x_fov.data, scene.pane.bsdf.eta.data
    for value, expected in ((-5.0, 0.18), (400.0, 179.82)):
        fov.fill_(value), eta.fill_(-1.0)
        scene.clamp_()
        assert float(fov) == pytest.approx(expected, rel=1e-5) and float(eta) == pytest.approx(1e-3)
        assert torch.isfinite(render(scene)).all()


class Shifted(nn.Module):
    def forward(self, value):
        return value + 1

    def right_inverse(self, value):
        return value - 1


class Doubled(nn.Module):
    def forward(self, value):
        return 2 * value


def test_a_parametrisation_takes_the_value_over():
    scene = room()
    parametrize.register_parametrization(scene.green.reflectance, "value", Shifted())
    original = scene.green.reflectance.parametrizations.value.original
    original.requires_grad_().data.copy_(torch.tensor([-1.5, -0.5, 0.5]))
    scene.clamp_()
    torch.testing.assert_close(original.detach(), torch.tensor([-1.0, -0.5, 0.0]))
    assert scene.green.reflectance.parametrizations.value.original is original and original.requires_grad


def test_a_parametrisation_within_its_range_is_not_touched():
    scene = room()
    parametrize.register_parametrization(scene.green.reflectance, "value", rb.optim.Sigmoid())
    original = scene.green.reflectance.parametrizations.value.original
    original.data.fill_(20.0)
    scene.clamp_()
    assert (original == 20).all()


def test_a_parametrisation_that_cannot_take_the_value_over_is_told():
    scene = room()
    parametrize.register_parametrization(scene.green.reflectance, "value", Doubled(), unsafe=True)
    scene.clamp_()
    scene.green.reflectance.parametrizations.value.original.data.fill_(-1)
    with pytest.raises(RuntimeError, match="'green.reflectance.value' is out of its range, and Doubled.* no right_inverse"):
        scene.clamp_()


def test_a_parameter_that_two_share_is_brought_into_both_ranges():
    colour = nn.Parameter(torch.tensor([0.5, 3.0, -1.0]))
    scene = load(torch.float32, sensor=sensor(4), wall=rectangle((0, 0, 0), bsdf=diffuse(0.5, 0.5, 0.5)),
                 lamp={"type": "point", "position": [0, 0, 2], "intensity": rgb(1, 1, 1)})
    scene.wall.bsdf.reflectance.value = scene.lamp.intensity.value = colour
    scene.clamp_()
    assert torch.equal(colour, torch.tensor([0.5, 1.0, 0.0])) and scene.lamp.intensity.value is colour


def test_bitmaps_and_sensors_of_a_batch_are_reached():
    bitmap = {"type": "bitmap", "data": texels(3, 2), "raw": True}
    scene = load(torch.float32, one=sensor(4), two=sensor(4), sky={"type": "constant"},
                 wall=rectangle((0, 0, 0), bsdf={"type": "diffuse", "reflectance": bitmap}))
    scene.wall.bsdf.reflectance.data.requires_grad_().data.sub_(0.5).mul_(4)
    scene.two.x_fov.data.fill_(200)
    scene.clamp_()
    found = scene.wall.bsdf.reflectance.data
    assert found.min() == 0 and found.max() == 1 and 0 < found.mean() < 1 and scene.two.x_fov < 180


def test_a_value_that_is_computed_by_something_else_is_told():
    scene = room()
    source = torch.full((3,), -1.0, requires_grad=True)

    scene.green.reflectance._parameters["value"] = 2 * source
    with pytest.raises(RuntimeError, match="'green.reflectance.value' is computed from other tensors"):
        scene.clamp_()
