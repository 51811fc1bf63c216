"""`radbp doctor` and `radbp cache`: what is there is listed, what is missing is said, with what to do."""

import os

import pytest
import torch

from torch_radbp.install_hint import install_with
from torch_radbp.training.commands import doctor


def test_what_is_there_is_listed_and_renders(radbp):
    code, stdout, _ = radbp("doctor")
    assert code == 0, stdout
    for fragment in ("torch_radbp", torch.__version__, "llvmlite", f"{os.cpu_count()} cores", "lanes of float32",
                     "a box of 64 x 64 pixels", "compiled", "differ by"):
        assert fragment in stdout
    assert "wrong" not in stdout


def test_what_is_missing_is_said_with_what_to_do(radbp, monkeypatch):
    missing = {"kornia", "warp-lang"}
    version = doctor.version
    monkeypatch.setattr(doctor, "version", lambda name: None if name in missing else version(name))
    code, stdout, _ = radbp("doctor", "--no-render")
    assert code == 1 and "wrong: not installed; pip install kornia" in stdout
    said = " ".join(stdout.split())
    assert f"not installed; for rays on NVIDIA's GPUs: {install_with('cuda')}" in said and "a box" not in said


@pytest.mark.parametrize("gradient, right", [(1.0, True), (2.0, False)])
def test_a_rendering_that_is_not_that_of_plain_torch_is_wrong(gradient, right, monkeypatch):
    import torch_radbp as rb

    class Renderer(rb.Renderer):
        """Whose compiled derivatives are multiplied by a factor."""

        def forward(self, *arguments, **settings):
            image = super().forward(*arguments, **settings)
            return image.detach() + (gradient if self.runs_compiled() else 1.0) * (image - image.detach())

    monkeypatch.setattr(rb.public, "Renderer", Renderer)
    assert (doctor.rendered().wrong == "") == right


@pytest.mark.parametrize("kept", ["off", "elsewhere"])
def test_where_compiled_code_is_kept_is_shown_and_cleared(kept, radbp, monkeypatch, tmp_path):
    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off" if kept == "off" else str(tmp_path / "kernels"))
    if kept == "off":
        for command in (["cache"], ["doctor", "--no-render"]):
            assert "RADBP_KERNEL_CACHE is off" in radbp(*command)[1]
        return
    assert "0 functions" in radbp("cache")[1]
    assert radbp("render", "scene.xml", "-o", "image.exr", "--spp", 2)[0] == 0
    code, stdout, _ = radbp("cache")
    assert code == 0 and str(tmp_path) in stdout.replace("\n", "")
    assert "deleted" in radbp("cache", "--clear")[1]
    assert not list((tmp_path / "kernels").glob("*.code"))
