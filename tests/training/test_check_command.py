"""`radbp check`: exit codes that scripts can use, pictures and figures on disk, clear messages."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from torch_radbp.check import gradient as check_module
from torch_radbp.rendering.jvp import DualImage
from torch_radbp.training.false_colour import signed_colour
from torch_radbp.training.signed_picture import Panel, write_panels

PAINT = ["check", "scene.xml", "--param", "paint.reflectance.value", "--max-depth", 2]


def test_a_right_gradient_is_exit_code_0_with_a_picture_and_figures(radbp, folder):
    code, stdout, _ = radbp(*PAINT, "--spp", 512)
    assert code == 0, stdout
    assert "agrees: " in stdout and "derivative image" in stdout and "mean square z" in stdout
    out = folder / "runs" / "checks" / "paint.reflectance.value"
    assert sorted(path.name for path in out.iterdir()) == ["check.json", "check.png"]
    figures = json.loads((out / "check.json").read_text())
    assert figures["verdict"] == "agrees" and figures["spp"] == 512 and len(figures["projections"]) == 3
    assert len(figures["direction"]) == 3 and figures["sensors"] == ["camera"]
    with Image.open(out / "check.png") as picture:
        assert picture.width > 4 * 256 and picture.height > 6 * 32
        colours = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    assert len(np.unique(colours, axis=0)) > 50


def test_a_wrong_gradient_is_exit_code_1(radbp, monkeypatch):
    right = check_module.rendering_with_tangent

    def wrong(*arguments, **named):
        image, tangent = right(*arguments, **named)
        return DualImage(image, 0.9 * tangent)

    monkeypatch.setattr(check_module, "rendering_with_tangent", wrong)
    code, stdout, _ = radbp(*PAINT, "--spp", 64)
    assert code == 1 and "biased: " in stdout


def test_too_few_samples_are_exit_code_3(radbp, folder):
    code, stdout, _ = radbp(*PAINT, "--spp", 8, "--batches", 8, "-o", "few")
    assert code == 3 and "too noisy: " in stdout and "times the samples" in stdout
    assert json.loads((folder / "few" / "check.json").read_text())["verdict"] == "too noisy"


def test_a_derivative_of_zero_is_exit_code_3_and_its_file_is_json(radbp, folder):
    code, stdout, _ = radbp(*PAINT, "--max-depth", 1, "--spp", 8, "-o", "zero")
    assert code == 3 and "zero everywhere" in stdout

    def refuse(constant):
        raise AssertionError(constant)

    assert json.loads((folder / "zero" / "check.json").read_text(), parse_constant=refuse)["detectable"] is None


@pytest.mark.parametrize("direction", ["1,0,0", "-1,0.5,0", "ones", "random", "change.npy"])
def test_directions(direction, radbp, folder):
    np.save(folder / "change.npy", np.array([0.3, 0.2, 0.1]))
    code, stdout, _ = radbp(*PAINT, "--direction", direction, "--step", 0.05, "--spp", 8, "--batches", 8, "-o", "out")
    assert code in (0, 3) and "step 0.05, 8 samples per pixel in 8 batches" in stdout
    used = json.loads((folder / "out" / "check.json").read_text())["direction"]
    expected = {"1,0,0": [1, 0, 0], "-1,0.5,0": [-1, 0.5, 0], "ones": [1, 1, 1], "change.npy": [0.3, 0.2, 0.1]}
    assert direction == "random" or used == pytest.approx(expected[direction])


def test_a_bitmap_moves_by_a_file(radbp, folder):
    np.save(folder / "change.npy", np.random.default_rng(0).uniform(size=(4, 4, 3)))
    code, stdout, _ = radbp("check", "scene.xml", "--param", "picture.reflectance.data", "--direction", "change.npy",
                            "--max-depth", 2, "--spp", 8, "--batches", 8, "-o", "out")
    assert code in (0, 3), stdout


def test_help_teaches(radbp):
    code, stdout, _ = radbp("check", "--help")
    assert code == 0
    for fragment in ("Examples:", "--direction", "[default: the scene's]", "exit code 0", "too noisy", "check.png"):
        assert fragment in stdout


BAD_COMMANDS = {
    "no such parameter": (["--param", "pint.reflectance.value"], ["'pint.reflectance.value'", "'paint.reflectance.value'"]),
    "wrong length": (["--direction", "1,0"], ["--direction 1,0", "(3,)", "(2,)"]),
    "no numbers": (["--direction", "up"], ["--direction up", "ones", ".npy"]),
    "no such file": (["--direction", "no.npy"], ["no.npy", "no such file"]),
    "file of the wrong shape": (["--direction", "wrong.npy"], ["wrong.npy", "(3,)", "(2, 2)"]),
    "bad step": (["--step", "-1"], ["step", "-1"]),
    "few batches": (["--batches", "2"], ["batches", "at least 8"]),
    "no such sensor": (["--sensor", "camra"], ["'camra'", "'camera'"]),
    "out is a file": (["-o", "scene.xml"], ["scene.xml", "folder"]),
}


@pytest.mark.parametrize("case", BAD_COMMANDS)
def test_bad_command_is_one_message_and_exit_code_2(case, radbp, folder):
    arguments, expected = BAD_COMMANDS[case]
    np.save(folder / "wrong.npy", np.ones((2, 2)))
    before = sorted(folder.rglob("*"))
    command = [PAINT[0], PAINT[1], *PAINT[4:]] if "--param" in arguments else PAINT
    code, _, stderr = radbp(*command, *arguments)
    assert code == 2
    message = stderr.strip().splitlines()[-1]
    assert message.startswith("error: ") and "Traceback" not in stderr
    for fragment in expected:
        assert fragment in message
    assert sorted(folder.rglob("*")) == before, "a refused command writes nothing"


def test_signs_have_their_colours():
    red, white, blue = signed_colour(torch.tensor([[0.6, 0.0, -0.6]]), 1.0)[:, 0].T
    assert torch.equal(white, torch.ones(3))
    assert red[0] > 3 * red[2] and blue[2] > 3 * blue[0]
    assert torch.equal(signed_colour(torch.tensor([[7.0]]), 1.0), signed_colour(torch.tensor([[1.0]]), 1.0))


def test_panels_show_their_pixels_in_place(tmp_path):
    values = torch.zeros(2, 3)
    values[0, 2], values[1, 0] = 1.0, -1.0
    write_panels(tmp_path / "panels.png", [Panel("a", values, 1.0), Panel("b", -values, 1.0)])
    with Image.open(tmp_path / "panels.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    difference = pixels[:, :, 0] - pixels[:, :, 2]  # red minus blue
    picture_rows = slice(40, 40 + 2 * 64)
    first = difference[picture_rows, 14:14 + 3 * 64]
    assert first[10, 170] > 10 and first[100, 10] < -10 and abs(first[10, 10]) < 3


def test_too_large_a_step_is_exit_code_3_and_names_a_smaller_one(radbp, monkeypatch):
    right = check_module.Measurement.difference

    def bent(self, number):
        found = right(self, number)
        return found._replace(value=found.value * (1 + 50 * self.step**2))

    monkeypatch.setattr(check_module.Measurement, "difference", bent)
    code, stdout, _ = radbp(*PAINT, "--spp", 256, "--step", 0.08)
    assert code == 3 and "too large a step: " in stdout and "use a smaller step (step=0.01)" in stdout
