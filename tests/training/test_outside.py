"""Recipes and glTF scenes read files of their own folders, unless told otherwise."""

import os
import warnings

import pytest

import torch_radbp as rb
from tests.io.gltf_files import GltfFile
from torch_radbp.training.commands.bundled import bundled_recipes
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.problem import Recovery

pytestmark = pytest.mark.hostile

SECRET = "root:x:0:0"
KEYS = ["scene", "targets.0.image", "parameters.0.initial", "parameters.0.truth"]
PATHS = ["/etc/passwd", "../secret.exr", "inner/../../secret.exr", "linked.exr", "inner/linked.exr",
         "../no such file.exr", "/dev/zero", "/proc/self/environ"]


@pytest.fixture
def secret(folder):
    """A file beside the recipe's folder, and links to it."""
    path = folder.parent / "secret.exr"
    path.write_text(SECRET)
    (folder / "inner").mkdir()
    for name in ("linked.exr", "inner/linked.exr"):
        (folder / name).symlink_to(path)
    yield path
    path.unlink()


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("path", PATHS)
def test_a_recipe_names_no_file_outside_of_its_folder(key, path, folder, secret):
    with pytest.raises(ValueError) as caught:
        read_recipe(folder / "recipe.toml", [f"{key}='{path}'"])
    message = str(caught.value)
    expected = f"{path!r} leads out of the recipe's folder {folder.resolve()}; if you trust the recipe, pass --allow-outside"
    assert f"{expected} (in Python allow_outside=True)" in message
    assert SECRET not in message and "\n" not in message


def test_a_recipe_may_name_such_files_if_that_is_allowed(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    for name in ("scene.xml", "target.exr"):
        os.rename(folder / name, other / name)
    os.rename(folder / "picture.png", other / "picture.png")
    changes = [f"scene='{other}/scene.xml'", f"targets.0.image='{os.path.relpath(other / 'target.exr', folder)}'"]
    with pytest.raises(ValueError, match="leads out of the recipe's folder"):
        read_recipe(folder / "recipe.toml", changes)
    recipe = read_recipe(folder / "recipe.toml", changes, allow_outside=True)
    assert recipe.scene == other / "scene.xml" and recipe.targets[0].image == other / "target.exr"


def test_a_link_to_a_file_of_the_folder_is_inside(folder):
    (folder / "linked.exr").symlink_to(folder / "target.exr")
    assert read_recipe(folder / "recipe.toml", ["targets.0.image='linked.exr'"]).targets[0].image.name == "linked.exr"


def test_a_recipe_cannot_allow_it_itself(folder):
    with pytest.raises(ValueError, match="variables: a recipe cannot allow files outside .*; pass --allow-outside"):
        read_recipe(folder / "recipe.toml", ["variables={allow_outside='true'}"])
    with pytest.raises(ValueError, match="unknown key 'allow_outside'"):
        read_recipe(folder / "recipe.toml", ["allow_outside=true"])


def test_bundled_recipes_name_the_files_of_the_package():
    for path in bundled_recipes().values():
        assert read_recipe(path).steps > 0


def test_optimize_takes_the_flag_and_its_copy_needs_it(folder, radbp, secret):
    code, _, errors = radbp("optimize", "recipe.toml", "--out", "run", "-D", "targets.0.image=../secret.exr")
    assert code == 2 and "'../secret.exr' leads out of the recipe's folder" in errors and SECRET not in errors
    code, _, errors = radbp("optimize", "recipe.toml", "--out", "run", "--steps", "1")
    assert code == 0, errors
    code, _, errors = radbp("optimize", "run/recipe.toml", "--out", "again")
    assert code == 2 and "'../scene.xml' leads out of the recipe's folder" in errors
    code, _, errors = radbp("optimize", "run/recipe.toml", "--out", "again", "--allow-outside")
    assert code == 0, errors
    assert "radbp optimize recipe.toml --allow-outside" in (folder / "again" / "recipe.toml").read_text().splitlines()[0]


URIS = ["../buffer.bin", "%2e%2e/buffer.bin", "a/..%2F../buffer.bin", "/etc/passwd", "%2Fetc%2Fpasswd", "linked.bin",
        "..\u002fbuffer.bin"]


@pytest.fixture
def outside(tmp_path):
    """A glTF file whose buffer lies above it; a function sets the buffer's uri."""
    file = GltfFile()
    file.node(file.square(), name="sheet")
    (tmp_path / "asset").mkdir()
    (tmp_path / "buffer.bin").write_bytes(file.binary)
    (tmp_path / "asset" / "linked.bin").symlink_to(tmp_path / "buffer.bin")

    def write(uri):
        file.document["buffers"][0]["uri"] = uri
        return file.save(tmp_path / "asset" / "asset.gltf")

    return write


@pytest.mark.parametrize("uri", URIS)
def test_a_gltf_scene_reads_no_file_outside_of_its_folder(uri, outside):
    path = outside(uri)
    with pytest.raises(rb.SceneError) as caught:
        rb.load(path)
    assert (f"buffers[0]: the uri {uri!r} leads out of the folder of the document, {path.parent.resolve()}; if you trust "
            "it, load it with allow_outside=True (on the command line --allow-outside)") in str(caught.value)


@pytest.mark.parametrize("command", ["render", "info", "check"])
def test_commands_take_the_flag(command, outside, radbp):
    path = outside("../buffer.bin")
    more = {"render": ["-o", "image.png", "--spp", "1", "-D", "resolution=4"],
            "check": ["--param", "nothing"]}.get(command, [])
    code, _, errors = radbp(command, path, *more)
    assert code == 2 and "leads out of the folder of the document" in errors
    code, _, errors = radbp(command, path, *more, "--allow-outside")
    assert "leads out" not in errors and code == (2 if command == "check" else 0), errors
    code, _, errors = radbp(command, path, *more, "-D", "allow_outside=true")
    assert code == 2 and errors.splitlines()[-1] == "error: -D 'allow_outside=true': pass --allow-outside instead"


@pytest.mark.parametrize("value", ["true", 1, None])
def test_load_takes_true_or_false(value, outside):
    with pytest.raises(TypeError, match=f"allow_outside must be True or False, got {value!r}"):
        rb.load(outside("../buffer.bin"), allow_outside=value)


def test_a_recipe_of_such_a_scene_takes_the_flag(outside, folder):
    changes = [f"scene='{outside('../buffer.bin')}'"]
    recipe = read_recipe(folder / "recipe.toml", changes, allow_outside=True)
    with pytest.raises(rb.SceneError, match="leads out of the folder of the document"):
        Recovery(recipe)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.GltfWarning)
        with pytest.raises(ValueError, match="target"):  # whose size is another
            Recovery(recipe, allow_outside=True)
