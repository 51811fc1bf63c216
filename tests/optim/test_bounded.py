"""Ordinary loops whose steps overshoot a range run on, and whatever an optimizer does not hold stays as it is."""

import copy

import pytest
import torch
from torch import nn
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, rgb, sensor, texels
from torch_radbp.optim import bounded

COLOUR = "wall.bsdf.reflectance.value"
STEPS = 12  # of 0.05 and more, from 0.1 towards 0: an overshoot by more than a rendering tolerates
pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.ZeroGradientWarning")


def scene_of(bsdf=None) -> rb.Scene:
    """A dark wall under a lamp."""
    scene = load(torch.float32, sensor=sensor(4), wall=rectangle((0, 0, 0), 2, bsdf=bsdf or diffuse(0.1, 0.9, 0.5)),
                 lamp={"type": "point", "position": [0, 0, 3], "intensity": rgb(9, 9, 9)})
    scene.wall.bsdf.requires_grad_()
    return scene


def adam(scene: rb.Scene, bounds: str, **settings) -> torch.optim.Optimizer:
    optimizer = torch.optim.Adam([each for each in scene.parameters() if each.requires_grad], lr=0.05, **settings)
    return bounded(optimizer, scene) if bounds == "bounded" else optimizer


def renderer_of(scene: rb.Scene) -> rb.Renderer:
    return rb.Renderer(scene, spp=4, max_depth=2)


def loss_of(image: torch.Tensor) -> torch.Tensor:
    """Least for a wall that is black in red, and more than white in green."""
    return (image - torch.tensor([-1.0, 20.0, 0.1])[:, None, None]).square().mean()


def step_of(optimizer, scene, bounds, loss) -> None:
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    if bounds == "clamp_":
        scene.clamp_()


def plain(scene, bounds):
    optimizer, look = adam(scene, bounds), renderer_of(scene)
    for step in range(STEPS):
        step_of(optimizer, scene, bounds, loss_of(look(seed=step)))


def averaged(scene, bounds):
    optimizer, look = adam(scene, bounds), renderer_of(scene)
    average = torch.optim.swa_utils.AveragedModel(look)
    for step in range(STEPS):
        step_of(optimizer, scene, bounds, loss_of(look(seed=step)))
        average.update_parameters(look)
        with torch.no_grad():
            average(seed=step)


def accumulated(scene, bounds):
    optimizer, look = adam(scene, bounds), renderer_of(scene)
    for step in range(STEPS):
        for part in range(2):
            (loss_of(look(seed=2 * step + part)) / 2).backward()
        optimizer.step()
        optimizer.zero_grad()
        if bounds == "clamp_":
            scene.clamp_()


def distributed(scene, bounds):
    torch.distributed.init_process_group("gloo", store=torch.distributed.HashStore(), rank=0, world_size=1)
    try:
        optimizer, look = adam(scene, bounds), nn.parallel.DistributedDataParallel(renderer_of(scene))
        for step in range(STEPS):
            step_of(optimizer, scene, bounds, loss_of(look(seed=step)))
    finally:
        torch.distributed.destroy_process_group()


def autocast(scene, bounds):
    optimizer, look = adam(scene, bounds), renderer_of(scene)
    for step in range(STEPS):
        with torch.autocast("cpu", dtype=torch.bfloat16):
            loss = loss_of(look(seed=step))
        step_of(optimizer, scene, bounds, loss)


def scheduled(scene, bounds):
    optimizer, look = adam(scene, bounds), renderer_of(scene)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 5 * STEPS)
    for step in range(STEPS):
        step_of(optimizer, scene, bounds, loss_of(look(seed=step)))
        schedule.step()


def with_closure(scene, bounds):
    optimizer, look = adam(scene, bounds, amsgrad=True), renderer_of(scene)
    for step in range(STEPS):
        def closure(step=step):
            optimizer.zero_grad()
            loss = loss_of(look(seed=step))
            loss.backward()
            torch.nn.utils.clip_grad_norm_(scene.parameters(), 1.0)
            return loss

        optimizer.step(closure)
        if bounds == "clamp_":
            scene.clamp_()


LOOPS = (plain, averaged, accumulated, distributed, autocast, scheduled, with_closure)


@pytest.mark.parametrize("loop", LOOPS, ids=lambda loop: loop.__name__)
@pytest.mark.parametrize("bounds", ["clamp_", "bounded"])
def test_a_loop_runs_to_its_end(loop, bounds):
    scene = scene_of()
    loop(scene, bounds)
    red, green, blue = scene.get_parameter(COLOUR).tolist()
    assert red == 0 and green == 1 and 0 < blue < 1


@pytest.mark.parametrize("loop", LOOPS, ids=lambda loop: loop.__name__)
def test_without_bounds_it_ends_with_an_error_that_names_them(loop):
    with pytest.raises(ValueError, match=r"must be at least 0, got -.*scene.clamp_\(\).*rb.optim.bounded\(optimizer, scen"):
        loop(scene_of(), "none")


def test_only_what_the_optimizer_holds_is_clamped():
    scene = scene_of()
    scene.lamp.intensity.value.data.fill_(-0.01)  # tolerated in a rendering
    optimizer = bounded(torch.optim.SGD([scene.get_parameter(COLOUR)], lr=1.0), scene)
    scene.get_parameter(COLOUR).grad = torch.ones(3)
    optimizer.step()
    assert (scene.get_parameter(COLOUR) == 0).all() and (scene.lamp.intensity.value < 0).all()


def test_what_is_added_to_the_optimizer_later_is_clamped_too():
    scene = scene_of()
    optimizer = bounded(torch.optim.SGD([scene.get_parameter(COLOUR)], lr=1.0), scene)
    intensity = scene.lamp.intensity.value.requires_grad_()
    optimizer.add_param_group({"params": [intensity]})
    intensity.grad = torch.full((3,), 100.0)
    optimizer.step()
    assert (intensity == 0).all()


class Offset(nn.Module):
    def forward(self, value):
        return value - 0.5

    def right_inverse(self, value):
        return value + 0.5


def test_a_parametrised_value_is_clamped():
    scene = scene_of()
    texture = scene.wall.bsdf.reflectance
    parametrize.register_parametrization(texture, "value", Offset())
    original = texture.parametrizations.value.original
    optimizer = bounded(torch.optim.SGD([original], lr=1.0), scene)
    original.grad = torch.tensor([0.05, -5.0, 0.0])
    optimizer.step()
    torch.testing.assert_close(texture.value.detach(), torch.tensor([0.05, 1.0, 0.5]))
    original.grad = torch.ones(3)
    optimizer.step()
    assert (texture.value == 0).all() and texture.parametrizations.value.original is original


def test_a_map_from_coarse_to_fine_is_clamped():
    scene = scene_of({"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels(8, 8), "raw": True}})
    texture = scene.wall.bsdf.reflectance
    parametrize.register_parametrization(texture, "data", rb.optim.CoarseToFine((2, 2)))
    grid = texture.parametrizations.data.original
    optimizer = bounded(torch.optim.SGD([grid], lr=1.0), scene)
    grid.grad = torch.full_like(grid, 0.5)
    optimizer.step()
    assert texture.data.min() == 0 and 0 < texture.data.max() < 0.5
    rb.render(scene, spp=1, max_depth=2, seed=0)


def test_a_parameter_that_is_not_finite_is_not_hidden():
    scene = scene_of()
    colour = scene.get_parameter(COLOUR)
    optimizer = bounded(torch.optim.SGD([colour], lr=1.0), scene)
    colour.grad = torch.tensor([float("nan"), 1.0, float("inf")])
    optimizer.step()
    assert colour[0].isnan() and colour[2].isinf()
    with pytest.raises(ValueError, match="NaN or infinite"):
        rb.render(scene, spp=1, max_depth=2, seed=0)


def test_the_optimizer_is_returned_and_can_be_saved():
    scene = scene_of()
    optimizer = torch.optim.Adam([scene.get_parameter(COLOUR)])
    assert bounded(optimizer, scene) is optimizer
    other = torch.optim.Adam([scene.get_parameter(COLOUR)])
    other.load_state_dict(copy.deepcopy(optimizer.state_dict()))


def test_an_optimizer_of_something_else_is_refused():
    with pytest.raises(ValueError, match="holds no parameter of this scene"):
        bounded(torch.optim.Adam(nn.Linear(2, 2).parameters()), scene_of())
