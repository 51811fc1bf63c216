"""A parameter that no image depends on is told once, and nobody is blamed where a gradient of 0 is as it should be."""

import copy
import pickle
import warnings

import numpy as np
import pytest
import torch
from torch import nn
from torch.func import functional_call
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.scenes import diffuse, load, rgb, sensor, texels
from torch_radbp.io.values.transform import translate

COLOUR = "ball.bsdf.reflectance.value"
AHEAD, AWAY = {"target": (0, 0, 0)}, {"target": (0, 0, 9)}
pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")


def view(size: int = 6, **attributes) -> dict:
    return sensor(size, (0, 0, 4), **AHEAD | attributes)


def ball(reflectance=0.5, lamp=3.0, **sensors) -> rb.Scene:
    """A ball under a lamp, on black; the colour of the ball requires a gradient."""
    colour = reflectance if isinstance(reflectance, dict) else rgb(*3 * (reflectance,))
    scene = load(torch.float32, **(sensors or {"sensor": view()}),
                 ball={"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": colour}},
                 lamp={"type": "point", "position": [0, 3, 3], "intensity": rgb(lamp, lamp, lamp)})
    for parameter in scene.ball.bsdf.parameters():
        parameter.requires_grad_()
    return scene


def renderer(scene: rb.Scene, **settings) -> rb.Renderer:
    return rb.Renderer(scene, **{"spp": 4, "max_depth": 3} | settings)


def loss(image: torch.Tensor) -> torch.Tensor:
    return (image - 1).square().mean()


def told(step, steps=range(4)) -> list[str]:
    """What is said while steps are taken."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for number in steps:
            step(number)
    return [str(each.message) for each in caught if issubclass(each.category, rb.ZeroGradientWarning)]


def far_away(scene: rb.Scene) -> rb.Scene:
    scene.ball.to_world.data[:3, 3] = torch.tensor([0.0, 0.0, 9.0])
    return scene


UNSEEN = {
    "the camera looks away": lambda: ball(sensor=view(**AWAY)),
    "the object is behind it": lambda: far_away(ball()),
    "the axes are OpenGL's": lambda: ball(sensor=view() | {"to_world": view()["to_world"] @ np.diag([-1.0, 1, -1, 1])}),
    "the lamp is off": lambda: ball(lamp=0.0),
    "two cameras look away": lambda: ball(one=view(**AWAY), two=view(**AWAY)),
}


@pytest.mark.parametrize("make", UNSEEN.values(), ids=UNSEEN)
def test_what_nothing_sees_is_told_once(make):
    look = renderer(make())
    messages = told(lambda step: loss(look(seed=step)).backward())
    assert len(messages) == 1
    assert messages[0].startswith(f"the gradient of `{COLOUR}` was exactly 0") and "out of view" in messages[0]


def test_it_is_told_where_the_backward_pass_was_called():
    with pytest.warns(rb.ZeroGradientWarning) as caught:
        loss(renderer(ball(sensor=view(**AWAY)))(seed=1)).backward()
    assert [each.filename for each in caught if each.category is rb.ZeroGradientWarning] == [__file__]


def test_all_that_nothing_sees_is_told_at_once():
    scene = ball(sensor=view(**AWAY))
    scene.ball.to_world.requires_grad_()
    look = renderer(scene)
    message, = told(lambda step: loss(look(seed=step)).backward())
    assert f"`{COLOUR}` and `ball.to_world`" in message or f"`ball.to_world` and `{COLOUR}`" in message


def test_a_colour_that_is_seen_beside_one_that_is_not():
    scene = load(torch.float32, sensor=view(), ball={"type": "sphere", "bsdf": diffuse(0.5, 0.5, 0.5)},
                 other={"type": "sphere", "to_world": translate((0, 0, 9)), "bsdf": diffuse(0.5, 0.5, 0.5)},
                 lamp={"type": "point", "position": [0, 3, 3], "intensity": rgb(3, 3, 3)})
    for name in (COLOUR, "other.bsdf.reflectance.value"):
        scene.get_parameter(name).requires_grad_()
    look = renderer(scene, max_depth=2)
    message, = told(lambda step: loss(look(seed=step)).backward())
    assert "`other.bsdf.reflectance.value` was" in message


def test_torch_autograd_grad_is_told_too():
    scene = ball(sensor=view(**AWAY))
    look = renderer(scene)
    assert len(told(lambda step: torch.autograd.grad(loss(look(seed=step)), scene.get_parameter(COLOUR)))) == 1


def test_a_value_that_is_handed_over_is_told_too():
    network, look = nn.Linear(2, 3), renderer(ball(sensor=view(**AWAY)).requires_grad_(False))

    def step(number):
        colour = network(torch.ones(2)).sigmoid()
        loss(functional_call(look, {f"scene.{COLOUR}": colour}, kwargs={"seed": number})).backward()

    message, = told(step)
    assert COLOUR in message and network.weight.grad.abs().max() == 0


@pytest.mark.parametrize("adjoint", [rb.TapeAdjoint(), rb.ReplayAdjoint(), rb.QuadraticAdjoint()], ids=repr)
def test_every_strategy_is_watched(adjoint):
    look = renderer(ball(lamp=0.0), adjoint=adjoint)
    assert len(told(lambda step: loss(look(seed=step)).backward())) == 1
    look = renderer(ball(), adjoint=adjoint)
    assert told(lambda step: loss(look(seed=step)).backward()) == []


def test_rays_that_meet_nothing_are_told_after_a_hundred_calls():
    """Which rays there are beside those of a call is not known."""
    look, directions = renderer(ball(), compile=False, max_depth=2, spp=1), torch.tensor([[0.0, 0, 1], [0, 1, 1]])

    def step(number):
        loss(look.radiance(torch.tensor([0.0, 0, 4]).expand(2, 3), directions, seed=number)).backward()

    assert told(step, range(99)) == []
    assert len(told(step, range(99, 102))) == 1


def test_a_camera_that_sees_nothing_is_told_by_its_own_views():
    scene = ball(one=view(), two=view(**AWAY), three=view()).requires_grad_(False)
    for name in ("one", "two", "three"):
        scene.get_parameter(f"{name}.x_fov").requires_grad_()
    look = renderer(scene)
    message, = told(lambda step: loss(look(seed=step, sensors=("one", "two")[step])).backward(), range(2))
    assert message.startswith("the gradient of `two.x_fov` was")


# Where 0 is as it should be.

def one_of_two(sees_first: bool):
    look, order = renderer(ball(one=view(), two=view(**AWAY))), ("two", "one") if not sees_first else ("one", "two")
    return lambda step: loss(look(seed=step, sensors=order[step % 2])).backward()


def views_added_up():
    look = renderer(ball(one=view(), two=view(**AWAY)))
    return lambda step: sum(loss(look(seed=step, sensors=name)) for name in ("two", "one")).backward()


def of_one_image():
    """The loss of a call for both views uses the one that does not see it, then the other."""
    look = renderer(ball(one=view(), two=view(**AWAY)))
    return lambda step: loss(look(seed=step)[1 - step % 2]).backward()


def no_derivative():
    look = renderer(ball(sensor=view(**AWAY)))
    return lambda step: (0 * look(seed=step)).sum().backward()


def at_the_optimum():
    """L1 and the same noise: of the ball, not of the sky, all residuals are 0."""
    scene = ball()
    look = renderer(scene, share_samples=True)
    target = look(seed=1).detach()
    target[target == 0] = 0.5
    return lambda step: (look(seed=1) - target).abs().sum().backward()


def masked():
    look = renderer(ball())
    mask = torch.zeros(6, 6)
    mask[0, 0] = 1
    return lambda step: (mask * (look(seed=step) - 1)).square().sum().backward()


def of_windows():
    look = renderer(ball())
    return lambda step: loss(look(seed=step, window=(step % 2, 0, 1, 1))).backward()


def partly_used():
    look = renderer(ball({"type": "bitmap", "data": texels(64, 64)}))
    return lambda step: loss(look(seed=step)).backward()


class Dead(nn.Module):
    """A network whose first layer has no gradient until the second, which begins with zeros, has been moved."""

    def __init__(self):
        super().__init__()
        self.first, self.second = nn.Linear(2, 4), nn.Linear(4, 3)
        nn.init.zeros_(self.second.weight)

    def forward(self, uv):
        return self.second(self.first(uv)).sigmoid()


def network():
    scene = ball()
    scene.ball.bsdf.reflectance = Dead()
    look = renderer(scene)
    return lambda step: loss(look(seed=step)).backward()


def parametrised():
    class Blend(nn.Module):
        def __init__(self):
            super().__init__()
            self.unused = nn.Parameter(torch.ones(3))

        def forward(self, value):
            return value + 0 * self.unused

    scene = ball()
    parametrize.register_parametrization(scene.ball.bsdf.reflectance, "value", Blend(), unsafe=True)
    look = renderer(scene)
    return lambda step: loss(look(seed=step)).backward()


def by_a_regulariser():
    scene = ball(sensor=view(**AWAY))
    look = renderer(scene)
    return lambda step: (loss(look(seed=step)) + scene.get_parameter(COLOUR).sum()).backward()


def images_asked_for_only():
    look = renderer(ball(sensor=view(**AWAY)))

    def step(number):
        image = look(seed=number)
        torch.autograd.grad(loss(image), image)

    return step


RIGHT = {"one of two views, first": lambda: one_of_two(True), "one of two views, last": lambda: one_of_two(False),
         "views added up": views_added_up, "a loss without derivative": no_derivative, "an optimum": at_the_optimum,
         "a mask": masked, "windows": of_windows, "a bitmap that is used in part": partly_used,
         "a layer of a network": network, "a parametrisation": parametrised, "a regulariser": by_a_regulariser,
         "the image's derivative": images_asked_for_only, "one image of a call": of_one_image}


@pytest.mark.parametrize("make", RIGHT.values(), ids=RIGHT)
def test_nobody_is_blamed_where_zero_is_right(make):
    assert told(make()) == []


def test_a_mask_that_never_shows_it_is_told_after_ten_rounds():
    assert len(told(masked(), range(10))) == 1 and told(masked(), range(9)) == []


def test_one_of_several_sensors_that_alone_is_rendered_is_told_after_ten_rounds():
    look = renderer(ball(one=view(), two=view(**AWAY)))
    step = lambda number: loss(look(seed=number, sensors="two")).backward()  # noqa: E731
    assert told(step, range(19)) == [] and len(told(step, range(19, 22))) == 1


def test_once_all_is_seen_nothing_is_hooked_any_more():
    look = renderer(ball())
    loss(look(seed=0)).backward()
    image = look(seed=1)
    assert not image._backward_hooks and not look.gradient_watch.passes and look.gradient_watch.seen == {COLOUR}


def test_no_hook_is_left_on_a_parameter(tmp_path):
    scene = ball(sensor=view(**AWAY))
    look, colour = renderer(scene), scene.get_parameter(COLOUR)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(rb.ZeroGradientWarning):
            loss(look(seed=0)).backward()
        assert not colour._backward_hooks and not look.gradient_watch.passes
        copies = copy.deepcopy(look), pickle.loads(pickle.dumps(look))
    assert all(not other.gradient_watch.told for other in copies)
