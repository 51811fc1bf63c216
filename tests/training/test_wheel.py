"""The wheel and the source archive: what is in them, and that they run where nothing else of the project is."""

import re
import shutil
import sys
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.release import SCRIPT, build_archive, build_wheel, check_found, outside, programs_of, run
from torch_radbp.training.commands.bundled import bundled_recipes, listing, recipe_path

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    return build_wheel(folder, folder)


@pytest.fixture(scope="module")
def installed(wheel) -> Path:
    """The folder `torch_radbp` of the wheel, unpacked."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(wheel.parent / "site")
    return wheel.parent / "site" / "torch_radbp"


@pytest.fixture(scope="module")
def wheel_of_archive(tmp_path_factory) -> Path:
    """The wheel that pip builds of the source archive, with the tools that the archive asks for and no others."""
    folder = tmp_path_factory.mktemp("archive")
    archive = build_archive(folder, folder)
    run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, archive, cwd=folder, env=outside(folder))
    path, = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def elsewhere(wheel_of_archive, tmp_path_factory) -> Callable[..., str]:
    """Runs a program of an environment that has the package and what it depends on, in a folder that is empty at first."""
    folder = tmp_path_factory.mktemp("elsewhere")
    run(sys.executable, "-m", "venv", folder / "environment")
    programs = programs_of(folder / "environment")
    run(programs / "python", "-m", "pip", "install", "-q", "-c", ROOT / "constraints.txt", wheel_of_archive, cwd=folder)
    (folder / "work").mkdir()

    def program(name: str, *arguments: object) -> str:
        return run(programs / name, *arguments, cwd=folder / "work", env=outside(folder))

    program.folder, program.python = folder / "work", programs / "python"
    return program


def files_of(recipe: Path) -> list[Path]:
    """What a recipe needs: the files that it and its scene name, also by variables."""
    text = recipe.read_text()
    named = [recipe.parent / name for name in re.findall(r'(?:scene|image|mask|truth) = "([^"]+\.\w+)"', text)]
    scenes = [path for path in named if path.suffix == ".xml" and path.exists()]
    of_variables = re.findall(r'= "([^"/]+\.ply)"', "".join(re.findall(r"^variables.*$", text, re.MULTILINE)))
    for scene in scenes:
        written = scene.read_text()
        found = re.findall(r'name="filename" value="([^"$]+)"', written)
        found += re.findall(r'<default name="\w+" value="([^"]+\.\w+)"', written) + of_variables
        named += [scene.parent / name for name in found]
    return named


@pytest.mark.parametrize("name", bundled_recipes())
def test_a_bundled_recipe_has_its_files_in_the_wheel(name, installed):
    recipe = installed / "training" / "recipes" / f"{name}.toml"
    needed = files_of(recipe)
    assert len(needed) >= 2
    for path in needed:
        assert path.resolve().is_relative_to(installed) and path.is_file(), path


def test_the_wheel_has_the_code_and_no_scripts_or_pictures_of_the_repository(installed):
    files = {path.relative_to(installed).as_posix() for path in installed.rglob("*") if path.is_file()}
    assert {"__init__.py", "public.py", "py.typed", "training/cli.py", "training/recipes/metal_plate.toml",
            "assets/README.md"} <= files
    assert not [name for name in files if name.startswith("assets/") and name.endswith(".py")]
    assert not [name for name in files if name.startswith(("assets/pictures", "tests"))]
    assert sum((installed / name).stat().st_size for name in files if name.startswith("assets/")) < 1.5 * 2**20


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
    assert re.search(r"\nmetal_plate +Metal plate: the roughness\n", listing())


@pytest.mark.deep
def test_the_source_archive_builds_the_same_wheel(wheel, wheel_of_archive):
    with zipfile.ZipFile(wheel) as one, zipfile.ZipFile(wheel_of_archive) as other:
        named = {name: one.read(name) for name in one.namelist() if "dist-info" not in name}
        assert len(named) > 400
        assert named == {name: other.read(name) for name in other.namelist() if "dist-info" not in name}


@pytest.mark.deep
def test_the_demo_and_another_recipe_run_elsewhere(elsewhere):
    for recipe in ("cornell_reflectance", "point_light"):
        said = elsewhere("radbp", "optimize", recipe, "--steps", "3", "-D", "render.spp=1")
        assert (elsewhere.folder / "runs" / recipe / "report.html").stat().st_size > 10_000, said


@pytest.mark.deep
def test_a_gltf_file_is_rendered_elsewhere(elsewhere):
    found = elsewhere("python", "-c", "import torch_radbp as rb; print(rb.asset('pot/pot.glb'))").strip()
    assert Path(found).is_relative_to(elsewhere.folder.parent)
    shutil.copy(found, elsewhere.folder / "pot.glb")
    elsewhere("radbp", "render", "pot.glb", "-o", "pot.png", "-D", "light=0.15", "-D", "resolution=24", "--spp", "2")
    images = sorted(path.name for path in elsewhere.folder.glob("pot_view_*.png"))
    assert len(images) == 8


@pytest.mark.deep
def test_a_script_recovers_a_colour_elsewhere(elsewhere):
    (elsewhere.folder / "script.py").write_text(SCRIPT)
    check_found(elsewhere("python", "script.py"), elsewhere.folder.parent)


@pytest.mark.deep
def test_a_type_checker_takes_the_types_of_what_is_installed(elsewhere):
    if find_spec("mypy") is None:
        pytest.skip("needs mypy, of the extra `test`")
    script = shutil.copy(ROOT / "tests" / "typing" / "every_public_name.py", elsewhere.folder / "typed.py")
    run(sys.executable, "-m", "mypy", "--strict", "--python-executable", elsewhere.python, "--cache-dir",
        elsewhere.folder / "mypy", script, cwd=elsewhere.folder, env=outside(elsewhere.folder))


@pytest.mark.deep
def test_doctor_finds_nothing_wrong_elsewhere(elsewhere):
    said = elsewhere("radbp", "doctor")
    assert "torch_radbp" in said and "wrong" not in said
