"""Networks as volumes: values at the centres of a grid's cells, with derivatives by their parameters."""

import pytest
import torch
from torch import nn

import torch_radbp as rb
from tests.gradients import image_and_gradients, relative_error
from tests.scenes import diffuse, load, overhead, rectangle, rgb
from torch_radbp.volume import neural
from torch_radbp.volume.gridvolume import GridVolume

RESOLUTION = (6, 5, 4)
SETTINGS = {"spp": 16, "max_depth": 4, "rr_depth": 2}
POSE = torch.tensor([[2.0, 0, 0, -1], [0, 2, 0, -1], [0, 0, 2, 0.5], [0, 0, 0, 1]])
OF_MODULE = [f"box.interior.sigma_t.module.{layer}.{name}" for layer in (0, 2) for name in ("weight", "bias")]


def network(outputs: int = 1, last: nn.Module | None = None) -> nn.Sequential:
    torch.manual_seed(outputs)
    return nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, outputs), nn.Softplus() if last is None else last).double()


def volume(module: nn.Module, resolution=RESOLUTION) -> rb.NeuralVolume:
    return rb.NeuralVolume(module, resolution, POSE).double()


def room(sigma_t, albedo=0.8) -> rb.Scene:
    """Smoke over a floor, under a sky and a lamp."""
    scene = load(torch.float64, camera=overhead(4, 4.0, 1.0), floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                 box={"type": "cube", "bsdf": {"type": "null"}, "to_world": POSE @ torch.tensor(
                     [[0.5, 0, 0, 0.5], [0, 0.5, 0, 0.5], [0, 0, 0.5, 0.5], [0, 0, 0, 1]]),
                      "interior": {"type": "heterogeneous", "sigma_t": {"type": "gridvolume", "data": torch.ones(2, 2, 2),
                                                                        "to_world": POSE}, "albedo": 0.8}},
                 bulb={"type": "point", "position": [0.5, 0.2, 3.5], "intensity": rgb(2, 3, 4)}, sky={"type": "constant"})
    scene.box.interior.sigma_t = sigma_t
    if not isinstance(albedo, float):
        scene.box.interior.albedo = albedo
    return scene


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_it_is_the_grid_of_its_values_and_passes_the_gradient_of_that_on(compile):
    of_network = volume(network())
    values = of_network.samples()
    assert values.shape == (4, 5, 6, 1) and values.std() > 0.01
    grid = GridVolume(data=torch.ones(4, 5, 6), to_world=POSE).double()
    grid.data = nn.Parameter(values.detach().clone(), requires_grad=False)
    settings = SETTINGS | {"compile": compile}
    image, (adj_values,) = image_and_gradients(room(grid), ["box.interior.sigma_t.data"], **settings)
    expected = torch.autograd.grad(values, list(of_network.module.parameters()), adj_values)
    same, gradients = image_and_gradients(room(of_network), OF_MODULE, **settings)
    assert relative_error(same, image) < 1e-12
    for gradient, wanted in zip(gradients, expected):
        assert wanted.abs().max() > 0 and relative_error(gradient, wanted) < 1e-10


def test_many_cells_are_evaluated_in_blocks(monkeypatch):
    whole = image_and_gradients(room(volume(network())), OF_MODULE, **SETTINGS)[1]
    monkeypatch.setattr(neural, "BLOCK", 50)
    for gradient, wanted in zip(image_and_gradients(room(volume(network())), OF_MODULE, **SETTINGS)[1], whole):
        assert wanted.abs().max() > 0 and relative_error(gradient, wanted) < 1e-10


def test_the_module_is_evaluated_once_for_a_rendering(monkeypatch):
    points, values_at = [], rb.NeuralVolume.values_at
    monkeypatch.setattr(rb.NeuralVolume, "values_at", lambda self, p: points.append(len(p)) or values_at(self, p))
    scene = room(volume(network()))
    rb.render(scene, **SETTINGS)
    assert points.count(6 * 5 * 4) == 1


def test_forward_mode_is_the_transpose_of_backward():
    scene, name, settings = room(volume(network())), OF_MODULE[0], SETTINGS | {"compile": False}
    tangent = torch.randn(8, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    adj_image = torch.rand(1, 3, 4, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    _, (gradient,) = image_and_gradients(scene, [name], seed=1, adj_image=adj_image, **settings)
    scene.requires_grad_(False)
    forward = (rb.jvp(scene, {name: tangent}, seed=1, **settings) * adj_image).sum()
    assert forward.abs() > 1e-6 and abs(forward - (gradient * tangent).sum()) < 1e-9 * forward.abs()


def test_albedo_may_be_a_network_of_colours_and_steps_change_the_image():
    scene = room(volume(network()), volume(network(3, nn.Sigmoid())))
    parameters = [scene.get_parameter(f"box.interior.albedo.module.{layer}.bias").requires_grad_() for layer in (0, 2)]
    renderer, optimizer = rb.Renderer(scene, compile=False, **SETTINGS), torch.optim.Adam(parameters, lr=0.2)
    means = []
    for _ in range(6):
        optimizer.zero_grad()
        loss = renderer(seed=1).mean()
        loss.backward()
        optimizer.step()
        means.append(float(loss))
    assert all(later < 0.9999 * earlier for earlier, later in zip(means, means[1:]))


@pytest.mark.parametrize("make, message", [
    (lambda: volume(network(1, nn.Identity())), "negative or not finite"),
    (lambda: volume(network(2)), r"must return \(120, 1\) or \(120, 3\)"),
    (lambda: volume(lambda p: p), "must be an nn.Module"),
    (lambda: volume(nn.LazyLinear(1)), "no shape before"),
    (lambda: volume(network(), 0), "resolution must be"),
    (lambda: volume(network(), (4, 4)), "resolution must be")])
def test_bad_modules_are_refused(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        rb.render(room(make()), spp=1)


def test_albedo_above_1_is_refused():
    with pytest.raises(ValueError, match="albedo"):
        rb.render(room(volume(network()), volume(network(1, nn.Softplus(beta=0.1)))), spp=1)


def test_a_file_has_no_networks(tmp_path):
    with pytest.raises(rb.SceneError, match="NeuralVolume cannot be written"):
        rb.save(room(volume(network())), tmp_path / "scene.xml")
