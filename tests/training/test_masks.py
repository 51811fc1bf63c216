"""Masks: what a target's mask leaves out counts nowhere, what it holds half counts half."""

import numpy as np
import OpenEXR
import pytest
import torch
from rich.console import Console

import torch_radbp as rb
from torch_radbp.formats.image import read_image, save_image
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recipe_loss import L1, L2, SSIM, MultiScaleSSIM, TwoBufferL2
from torch_radbp.training.recovery.losses import Objective
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.run import run


@pytest.fixture
def masked(folder, edit_recipe):
    """The recipe with a target whose left half is nonsense, and a mask that leaves it out."""
    scene = rb.load(folder / "scene.xml")
    image = rb.render(scene, spp=256, seed=123, max_depth=3, caster="brute")[0].detach()
    mask = torch.zeros(1, 6, 8)
    mask[..., 4:] = 1
    save_image(folder / "target.exr", torch.where(mask > 0, image, 5.0))
    save_image(folder / "mask.png", mask)
    return edit_recipe('image = "target.exr"', 'image = "target.exr"\nmask = "mask.png"')


def test_what_is_masked_counts_neither_in_losses_nor_in_reports(masked, folder):
    overrides = ["render.spp=16", "steps=30", "optimizer.learning_rate=0.1", "report.spp=256"]
    summary, _ = run(masked, overrides, folder / "run", False, Console(quiet=True))
    assert summary["parameters"][0]["largest_error"] < 0.05
    assert summary["images"][0]["rmse"] < 0.1, "5 instead of about 0.3 in half of the pixels would make it 3"
    assert read_image(folder / "run" / "images" / "camera_error.exr")[:, :4].max() == 0
    text = masked.read_text().replace('mask = "mask.png"\n', "")
    masked.write_text(text)
    summary, _ = run(masked, [*overrides, "steps=10", "report.spp=16"], folder / "without", False, Console(quiet=True))
    assert summary["parameters"][0]["largest_error"] > 0.2


@pytest.mark.parametrize("spec", [TwoBufferL2(name="two_buffer_l2"), L1(name="l1"), L2(name="l2")])
def test_a_soft_mask_weighs_the_errors_of_pixels(spec):
    image, target = torch.rand(2, 2, 3, 5, 4, generator=torch.Generator().manual_seed(0)).unbind()
    mask = torch.rand(2, 1, 5, 4, generator=torch.Generator().manual_seed(1))
    error = (image - target).abs() if spec.name == "l1" else (image - target) ** 2
    expected = (mask * error).sum() / (3 * mask.sum())
    assert expected > 0.1
    torch.testing.assert_close(Objective([spec])((image, image), target, mask)[0], expected)


@pytest.mark.parametrize("spec", [SSIM(name="ssim"), MultiScaleSSIM(name="ms_ssim")])
def test_windows_do_not_see_what_is_masked(spec):
    target = torch.rand(1, 3, 24, 24, generator=torch.Generator().manual_seed(0))
    mask = torch.zeros(1, 1, 24, 24)
    mask[..., :12] = 1
    images = [target + (1 - mask) * size for size in (3.0, 7.0)]
    objective = Objective([spec])
    assert objective((images[0], images[0]), target)[0] > 0.05
    for image in images:
        assert objective((image, image), target, mask)[0].item() == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(("mask", "message"), [
    (torch.ones(1, 8, 6), "mask.png is 6 x 8 pixels, but its target is 8 x 6"),
    (torch.zeros(1, 6, 8), "mask.png is black"),
])
def test_a_mask_that_does_not_fit_is_named(mask, message, masked, folder):
    save_image(folder / "mask.png", mask)
    with pytest.raises(ValueError, match=message):
        Recovery(read_recipe(masked))


def test_a_target_may_be_nan_where_its_mask_is_zero(masked, folder):
    """As renderers write where nothing is; save_image refuses NaN, they do not."""
    pixels = read_image(folder / "target.exr").numpy().copy()
    pixels[1, 2] = np.nan
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": pixels}).write(str(folder / "target.exr"))
    targets = Recovery(read_recipe(masked)).targets
    assert targets.images.isfinite().all() and targets.images[0, :, 1, 2].abs().max() == 0
    masked.write_text(masked.read_text().replace('mask = "mask.png"\n', ""))
    with pytest.raises(ValueError, match="target.exr has 3 values that are NaN or infinite; mend the image first, or give"):
        Recovery(read_recipe(masked))
