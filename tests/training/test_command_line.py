"""`radbp`: help that teaches, images that are right, one clear message and exit code 2 when something is wrong."""

import subprocess
import sys

import OpenEXR
import pytest
import torch
from PIL import Image
from typer.testing import CliRunner

import torch_radbp as rb
from tests.deep import deep
from tests.io.gltf_files import GltfFile
from torch_radbp.formats.image import read_image, srgb_to_linear
from torch_radbp.training.cli import app
from torch_radbp.training.recovery import optimize

SEED = 3


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ((), ["render", "info", "optimize", "radbp render scene.xml -o image.png --spp 64"]),
        (("render",), ["--spp", "--max-depth", "-D resolution=64", "sRGB", "[default: the", "[default: all]"]),
        (("info",), ["radbp info scene.xml", "parameters in a recipe"]),
        (("optimize",), ["--out", "--resume", "--steps", "-D render.spp=32", "130", "--list", "[default: runs/NAME"]),
    ],
)
def test_help_teaches_with_examples(command, expected, radbp):
    code, stdout, _ = radbp(*command, "--help")
    assert code == 0
    assert "Examples:" in stdout
    for fragment in expected:
        assert fragment in stdout


@pytest.mark.parametrize("arguments", [
    ("render", "scene.xml", "-o", "image.png", "--spp", "1"), deep(("info", "scene.xml"))])
def test_commands_work_in_a_process_of_their_own(arguments, folder):
    """Where no other module has been imported before."""
    done = subprocess.run([sys.executable, "-m", "torch_radbp.training.cli", *arguments], cwd=folder, capture_output=True,
                          text=True)
    assert done.returncode == 0, done.stderr


def test_render_writes_linear_exr(radbp, folder):
    code, _, stderr = radbp("render", "scene.xml", "-o", "image.exr", "--spp", 8, "--seed", SEED)
    assert code == 0 and "image.exr  8 x 6, 8 spp" in stderr
    expected = rb.render(rb.load(folder / "scene.xml"), spp=8, seed=SEED)[0]
    torch.testing.assert_close(read_image(folder / "image.exr").permute(2, 0, 1), expected.detach())


def test_render_writes_srgb_png(radbp, folder):
    assert radbp("render", "scene.xml", "-o", "image.png", "--spp", 8, "--seed", SEED)[0] == 0
    expected = rb.render(rb.load(folder / "scene.xml"), spp=8, seed=SEED)[0].detach().clamp(0, 1)
    decoded = srgb_to_linear(read_image(folder / "image.png", raw=True)).permute(2, 0, 1)
    torch.testing.assert_close(decoded, expected, atol=0.006, rtol=0)  # 8 bits; half a step is 0.0045 at white


def test_a_gltf_file_is_rendered_and_listed_and_what_is_missing_is_said_in_one_line(radbp, folder):
    file = GltfFile()
    file.node(file.square(file.add("materials", name="gold")), name="sheet")
    file.save(folder / "asset.glb")
    code, _, stderr = radbp("render", "asset.glb", "-o", "a.png", "--spp", 4, "-D", "resolution=12", "-D", "light=0.5")
    assert code == 0 and "a.png  12 x 12, 4 spp" in stderr
    assert stderr.startswith("warning: asset.glb: it has no camera: 'camera' is added") and stderr.count("\n") == 2
    code, stdout, _ = radbp("info", "asset.glb")
    assert code == 0 and all(name in stdout for name in ("sheet", "gold.roughness.value", "gold.base_color.value", "sky"))
    code, _, stderr = radbp("info", "asset.glb", "-D", "size=3")
    assert code == 2 and "error: asset.glb: a glTF file has no variables" in stderr


def test_passes_of_a_long_rendering_average_to_the_expected_image(radbp, folder):
    # Rendered in 16 passes; were they the same pass 16 times, the two would differ by four times as much.
    assert radbp("render", "scene.xml", "-o", "long.exr", "--spp", 4096, "--max-depth", 2)[0] == 0
    assert radbp("render", "scene.xml", "-o", "other.exr", "--spp", 4096, "--max-depth", 2, "--seed", 77)[0] == 0
    long, other = read_image(folder / "long.exr"), read_image(folder / "other.exr")
    assert not torch.equal(long, other)
    assert (long.mean() - other.mean()).abs() < 0.01 * long.mean()


def test_scene_variables_and_depth(radbp, folder):
    assert radbp("render", "scene.xml", "-o", "wide.exr", "-D", "width=12", "--max-depth", 1, "--spp", 1)[0] == 0
    image = read_image(folder / "wide.exr")
    assert image.shape == (6, 12, 3)
    assert image.max() == 0, "the lamp faces down, out of the picture: nothing is seen that emits"


def test_info_lists_shapes_sensors_and_parameters(radbp):
    code, stdout, _ = radbp("info", "scene.xml")
    assert code == 0
    rows = {line.split()[1]: line for line in stdout.splitlines() if line.startswith(("│", "|"))}
    assert "rectangle" in rows["floor"] and " 2 " in rows["floor"] and "paint (diffuse)" in rows["floor"]
    assert "8 x 6" in rows["camera"] and "60.00" in rows["camera"] and "box" in rows["camera"]
    assert "yes" in rows["paint.reflectance.value"]
    assert "4 x 4 x 3" in rows["picture.reflectance.data"] and "yes" in rows["picture.reflectance.data"]
    assert "yes" in rows["floor.to_world"]
    assert " 3 " in rows["max_depth"]
    assert "Supported here" in stdout and "diffuse" in stdout


BAD_COMMANDS = {
    "no such scene": (["render", "nothing.xml", "-o", "x.png"], ["nothing.xml", "not found"]),
    "unknown image format": (["render", "scene.xml", "-o", "x.bmp"], ["x.bmp", ".exr or .png", "'.bmp'"]),
    "no such folder": (["render", "scene.xml", "-o", "no/x.png"], ["no such folder: no"]),
    "no such sensor": (["render", "scene.xml", "-o", "x.png", "--sensor", "camra"], ["'camra'", "'camera'"]),
    "bad spp": (["render", "scene.xml", "-o", "x.png", "--spp", "0"], ["spp", "at least 1", "0"]),
    "bad depth": (["render", "scene.xml", "-o", "x.png", "--max-depth", "-3"], ["max_depth", "-3"]),
    "bad variable": (["info", "scene.xml", "-D", "width"], ["NAME=VALUE", "'width'"]),
    "scene that is no XML": (["info", "recipe.toml"], ["recipe.toml", ".xml"]),
    "no such recipe": (["optimize", "nothing.toml"], ["no such recipe: nothing.toml"]),
    "bad recipe": (["optimize", "recipe.toml", "-D", "render.ssp=1"], ["recipe.toml", "'ssp'", "'spp'"]),
    "bad steps": (["optimize", "recipe.toml", "--steps", "0"], ["steps", "greater than or equal to 1"]),
    "nothing to resume": (["optimize", "recipe.toml", "--resume"], ["--resume", "no run of 'recipe'"]),
}


@pytest.mark.parametrize("case", BAD_COMMANDS)
def test_bad_command_is_one_message_and_exit_code_2(case, radbp, folder):
    arguments, expected = BAD_COMMANDS[case]
    before = sorted(folder.rglob("*"))
    code, _, stderr = radbp(*arguments)
    assert code == 2
    assert stderr.startswith("error: ") and "Traceback" not in stderr and len(stderr.splitlines()) == 1
    for fragment in expected:
        assert fragment in stderr
    assert sorted(folder.rglob("*")) == before, "a refused command writes nothing"


def test_unknown_option_is_exit_code_2(radbp):
    code, _, stderr = radbp("render", "scene.xml", "--sp", 3)
    assert code == 2 and "--spp" in stderr


def test_debug_shows_the_error_itself(folder, monkeypatch):
    monkeypatch.chdir(folder)
    result = CliRunner().invoke(app, ["info", "nothing.xml", "--debug"])
    assert isinstance(result.exception, rb.SceneError)


def test_optimize_prints_the_table_and_the_report(radbp, folder):
    code, stdout, stderr = radbp("optimize", "recipe.toml")
    assert code == 0, stderr
    assert "paint.reflectance.value" in stdout and "0.2000 0.5000 0.7000" in stdout
    assert "report: runs/recipe/report.html" in stdout
    assert (folder / "runs" / "recipe" / "report.html").is_file()
    assert radbp("optimize", "recipe.toml", "--steps", 1)[0] == 0
    assert (folder / "runs" / "recipe-2" / "report.html").is_file(), "a second run gets a folder of its own"


def test_interrupted_optimize_exits_with_130_and_resumes(radbp, folder, monkeypatch):
    render = optimize.render_buffers

    def interrupted(recovery, step):
        if step == 2:
            raise KeyboardInterrupt
        return render(recovery, step)

    with monkeypatch.context() as patch:
        patch.setattr(optimize, "render_buffers", interrupted)
        code, stdout, _ = radbp("optimize", "recipe.toml", "--out", "run")
    assert code == 130
    assert "stopped at step 2" in stdout and "--resume --out run" in stdout
    assert "interrupted at step 2 of 6" in (folder / "run" / "report.html").read_text()
    code, stdout, _ = radbp("optimize", "recipe.toml", "--out", "run", "--resume")
    assert code == 0 and "step 6 of 6" in stdout


def test_bundled_recipes_are_listed_and_called_by_name(radbp, monkeypatch):
    code, stdout, _ = radbp("optimize", "--list")
    assert code == 0 and "metal_plate           Metal plate: the roughness" in stdout
    code, _, stderr = radbp("optimize", "metal_plait")
    assert code == 2 and "no such recipe: metal_plait" in stderr and "metal_plate" in stderr
    code, _, stderr = radbp("optimize", "metal_plate", "-D", "steps=0")
    assert code == 2 and "metal_plate.toml: steps: must be greater" in stderr


@pytest.mark.parametrize(("words", "offered"), [
    ("radbp op", ["optimize"]), ("radbp optimize met", ["metal_plate"]), ("radbp optimize reci", ["recipe.toml"]),
    ("radbp optimize nowhere/x", []), ("radbp render --se", ["--seed", "--sensor"])])
def test_the_tab_key_offers_commands_options_and_recipes(words, offered, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
    monkeypatch.setenv("_RADBP_COMPLETE", "complete_bash")
    with pytest.raises(SystemExit) as ended:
        app(prog_name="radbp")
    assert ended.value.code == 0 and capsys.readouterr().out.split() == offered


def test_render_writes_quantities_as_channels_named_as_in_mitsuba(radbp, folder):
    wanted = ["--aov", "depth", "--aov", "sh_normal"]
    assert radbp("render", "scene.xml", "-o", "all.exr", "--spp", 4, "--seed", SEED, *wanted)[0] == 0
    channels = OpenEXR.File(str(folder / "all.exr"), separate_channels=True).parts[0].channels
    assert set(channels) == {"R", "G", "B", "depth.T", "sh_normal.X", "sh_normal.Y", "sh_normal.Z"}
    renderer = rb.Renderer(rb.load(folder / "scene.xml"), spp=4)
    image, found = renderer(seed=SEED, aovs=["depth", "sh_normal"])
    assert found["depth"].max() > 0
    for name, expected in (("R", image[0, 0]), ("depth.T", found["depth"][0, 0]), ("sh_normal.Z", found["sh_normal"][0, 2])):
        torch.testing.assert_close(torch.from_numpy(channels[name].pixels.copy()), expected.detach())
    assert read_image(folder / "all.exr").shape == (6, 8, 3)  # which is the image


def test_render_writes_a_picture_of_each_quantity(radbp, folder):
    wanted = ["--aov", "depth", "--aov", "uv", "--aov", "albedo"]
    assert radbp("render", "scene.xml", "-o", "a.png", "--spp", 4, *wanted)[0] == 0
    for name in ("a.png", "a_depth.png", "a_uv.png", "a_albedo.png"):
        pixels = read_image(folder / name, raw=True)
        assert pixels.shape == (6, 8, 3) and pixels.min() < pixels.max(), name
    assert radbp("render", "scene.xml", "-o", "a.png", "--aov", "dept")[0] == 2


def test_alpha_and_the_outputs_of_the_integrator_are_written(radbp, folder):
    text = (folder / "scene.xml").read_text()
    path = '<integrator type="path"><integer name="max_depth" value="3"/></integrator>'
    outputs = f'<integrator type="aov"><string name="aovs" value="dd.y:depth,nn:geo_normal"/>{path}</integrator>'
    text = text.replace(path, outputs)
    text = text.replace('<film type="hdrfilm">', '<film type="hdrfilm"><string name="pixel_format" value="rgba"/>')
    assert "dd.y:depth" in text and "rgba" in text
    (folder / "outputs.xml").write_text(text)
    assert radbp("render", "outputs.xml", "-o", "all.exr", "--spp", 4)[0] == 0
    channels = OpenEXR.File(str(folder / "all.exr"), separate_channels=True).parts[0].channels
    assert set(channels) == {"R", "G", "B", "A", "dd.y.T", "nn.X", "nn.Y", "nn.Z"}
    alpha = channels["A"].pixels
    assert ((alpha >= 0) & (alpha <= 1)).all() and alpha.max() == 1
    assert radbp("render", "outputs.xml", "-o", "all.png", "--spp", 4)[0] == 0
    assert Image.open(folder / "all.png").mode == "RGBA"
