"""A scene of a few triangles and 8 x 6 pixels, and recipes for it: a whole run takes about a second."""

import re
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from torch_radbp.formats.image import save_image
from torch_radbp.training.cli import app

SCENE = """<scene version="3.0.0">
    <default name="width" value="8"/>
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective" id="camera">
        <float name="fov" value="60"/>
        <transform name="to_world"><lookat origin="0, 1, 3" target="0, 0.6, 0" up="0, 1, 0"/></transform>
        <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="$width"/><integer name="height" value="6"/><rfilter type="box"/>
        </film>
    </sensor>
    <bsdf type="diffuse" id="paint"><rgb name="reflectance" value="0.2, 0.5, 0.7"/></bsdf>
    <bsdf type="diffuse" id="picture">
        <texture name="reflectance" type="bitmap"><string name="filename" value="picture.png"/></texture>
    </bsdf>
    <shape type="rectangle" id="floor">
        <transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/></transform>
        <ref id="paint"/>
    </shape>
    <shape type="rectangle" id="wall">
        <transform name="to_world"><translate y="1" z="-1"/></transform>
        <ref id="picture"/>
    </shape>
    <shape type="rectangle" id="lamp">
        <transform name="to_world"><rotate x="1" angle="90"/><translate y="2.5"/></transform>
        <emitter type="area"><rgb name="radiance" value="6"/></emitter>
    </shape>
</scene>
"""

RECIPE = """scene = "scene.xml"
steps = 6

[[targets]]
image = "target.exr"

[[parameters]]
name = "paint.reflectance.value"
initial = 0.5
bounds = [0.0, 1.0]
truth = "scene"

[render]
spp = 4
max_depth = 3
caster = "brute"

[[loss]]
name = "two_buffer_l2"

[optimizer]
name = "adam"
learning_rate = 0.05

[schedule]
name = "cosine"

[report]
spp = 4
checkpoint_every = 2
deviations = "none"
"""


def write_files(folder: Path) -> Path:
    """Writes scene.xml, picture.png (4 x 4), target.exr and recipe.toml into a folder."""
    generator = torch.Generator().manual_seed(1)
    save_image(folder / "picture.png", torch.rand(3, 4, 4, generator=generator))
    save_image(folder / "target.exr", torch.rand(3, 6, 8, generator=generator))
    (folder / "scene.xml").write_text(SCENE)
    (folder / "recipe.toml").write_text(RECIPE)
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the files of a recipe."""
    return write_files(tmp_path)


@pytest.fixture
def edit_recipe(folder: Path):
    """Returns a function that replaces text of the recipe and returns the recipe's path."""

    def edit(old: str, new: str) -> Path:
        path = folder / "recipe.toml"
        text = path.read_text()
        assert text.count(old) == 1, f"{old!r} must occur once in the recipe"
        path.write_text(text.replace(old, new))
        return path

    return edit


@pytest.fixture
def two_views(folder, edit_recipe) -> Path:
    """The recipe with a second camera, `aside`, and the same target for it."""
    scene = (folder / "scene.xml").read_text()
    camera = re.search(r"    <sensor.*?</sensor>\n", scene, re.DOTALL)[0]
    aside = camera.replace('id="camera"', 'id="aside"').replace('origin="0, 1, 3"', 'origin="1, 1, 2.5"')
    (folder / "scene.xml").write_text(scene.replace(camera, camera + aside))
    return edit_recipe('image = "target.exr"\n', 'image = "target.exr"\nsensor = "camera"\n\n[[targets]]\n'
                       'image = "target.exr"\nsensor = "aside"\n')


@pytest.fixture
def radbp(folder, monkeypatch):
    """Returns a function that runs a command line in the fixture's folder: (exit code, stdout, stderr)."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "200")

    def invoke(*arguments):
        result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=True)
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        return result.exit_code, result.stdout, result.stderr

    return invoke
