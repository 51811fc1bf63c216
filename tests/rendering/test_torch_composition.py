"""The renderer among other torch modules: parameters that are functions of others, optimisers, copies, files."""

import copy
import io
import pickle

import kornia
import pytest
import torch
from torch import nn
from torch.func import functional_call
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.gradients import cotangent, image_and_gradients, relative_error
from tests.scenes import CASES, cornell, parameters, textured

SETTINGS = {"spp": 2, "max_depth": 3}


def test_functional_call_carries_the_gradient_to_its_input():
    image, (expected,) = image_and_gradients(cornell(), ["green.reflectance.value"], seed=0, **SETTINGS)
    renderer = rb.Renderer(cornell(), **SETTINGS)
    name = "scene.green.reflectance.value"
    x = renderer.get_parameter(name).detach().clone().requires_grad_()
    rendered = functional_call(renderer, {name: x}, kwargs={"seed": 0})
    assert torch.equal(rendered.detach(), image)
    gradient, = torch.autograd.grad(rendered, x, cotangent(image))
    assert expected.abs().max() > 0 and torch.equal(gradient, expected)
    other = functional_call(renderer, {name: torch.zeros(3, dtype=torch.float64)}, kwargs={"seed": 0})
    assert relative_error(other, image) > 1e-3
    assert torch.equal(renderer(seed=0), image)  # the module itself is as before


class Squash(nn.Module):
    """Keeps reflectances in (0, 1)."""

    def forward(self, x):
        return torch.sigmoid(x)

    def right_inverse(self, y):
        return torch.logit(y)


@pytest.mark.parametrize("build, plugin, name", [
    (cornell, "white.reflectance", "value"), (textured, "floor.bsdf.reflectance", "data")])
def test_parametrize_carries_the_gradient_to_the_original(build, plugin, name):
    image, (expected,) = image_and_gradients(build(), [f"{plugin}.{name}"], **SETTINGS)
    scene = build()
    texture = scene.get_submodule(plugin)
    parametrize.register_parametrization(texture, name, Squash())
    original = texture.parametrizations[name].original.requires_grad_()
    rendered = rb.Renderer(scene, **SETTINGS)(seed=3)
    assert relative_error(rendered.detach(), image) < 1e-12
    gradient, = torch.autograd.grad(rendered, original, cotangent(image))
    value = torch.sigmoid(original.detach())
    assert expected.abs().max() > 0
    assert relative_error(gradient, expected * value * (1 - value)) < 1e-12


def test_a_parametrisation_may_have_parameters_of_its_own():
    class Tint(nn.Module):
        def __init__(self):
            super().__init__()
            self.strength = nn.Parameter(torch.tensor(0.8, dtype=torch.float64))

        def forward(self, x):
            return self.strength * x

    image, (expected,) = image_and_gradients(cornell(), ["white.reflectance.value"], **SETTINGS)
    scene = cornell()
    white = scene.get_submodule("white.reflectance")
    colour = white.value.detach().clone()
    parametrize.register_parametrization(white, "value", Tint())
    with torch.no_grad():
        white.parametrizations.value.original.div_(0.8)
    strength = white.parametrizations.value[0].strength
    gradient, = torch.autograd.grad(rb.Renderer(scene, **SETTINGS)(seed=3), strength, cotangent(image))
    assert expected.abs().max() > 0
    assert relative_error(gradient, (expected * colour / 0.8).sum()) < 1e-12


def test_a_texture_may_come_out_of_a_network():
    torch.manual_seed(0)
    network = nn.Sequential(nn.Linear(2, 8), nn.Tanh(), nn.Linear(8, 3), nn.Sigmoid()).double()
    grid = torch.stack(torch.meshgrid(torch.linspace(0, 1, 4), torch.linspace(0, 1, 5), indexing="ij"), -1).double()
    renderer, name = rb.Renderer(textured(), **SETTINGS), "scene.floor.bsdf.reflectance.data"

    def image():
        return functional_call(renderer, {name: network(grid)}, kwargs={"seed": 1})

    scene = textured()
    scene.get_parameter("floor.bsdf.reflectance.data").data = network(grid).detach()
    rendered, (adj_data,) = image_and_gradients(scene, ["floor.bsdf.reflectance.data"], seed=1, **SETTINGS)
    expected = torch.autograd.grad(network(grid), list(network.parameters()), adj_data)
    gradients = torch.autograd.grad(image(), list(network.parameters()), cotangent(rendered))
    for gradient, wanted in zip(gradients, expected):
        assert wanted.abs().max() > 0 and relative_error(gradient, wanted) < 1e-12


def test_steps_of_adam_lower_an_ssim_loss():
    torch.manual_seed(0)
    settings = {"spp": 16, "max_depth": 3}
    target = rb.render(cornell(torch.float32, 12), seed=100, **settings)
    scene = cornell(torch.float32, 12)
    chosen = parameters(scene, ["white.reflectance.value", "red.reflectance.value", "green.reflectance.value"])
    for parameter in chosen:
        parameter.data.fill_(0.4)
    renderer, optimizer = rb.Renderer(scene, **settings), torch.optim.Adam(chosen, lr=0.05)
    losses = []
    for seed in range(8):
        optimizer.zero_grad()
        loss = kornia.losses.ssim_loss(renderer(seed=100 + seed % 2), target, 5)
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[0] > 0.01 and losses[6] < 0.7 * losses[0]


def test_changes_of_shapes_and_cameras_reach_the_next_image():
    scene = cornell()
    renderer = rb.Renderer(scene, **SETTINGS)
    first = renderer(seed=1)
    scene.get_parameter("light.to_world").data[0, 3] += 0.3
    moved = renderer(seed=1)
    assert relative_error(moved, first) > 1e-2
    fresh = rb.render(copy.deepcopy(scene), seed=1, **SETTINGS)
    assert torch.equal(moved, fresh)
    scene.get_parameter("sensor.to_world").data[0, 3] += 0.3
    assert relative_error(renderer(seed=1), moved) > 1e-2


@pytest.mark.parametrize("name", ["cornell", "two_sided", "sky_and_points"])
@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda scene: pickle.loads(pickle.dumps(scene))],
                         ids=["deepcopy", "pickle"])
def test_copies_render_the_same_and_are_independent(name, duplicate):
    scene = CASES[name].scene()
    parameters(scene, CASES[name].parameters)
    twin = duplicate(scene)
    assert [n for n, _ in twin.named_parameters()] == [n for n, _ in scene.named_parameters()]
    assert all(p.requires_grad == twin.get_parameter(n).requires_grad for n, p in scene.named_parameters())
    image = rb.render(scene, seed=1, **SETTINGS).detach()
    assert torch.equal(rb.render(twin, seed=1, **SETTINGS).detach(), image)
    for parameter in CASES[name].parameters:
        twin.get_parameter(parameter).data.mul_(0.5)  # a material that shapes share stays one material
    assert torch.equal(rb.render(scene, seed=1, **SETTINGS).detach(), image)
    changed = rb.render(twin, seed=1, **SETTINGS).detach()
    for parameter in CASES[name].parameters:
        scene.get_parameter(parameter).data.mul_(0.5)
    assert torch.equal(rb.render(scene, seed=1, **SETTINGS).detach(), changed)
    assert relative_error(changed, image) > 0.1


def test_a_renderer_can_be_copied_and_pickled_after_use():
    renderer = rb.Renderer(cornell(size=4), **SETTINGS)
    image = renderer(seed=1)
    for twin in (copy.deepcopy(renderer), pickle.loads(pickle.dumps(renderer))):
        assert torch.equal(twin(seed=1), image)


@pytest.mark.parametrize("name", ["cornell", "clamp_nearest", "two_sided", "sky_and_points"])
def test_a_state_dict_restores_the_scene(name):
    case = CASES[name]
    scene, other = case.scene(), case.scene()
    with torch.no_grad():
        for parameter in case.parameters:
            scene.get_parameter(parameter).mul_(0.7)
    image = rb.render(scene, seed=1, **SETTINGS)
    assert relative_error(rb.render(other, seed=1, **SETTINGS), image) > 0.1
    file = io.BytesIO()
    torch.save(scene.state_dict(), file)
    file.seek(0)
    assert not any(other.load_state_dict(torch.load(file)))
    assert torch.equal(rb.render(other, seed=1, **SETTINGS), image)


def test_the_dtype_of_a_scene_is_that_of_its_parameters():
    scene = cornell(torch.float32)
    assert rb.render(scene, **SETTINGS).dtype == torch.float32
    assert rb.render(scene.double(), **SETTINGS).dtype == torch.float64


def test_gradients_reach_a_float32_parameter_through_a_loss_with_its_mean():
    scene = cornell(torch.float32)
    white, = parameters(scene, ["white.reflectance.value"])
    image = rb.Renderer(scene, **SETTINGS)(seed=1)
    (image.mean() - 0.1).square().backward()
    assert white.grad.dtype == torch.float32 and white.grad.abs().min() > 0
