"""Standard deviations at the end of a run: by derivatives of the images at the recovered values, in table and report."""

import json
import math
import re

import pytest
import torch
from rich.console import Console

from torch_radbp.formats.image import read_image, save_image
from torch_radbp.optim.linearisation import Linearisation
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery import deviations
from torch_radbp.training.recovery.plain_values import plain_values
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.run import run

QUIET = Console(quiet=True)


@pytest.fixture(autouse=True)
def asked(edit_recipe):
    """The recipe as by default: with deviations where they cost little."""
    edit_recipe('deviations = "none"\n', "")


@pytest.fixture
def noisy(folder, edit_recipe):
    """The recipe with a target that is a rendering of its scene with noise of a tenth, and many samples."""
    edit_recipe("spp = 4\nmax_depth = 3", "spp = 64\nmax_depth = 3")
    image = Recovery(read_recipe(edit_recipe("initial = 0.5\n", "initial = [0.2, 0.5, 0.7]\n"))).renderer(seed=5, spp=512)[0]
    assert float(image.detach().mean()) > 0.05
    generator = torch.Generator().manual_seed(3)
    save_image(folder / "target.exr", image.detach() * (1 + 0.1 * torch.randn(image.shape, generator=generator)))
    return folder


def finished(folder, *overrides):
    """The summary of a run, and its report."""
    out = folder / f"run{len(list(folder.iterdir()))}"
    summary, report = run(folder / "recipe.toml", list(overrides), out, False, QUIET)
    return summary, report.read_text(encoding="utf-8")


def differences(images, leaves, step, spp=256):
    """J, (M, n) float64, by central differences with the same samples."""
    columns = []
    for leaf in leaves.values():
        for index in range(leaf.numel()):
            ends = []
            for sign in (1, -1):
                with torch.no_grad():
                    before = leaf.detach().clone()
                    leaf.view(-1)[index] += sign * step
                    ends.append(images(7, spp).double())
                    leaf.copy_(before)
            columns.append(((ends[0] - ends[1]) / (2 * step)).flatten())
    return torch.stack(columns, 1)


@pytest.mark.parametrize("parametrisation", ["clamp", "sigmoid"])
def test_deviations_are_those_of_values_whatever_the_optimizer_sees(parametrisation, noisy):
    overrides = [f"parameters.0.parametrisation='{parametrisation}'"]
    found = finished(noisy, *overrides)[0]["deviations"]
    assert found["computed"] and 0.005 < found["noise"] < 0.2 and found["flat"] == []
    assert found["names"] == [f"paint.reflectance.value[{index}]" for index in range(3)]
    recovery = Recovery(read_recipe(noisy / "recipe.toml", overrides))
    recovery.parameters[0].settle(recovery.scene)
    with torch.no_grad():
        recovery.parameters[0].raw.copy_(torch.tensor(found["values"]))
    with plain_values(recovery, recovery.parameters) as plain:
        jacobian = differences(plain.images, plain.leaves, 0.02)
    expected = torch.linalg.inv(jacobian.T @ jacobian).diag().sqrt() * found["noise"]
    assert expected.isfinite().all() and (expected > 0).all()
    # Derivatives of 64 samples and differences of 256 at 48 pixels: a few percent of noise.
    torch.testing.assert_close(torch.tensor(found["deviations"], dtype=torch.float64), expected, rtol=0.1, atol=0.0)


def test_poses_have_deviations_in_degrees_and_units(noisy):
    text = (noisy / "recipe.toml").read_text().replace("bounds = [0.0, 1.0]\n", "")
    (noisy / "recipe.toml").write_text(text.replace("initial = [0.2, 0.5, 0.7]\n", ""))
    recovery = Recovery(read_recipe(noisy / "recipe.toml", [
        "parameters.0.name='wall.to_world'", "parameters.0.parametrisation='rigid'",
        "parameters.0.initial={rotation=[0,10,0]}"]))  # fmt: skip
    recovery.parameters[0].settle(recovery.scene)
    before = recovery.scene.get_parameter("wall.to_world").detach().clone()
    with plain_values(recovery, recovery.parameters) as plain:
        names = [f"wall.to_world:{kind}[{axis}]" for kind in ("rotation", "translation") for axis in "xyz"]
        assert list(plain.leaves) == names and plain.leaves_of("wall.to_world") == plain.leaves
        for name, step in ((names[1], 2.0), (names[4], 0.04)):
            leaf = {name: plain.leaves[name]}
            found = Linearisation(plain.images, leaf.values()).jacobian(7, 1024)
            expected = differences(plain.images, leaf, step, 4096)
            assert expected.isfinite().all() and expected.norm() > 0
            # What edges do within a step of 2 degrees or 0.04 units, and noise, 1.3 % as measured.
            assert torch.nn.functional.cosine_similarity(found, expected, dim=0).item() > 0.98
            assert found.norm() / expected.norm() == pytest.approx(1.0, abs=0.05)
    assert torch.equal(recovery.scene.get_parameter("wall.to_world"), before)


def without_wall(folder):
    scene = (folder / "scene.xml").read_text()
    (folder / "scene.xml").write_text(re.sub(r'    <shape type="rectangle" id="wall">.*?</shape>\n', "", scene, count=1,
                                             flags=re.DOTALL))


def test_what_is_known_only_as_a_product_is_said(noisy, radbp):
    without_wall(noisy)
    with (noisy / "recipe.toml").open("a") as file:
        file.write('\n[[parameters]]\nname = "lamp.emitter.radiance.value"\n')
    code, stdout, stderr = radbp("optimize", "recipe.toml", "--out", "flat", "-D", "render.max_depth=2")
    assert code == 0, stderr
    words = "paint.reflectance.value[0] and lamp.emitter.radiance.value[0] only as a product"
    assert f"not told: {words}" in stdout and "+- not told not told not told" in stdout
    report = (noisy / "flat" / "report.html").read_text()
    assert words in report and "How far values are known" in report
    found = json.loads((noisy / "flat" / "summary.json").read_text())["deviations"]
    assert found["deviations"] == [None] * 6 and len(found["flat"]) == 3


def test_table_and_report_have_deviations_and_correlations(noisy, radbp):
    code, stdout, stderr = radbp("optimize", "recipe.toml", "--out", "run")
    assert code == 0, stderr
    found = json.loads((noisy / "run" / "summary.json").read_text())["deviations"]
    assert "+- " + " ".join(f"{each:.2g}" for each in found["deviations"]) in stdout
    assert f"pixel noise of {found['noise']:.2g}" in stdout
    assert "The run has not converged (too short)" in stdout
    report = (noisy / "run" / "report.html").read_text()
    matrix = re.search(r'<svg class="correlations".*?</svg>', report, re.DOTALL)[0]
    assert matrix.count("<rect") == 9 and matrix.count("+1.000") == 3
    assert found["seconds"] > 0 and f"± {found['deviations'][0]:.2g}" in report


def few_texels(folder):
    """Gives the wall a picture of 2 x 3 texels, the fewest that are shown as one."""
    save_image(folder / "picture.png", torch.rand(3, 2, 3, generator=torch.Generator().manual_seed(1)))


def test_texels_have_a_picture_of_deviations(noisy):
    few_texels(noisy)
    summary, report = finished(noisy, "parameters.0.name='picture.reflectance.data'", "parameters.0.initial=0.5",
                               "report.deviations='all'")
    found = summary["deviations"]
    assert found["computed"] and len(found["names"]) == 18 and None not in found["deviations"]
    assert found["maps"][0]["largest"] == pytest.approx(max(found["deviations"]))
    assert "standard deviation" in report


def test_many_texels_are_probed_and_unseen_ones_have_the_prior(noisy, monkeypatch):
    few_texels(noisy)
    monkeypatch.setattr(deviations, "DENSE", 10)
    monkeypatch.setattr(deviations, "PROBES", 4)
    summary, report = finished(noisy, "parameters.0.name='picture.reflectance.data'", "parameters.0.initial=0.5",
                               "report.deviations='all'", "steps=2")
    found = summary["deviations"]
    assert found["computed"] and found["names"] == [], found["why"]
    prior = 1 / math.sqrt(12)
    assert found["maps"][0]["prior"] == pytest.approx(prior)
    assert 0 < found["maps"][0]["median"] < found["maps"][0]["largest"] < 1.5 * prior
    folder = next(noisy.glob("run*"))
    picture = read_image(folder / "textures" / "picture.reflectance.data_deviations.png")
    assert picture.shape == (2, 3, 3) and float(picture.std()) > 0.05
    assert "standard deviation" in report and "uniform distribution" in report


def test_gains_have_deviations_but_for_the_fixed_one(noisy, two_views):
    with two_views.open("a") as file:
        file.write('\n[gains]\nfixed = "camera"\n')
    found = finished(noisy)[0]["deviations"]
    assert found["computed"], found["why"]
    assert found["names"][3:] == ["gains[aside]"] and 0 < found["deviations"][3] < 0.5


WITHOUT = {
    "not asked for": (["report.deviations='none'"], "asks for none"),
    "too many renderings": (["parameters.0.name='picture.reflectance.data'"], "picture.reflectance.data would take many"),
}


@pytest.mark.parametrize("case", WITHOUT)
def test_a_run_without_deviations_says_why(case, folder, radbp):
    overrides, words = WITHOUT[case]
    arguments = [part for each in overrides for part in ("-D", each)]
    code, stdout, stderr = radbp("optimize", "recipe.toml", "--out", "run", *arguments)
    assert code == 0, stderr
    assert "no standard deviations: " in stdout and words in stdout
    assert words in (folder / "run" / "report.html").read_text()


def test_a_run_is_not_lost_if_deviations_cannot_be_computed(folder, radbp, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("no such thing")

    monkeypatch.setattr(deviations, "covariance", broken)
    code, stdout, stderr = radbp("optimize", "recipe.toml", "--out", "run")
    assert code == 0, stderr
    assert "no standard deviations: they cannot be computed: no such thing" in stdout
    assert (folder / "run" / "scene" / "scene.xml").is_file() and (folder / "run" / "report.html").is_file()


def test_nobody_waits_for_deviations_after_a_signal(folder):
    recovery = Recovery(read_recipe(folder / "recipe.toml"))
    for each in recovery.parameters:
        each.settle(recovery.scene)
    asked = []
    found = deviations.deviations_of(recovery, None, lambda: len(asked) >= 2 or asked.append(1))
    assert not found["computed"] and "interrupted" in found["why"] and len(asked) == 2
