"""Tutorials and examples are short, use public names, run in their smallest form, and find what they promise (deep)."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import torch_radbp as rb
from tests.deep import deep

ROOT = Path(__file__).parents[2]
OUTPUT = "output.txt"  # as `quick_run` calls it
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("[0-9]*.py"))
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
MODULES = {"bake", "losses", "optim", "priors"}  # public modules
FOR_PLUGINS = {"interface", "plugin", "tensors", "texture"}  # what is derived from where a plugin is written
# Of large meshes, of hundreds of renderings, and of 24 cameras, in the smallest form, too.
SLOW = {"06_shape", "15_three_materials", "unknown_light"}
MOST_LINES, MOST_OF_AN_EXAMPLE = 62, 40
WIDEST = 90  # characters of code that fit the box of a page, of which `python -m docs.widths` measures the pixels


def code_lines(script: Path) -> int:
    """The lines of a script that are neither text nor empty."""
    tree, lines = ast.parse(script.read_text()), script.read_text().splitlines()
    described = [node.body[0] for node in ast.walk(tree) if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef)
                 and ast.get_docstring(node)]
    text = {number for each in described for number in range(each.lineno, each.end_lineno + 1)}
    return sum(bool(line.strip()) and not line.lstrip().startswith("#") and number not in text
               for number, line in enumerate(lines, 1))


def run(*command: object, cwd: Path = ROOT) -> str:
    """Standard output of a script that must end well."""
    environment = os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, *map(str, command)], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_is_short_and_checks_at_its_end_what_it_promises(tutorial):
    assert code_lines(tutorial) <= MOST_LINES
    assert isinstance(ast.parse(tutorial.read_text()).body[-1], ast.Assert)


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_code_of_a_tutorial_fits_the_box_of_its_page(tutorial):
    code = [line for line in tutorial.read_text().splitlines() if not line.startswith("#")]
    assert not [line for line in code if len(line) > WIDEST]


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_images_of_a_tutorial_have_128_pixels(tutorial):
    sizes = re.findall(r"(?:resolution=|\"(?:width|height)\": )(\d+)", tutorial.read_text())
    small = [int(size) for size in sizes if int(size) < 128]
    assert not small or "imshow" not in tutorial.read_text()  # unless it shows none


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_how_it_is_run(example):
    assert code_lines(example) <= MOST_OF_AN_EXAMPLE
    assert f"python examples/{example.name}" in ast.get_docstring(ast.parse(example.read_text()))


@pytest.mark.parametrize("tutorial", [*TUTORIALS, *EXAMPLES], ids=lambda path: path.stem)
def test_a_tutorial_uses_public_names_only(tutorial):
    tree = ast.parse(tutorial.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert not (node.module or "").startswith("torch_radbp"), f"{tutorial.name} imports from {node.module}"
        if isinstance(node, ast.Import):
            assert all(name.name == "torch_radbp" and name.asname == "rb" for name in node.names if "radbp" in name.name)
    used = {node.attr for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "rb"}
    allowed = {*rb.__all__, *MODULES, *(FOR_PLUGINS if tutorial.stem == "09_own_material" else ())}
    assert used and used <= allowed, f"{tutorial.name} uses {used - allowed}"


SCRIPTS = [(deep if path.stem in SLOW else pytest.param)(path, id=path.stem) for path in (*TUTORIALS, *EXAMPLES)]


@pytest.fixture(scope="module")
def run_smallest():
    """Runs a script in its smallest form in a folder, in a process that has imported what scripts import, if it can fork."""
    def alone(script: Path, folder: Path) -> None:
        run("-m", "tests.docs.quick_run", script, cwd=folder)

    if not hasattr(os, "fork"):
        yield alone
        return
    with subprocess.Popen([sys.executable, "-m", "tests.docs.quick_run"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                          text=True, cwd=ROOT, env=os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}) as process:
        def forked(script: Path, folder: Path) -> None:
            process.stdin.write(json.dumps([str(script), str(folder)]) + "\n")
            process.stdin.flush()
            assert process.stdout.readline() == "0\n", (folder / OUTPUT).read_text(errors="replace")

        yield forked
        process.stdin.close()


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_runs_in_its_smallest_form(script, run_smallest, tmp_path):
    run_smallest(script, tmp_path)


def test_the_first_example_of_readme_runs_in_its_smallest_form(run_smallest, tmp_path):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    example, = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (tmp_path / "example.py").write_text(example)
    run_smallest("example.py", tmp_path)


@pytest.mark.deep
@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_runs_and_finds_what_it_promises(tutorial):
    run(tutorial)


def number(text: str, after: str) -> float:
    """The number behind some words."""
    return float(re.search(rf"{after} *(-?[\d.]+)", text)[1])


@pytest.mark.deep
def test_an_asset_is_found_from_views(tmp_path):
    """Its look, its shape and its cameras; how far these are along their line of sight, small images hardly tell."""
    text = run(ROOT / "examples" / "asset_from_views.py", cwd=tmp_path)
    for name, share in {"images": 0.06, "shape": 0.15, "across": 0.5, "turned": 0.6, "along": 0.8}.items():
        before, after = map(float, re.search(rf"{name} +off by ([\d.]+) before, ([\d.]+) after", text).groups())
        assert 0 < after < share * before, name
    assert (tmp_path / "asset_from_views.png").exists()


@pytest.mark.deep
def test_colours_and_exposures_are_found(tmp_path):
    text = run(ROOT / "examples" / "unknown_exposure.py", cwd=tmp_path)
    assert number(text, "colour off by") < 0.4 * number(text, "grey by")
    assert number(text, r"1\.\d+, off by") < 5


@pytest.mark.deep
def test_every_loop_finds_the_colour(tmp_path):
    text = run(ROOT / "examples" / "training_loops.py", cwd=tmp_path)
    errors = [float(error) for error in re.findall(r"off by ([\d.]+)", text)]
    assert len(errors) == 4 and max(errors) < 0.04


@pytest.mark.deep
def test_a_recipe_of_ones_own_converges(tmp_path):
    assert "converged: " in run(ROOT / "examples" / "own_recipe.py", cwd=tmp_path)


@pytest.mark.deep
def test_what_is_found_is_right_by_another_light_only_beside_something_known(tmp_path):
    text = run(ROOT / "examples" / "unknown_light.py", cwd=tmp_path)
    found = {known: (float(same), float(other)) for known, same, other in re.findall(
        r"known is (.*?): +([\d.]+) dB by the same light, ([\d.]+) dB by another", text)}
    assert set(found) == {"nothing", "a grey ball", "a metal ball"} and min(same for same, _ in found.values()) > 30
    assert found.pop("nothing")[1] < 20 and min(other for _, other in found.values()) >= 30
    assert (tmp_path / "unknown_light.png").exists()


@pytest.mark.deep
def test_what_images_cannot_tell_they_tell_with_the_remedy(tmp_path):
    text = run(ROOT / "examples" / "what_is_seen.py", cwd=tmp_path)
    for change in ("less light changes the image by", "distances by", "exposures change images by"):
        without, remedy = map(float, re.findall(rf"{change} ([\d.]+) %", text))
        assert without < 0.01 < 0.3 < remedy, change
    even, lit = map(float, re.findall(r"roughness changes the image by ([\d.]+) %", text))
    one, two = map(int, re.findall(r"without a gradient: (\d+)%", text))
    assert even < 0.2 * lit and two < 5 < 40 < one
