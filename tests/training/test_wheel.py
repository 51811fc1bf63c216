"""The wheel: the bundled recipes are in it with all that they refer to."""

import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from torch_radbp.training.commands.bundled import bundled_recipes, listing, recipe_path

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder `torch_radbp` of a wheel, built and unpacked."""
    folder = tmp_path_factory.mktemp("wheel")
    command = ["setup.py", "-q", "egg_info", "--egg-base", folder, "build", "--build-base", folder / "build",
               "bdist_wheel", "--dist-dir", folder]
    built = subprocess.run([sys.executable, *map(str, command)], cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    wheel, = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site" / "torch_radbp"


def files_of(recipe: Path) -> list[Path]:
    """What a recipe needs: the files that it and its scene name."""
    named = [recipe.parent / name for name in re.findall(r'(?:scene|image) = "([^"]+)"', recipe.read_text())]
    scenes = [path for path in named if path.suffix == ".xml" and path.exists()]
    return named + [scene.parent / name for scene in scenes
                    for name in re.findall(r'name="filename" value="([^"]+)"', scene.read_text())]


@pytest.mark.parametrize("name", bundled_recipes())
def test_a_bundled_recipe_has_its_files_in_the_wheel(name, installed):
    recipe = installed / "training" / "recipes" / f"{name}.toml"
    needed = files_of(recipe)
    assert len(needed) >= 2
    for path in needed:
        assert path.resolve().is_relative_to(installed) and path.is_file(), path


def test_the_wheel_has_the_code_and_no_scripts_or_pictures_of_the_repository(installed):
    files = {path.relative_to(installed).as_posix() for path in installed.rglob("*") if path.is_file()}
    assert {"__init__.py", "public.py", "training/cli.py", "training/recipes/metal_plate.toml", "assets/README.md"} <= files
    assert not [name for name in files if name.startswith("assets/") and name.endswith(".py")]
    assert not [name for name in files if name.startswith(("assets/pictures", "tests"))]
    assert sum(path.stat().st_size for path in (installed / "assets").rglob("*")) < 2**20


def test_the_bounds_of_versions_are_those_that_readme_names(installed):
    metadata = next(installed.parent.glob("torch_radbp-*.dist-info/METADATA")).read_text(encoding="utf-8").split("\n\n")[0]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    needed, = re.findall(r"It needs torch (\S+) or newer, Python (\S+) or newer and\s+numpy (\S+) or newer", readme)
    bounds = [re.search(f"^{name}: *(?:{package})?>=(.*)$", metadata, re.M)[1]
              for name, package in (("Requires-Dist", "torch"), ("Requires-Python", ""), ("Requires-Dist", "numpy"))]
    assert tuple(bounds) == needed
    pythons = re.findall(r"^Classifier: Programming Language :: Python :: (.*)$", metadata, re.M)
    assert pythons[0] == needed[1] and f"Python {pythons[0]} to {pythons[-1]}" in " ".join(readme.split())


def test_a_recipe_is_found_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert recipe_path(Path("metal_plate")) == bundled_recipes()["metal_plate"]
    Path("metal_plate").write_text("mine")
    assert recipe_path(Path("metal_plate")) == Path("metal_plate"), "a file of that name comes first"
    assert "\nmetal_plate          Metal plate: the roughness\n" in listing()
