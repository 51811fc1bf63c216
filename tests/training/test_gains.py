"""Gains: unknown exposures of views are recovered beside the scene, and everything shows images as they were exposed."""

import pytest
import torch
from rich.console import Console

import torch_radbp as rb
from torch_radbp.formats.image import read_image, save_image
from torch_radbp.training.commands.optimize import recovered_table
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.optimize import render_buffers
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.run import run

GAINS = torch.tensor([1.0, 0.6])
OVERRIDES = ["render.spp=16", "optimizer.learning_rate=0.08", "steps=100", "report.spp=256"]


@pytest.fixture
def exposed(two_views, folder):
    """The recipe of two views, whose second photograph is darker: images as the scene really looks."""
    scene = rb.load(folder / "scene.xml")
    images = rb.render(scene, spp=256, seed=123, max_depth=3, caster="brute").detach()
    assert images.mean() > 0.1
    for name, gain, image in zip(("camera", "aside"), GAINS, images):
        save_image(folder / f"{name}.exr", gain * image)
    text = two_views.read_text()
    for name in ("camera", "aside"):
        text = text.replace(f'image = "target.exr"\nsensor = "{name}"', f'image = "{name}.exr"\nsensor = "{name}"')
    two_views.write_text(text)
    return two_views


def test_gains_are_recovered_beside_reflectances(exposed, folder):
    with exposed.open("a") as file:
        file.write('[gains]\nfixed = "camera"\ntruth = [1.0, 0.6]\n')
    overrides = [*OVERRIDES, "render.spp=32", "optimizer.learning_rate=0.12", "steps=60"]
    summary, report = run(exposed, overrides, folder / "run", False, Console(quiet=True))
    paint, gains = summary["parameters"]
    assert gains["name"] == "gains" and gains["before"] == [1.0, 1.0]
    assert gains["recovered"][0] == 1.0, "the gain of the fixed view stays what it is"
    assert gains["largest_error"] < 0.02 and paint["largest_error"] < 0.05
    assert summary["images"][1]["rmse"] < 0.1 * summary["images"][1]["rmse_before"]
    after = read_image(folder / "run" / "images" / "aside_after.exr").mean().item()
    photograph = read_image(folder / "aside.exr").mean().item()
    assert after == pytest.approx(photograph, rel=0.03), "pictures are exposed as photographs"
    console = Console(width=100, record=True, file=open("/dev/null", "w"))
    console.print(recovered_table(summary))
    assert "gains" in console.export_text() and "gains" in report.read_text(encoding="utf-8")


def test_a_gain_multiplies_what_is_rendered(exposed):
    with exposed.open("a") as file:
        file.write("[gains]\ninitial = [1.0, 0.25]\n")
    plain = Recovery(read_recipe(exposed))
    plain.exposure = None
    shown, rendered = (render_buffers(recovery, 0)[0] for recovery in (Recovery(read_recipe(exposed)), plain))
    torch.testing.assert_close(shown, rendered * torch.tensor([1.0, 0.25]).view(2, 1, 1, 1))


def test_a_white_balance_gives_channels_gains_of_their_own(exposed, folder):
    balance = torch.tensor([1.2, 1.0, 0.8]).view(3, 1, 1)
    save_image(folder / "aside.exr", read_image(folder / "aside.exr").movedim(-1, 0) * balance)
    with exposed.open("a") as file:
        file.write('[gains]\nfixed = "camera"\nwhite_balance = true\n')
    summary, _ = run(exposed, OVERRIDES, folder / "run", False, Console(quiet=True))
    gains = torch.tensor(summary["parameters"][1]["recovered"]).view(2, 3)
    torch.testing.assert_close(gains[1], 0.6 * balance.flatten(), rtol=0.04, atol=0)
    assert torch.equal(gains[0], torch.ones(3))


@pytest.mark.deep
def test_without_gains_a_photograph_that_is_darker_makes_the_scene_dark(exposed, folder):
    """That the tests above can fail."""
    summary, _ = run(exposed, OVERRIDES, folder / "run", False, Console(quiet=True))
    assert summary["parameters"][0]["largest_error"] > 0.08
