"""Sensors of data sets are called as their images are, `images/v000_png`: files are named after them nevertheless."""

import itertools
from types import SimpleNamespace

import pytest
import torch

from torch_radbp.formats.file_names import file_name
from torch_radbp.training.commands.check import write_outcome

pytestmark = pytest.mark.hostile

# Name -> file name.
NAMES = {
    "camera": "camera", "images/v000_png": "images%2Fv000_png", "images_v000_png": "images_v000_png",
    "../../up": "..%2F..%2Fup", "/etc/passwd": "%2Fetc%2Fpasswd", "a\\b": "a%5Cb", "a:b": "a%3Ab", "a%2Fb": "a%252Fb",
    "a/b": "a%2Fb", "line\nbreak": "line%0Abreak", "nul\0": "nul%00", "küche 1": "küche 1", "*": "%2A", "a|b": "a%7Cb",
    "\ud800": "%D800",
}
LONG = ["x" * 300, "x" * 301, "é" * 200, "/" * 200, "y" * 119 + "/"]


@pytest.mark.parametrize("name", NAMES)
def test_names(name):
    assert file_name(name) == NAMES[name]


def test_files_have_such_names_and_different_names_stay_different(tmp_path):
    for first, second in itertools.combinations([*NAMES, *LONG], 2):
        assert file_name(first) != file_name(second)
    for name in [*NAMES, *LONG]:
        path = tmp_path / f"before_{file_name(name)}_after.exr"
        path.write_bytes(b"")
        assert path.parent == tmp_path and path.exists()
    assert len(list(tmp_path.iterdir())) == len(NAMES) + len(LONG)


SENSORS = ("images/v000_png", "images_v000_png", "/up")


@pytest.fixture
def scene_of_frames(folder):
    """The scene with three sensors as a NeRF data set names them."""
    text = (folder / "scene.xml").read_text()
    begin, end = text.index("<sensor"), text.index("</sensor>") + len("</sensor>")
    sensor = text[begin:end]
    sensors = "".join(sensor.replace('id="camera"', f'id="{name}"') for name in SENSORS)
    (folder / "scene.xml").write_text(text[:begin] + sensors + text[end:])
    return folder


def below(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_render(scene_of_frames, radbp):
    (scene_of_frames / "out").mkdir()
    before = set(below(scene_of_frames))
    code, _, errors = radbp("render", "scene.xml", "-o", "out/a.png", "--spp", "1", "--aov", "depth")
    assert code == 0, errors
    names = ["a_%2Fup", "a_images%2Fv000_png", "a_images_v000_png"]
    assert set(below(scene_of_frames)) - before == {f"out/{name}{end}.png" for name in names for end in ("", "_depth")}


def test_check(tmp_path, monkeypatch):
    monkeypatch.setattr("torch_radbp.training.commands.check.panels", lambda result, number: [])
    monkeypatch.setattr("torch_radbp.training.signed_picture.write_panels", lambda path, panels: path.write_bytes(b""))
    result = SimpleNamespace(figures=dict, direction=torch.ones(1))
    paths = write_outcome(tmp_path, result, list(SENSORS))
    assert [path.name for path in paths] == ["check_images%2Fv000_png.png", "check_images_v000_png.png", "check_%2Fup.png"]
    assert below(tmp_path) == sorted(["check.json", *(path.name for path in paths)])


def test_optimize(scene_of_frames, radbp):
    recipe = (scene_of_frames / "recipe.toml").read_text()
    targets = "".join(f'[[targets]]\nimage = "target.exr"\nsensor = "{name}"\n' for name in SENSORS)
    (scene_of_frames / "recipe.toml").write_text(recipe.replace('[[targets]]\nimage = "target.exr"\n', targets))
    code, _, errors = radbp("optimize", "recipe.toml", "--out", "run", "--steps", "1")
    assert code == 0, errors
    images = below(scene_of_frames / "run" / "images")
    assert len(images) == 3 * 4 * 2 and "images%2Fv000_png_after.exr" in images and "images_v000_png_after.exr" in images
    assert (scene_of_frames / "run" / "report.html").read_text().count("<h3>") == 3
    code, _, errors = radbp("optimize", "recipe.toml", "--out", "run", "--steps", "2", "--resume")
    assert code == 0, errors


def test_pictures_that_would_have_one_name_are_refused(folder, radbp):
    text = (folder / "scene.xml").read_text()
    begin, end = text.index("<sensor"), text.index("</sensor>") + len("</sensor>")
    second = text[begin:end].replace('id="camera"', 'id="camera_depth"')
    (folder / "scene.xml").write_text(text[:end] + second + text[end:])
    code, _, errors = radbp("render", "scene.xml", "-o", "a.png", "--spp", "1", "--aov", "depth")
    assert code == 2 and not list(folder.glob("a_*"))
    assert errors.strip() == ("error: a_camera_depth.png: 2 pictures would have this name; write an .exr, which holds all "
                              "outputs of a sensor, or choose sensors with --sensor")
