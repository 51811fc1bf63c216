"""Recipes with a network in the place of a bitmap: what stands where, what is written, what is refused."""

import pytest
import torch
from rich.console import Console

import torch_radbp as rb
from torch_radbp.training.recipe_file import read_recipe, write_recipe
from torch_radbp.training.recovery.checkpoint import FILE_NAME, load_checkpoint
from torch_radbp.training.recovery.network import wrapped
from torch_radbp.training.recovery.optimize import render_buffers
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.run import run

COLOUR = 'name = "paint.reflectance.value"\ninitial = 0.5\nbounds = [0.0, 1.0]'
NETWORK = """name = "picture.reflectance.data"
parametrisation = "network"
network = { waves = 8, frequency = 3.0, width = 16 }
bounds = [0.0, 0.9]"""


@pytest.fixture
def network_recipe(edit_recipe):
    return edit_recipe(COLOUR, NETWORK)


def test_a_network_stands_in_the_scene_and_its_weights_are_what_is_optimised(network_recipe):
    recovery = Recovery(read_recipe(network_recipe))
    parameter, texture = recovery.parameters[0], recovery.scene.picture.reflectance
    assert isinstance(texture, rb.NeuralTexture)
    assert parameter.raw is texture.module.weights and parameter.raw.shape == (16 * 17 + 16 * 17 + 3 * 17,)
    sum(buffer.sum() for buffer in render_buffers(recovery, 0)).backward()
    assert parameter.raw.grad.isfinite().all() and parameter.raw.grad.abs().max() > 0


@pytest.mark.parametrize("wrap_mode", ["repeat", "mirror", "clamp"])
def test_texels_are_what_the_network_says_where_the_bitmap_has_them(wrap_mode, folder, network_recipe):
    """A fine bitmap of the network's texels gives the image of the network, with a transform that leaves the unit square."""
    text = (folder / "scene.xml").read_text()
    bitmap = (f'<string name="filename" value="picture.png"/><string name="wrap_mode" value="{wrap_mode}"/><transform '
              'name="to_uv"><scale x="1.6" y="-2.3"/><rotate z="1" angle="20"/><translate x="-0.7" y="0.4"/></transform>')
    assert text.count('<string name="filename" value="picture.png"/>') == 1
    (folder / "scene.xml").write_text(text.replace('<string name="filename" value="picture.png"/>', bitmap))
    rb.save_image(folder / "picture.png", torch.rand(3, 96, 64))
    recovery = Recovery(read_recipe(network_recipe, ["render.spp=64", "render.max_depth=2"]))
    with torch.no_grad():
        network = render_buffers(recovery, 0)[0]
        recovery.parameters[0].settle(recovery.scene)
        texels = render_buffers(recovery, 0)[0]
        recovery.scene.picture.reflectance.data.copy_(recovery.scene.picture.reflectance.data.flip(0))
        upside_down = render_buffers(recovery, 0)[0]
    assert (texels - upside_down).abs().max() > 0.01
    # Between the centres of texels a bitmap is linear; at the seam of a repeated one it is smooth over a texel.
    assert (network - texels).abs().max() < 0.004
    assert (network - texels).abs().mean() < 5e-4


def test_wrapped_places_are_those_of_a_bitmap():
    place = torch.tensor([[-0.25, 0.25], [1.25, 2.75]])
    assert torch.equal(wrapped(place, "repeat"), torch.tensor([[0.75, 0.25], [0.25, 0.75]]))
    assert torch.equal(wrapped(place, "mirror"), torch.tensor([[0.25, 0.25], [0.75, 0.75]]))
    assert torch.equal(wrapped(place, "clamp"), torch.tensor([[0.0, 0.25], [1.0, 1.0]]))


def test_a_network_is_recovered_and_saved_as_a_bitmap(folder, network_recipe):
    scene = rb.load(folder / "scene.xml")
    with torch.no_grad():
        scene.picture.reflectance.data.copy_(torch.tensor([0.8, 0.3, 0.1]))
        rb.save_image(folder / "target.exr", rb.render(scene, spp=256, seed=1, max_depth=3, caster="brute")[0])
    overrides = ["steps=20", "optimizer.learning_rate=0.2", "render.spp=8", "report.spp=256"]
    summary, _ = run(network_recipe, overrides, folder / "run", False, Console(quiet=True))
    before, after = summary["images"][0]["rmse_before"], summary["images"][0]["rmse"]
    assert after < 0.5 * before
    for role in ("before", "recovered", "true"):
        assert (folder / "run" / "textures" / f"picture.reflectance.data_{role}.png").is_file()
    saved = rb.load(folder / "run" / "scene" / "scene.xml").picture.reflectance.data
    assert saved.shape == (4, 4, 3)
    assert saved.mean((0, 1))[0] > saved.mean((0, 1))[2]


def test_a_resumed_run_continues_the_network(folder, network_recipe):
    def weights(name, *overrides, resume=False):
        run(network_recipe, list(overrides), folder / name, resume, Console(quiet=True))
        return load_checkpoint(folder / name / FILE_NAME, 2**20)["parameters"]["picture.reflectance.data"]

    whole = weights("whole", "steps=4", "schedule.name=constant")
    weights("parts", "steps=2", "schedule.name=constant")
    assert torch.equal(whole, weights("parts", "steps=4", "schedule.name=constant", resume=True))


def test_another_seed_draws_other_weights_and_the_same_one_the_same(network_recipe):
    first, again, other = (Recovery(read_recipe(network_recipe, [f"parameters.0.network.seed={seed}"])).parameters[0]
                           for seed in (0, 0, 1))
    assert torch.equal(first.before, again.before) and torch.equal(first.before, first.value)
    assert not torch.equal(first.before, other.before)


def test_a_network_survives_writing_the_recipe(folder, network_recipe):
    recipe = read_recipe(network_recipe)
    (folder / "copy").mkdir()
    write_recipe(recipe, folder / "copy" / "recipe.toml")
    assert read_recipe(folder / "copy" / "recipe.toml", allow_outside=True) == recipe


def test_a_network_for_what_is_no_bitmap_is_refused(network_recipe):
    with pytest.raises(ValueError, match="bitmaps and grids, and parameter 'paint.reflectance.value' is the value of a"):
        Recovery(read_recipe(network_recipe, ["parameters.0.name=paint.reflectance.value"]))
