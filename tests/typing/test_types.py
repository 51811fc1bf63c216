"""Types of what is public: every signature has them, and a checker understands a user's script by them."""

import ast
import inspect
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest

import torch_radbp as rb

PACKAGE = Path(rb.__file__).parent
SCRIPT = Path(__file__).with_name("every_public_name.py")
PUBLIC = {"rb": rb, "rb.bake": rb.bake, "rb.losses": rb.losses, "rb.priors": rb.priors, "rb.optim": rb.optim}

WRONG = """
import torch_radbp as rb

scene = rb.load("scene.xml")
rb.render(scene, seed="one")
rb.render(scene).no_method()
rb.Renderer(scene)(seed=0, aovs=["depth"]).mean()
rb.losses.two_buffer_l3
rb.optim.LargeSteps(1)
rb.no_such_part
rb.render(scene, sppp=4)
rb.check_gradient(scene, "white.reflectance.value", max_depth="six")
rb.camera_from_opencv(None, None, None, 4, 4, near=1.0)
"""


def functions() -> Iterator[tuple[str, Callable]]:
    """Public functions, and the public methods of public classes, by name."""
    for home, module in PUBLIC.items():
        for name in module.__all__:
            thing = getattr(module, name)
            if not inspect.isclass(thing):
                yield f"{home}.{name}", thing
                continue
            for attribute, value in vars(thing).items():
                value = value.fget if isinstance(value, property) else inspect.unwrap(getattr(value, "__func__", value))
                if inspect.isfunction(value) and (attribute == "__init__" or not attribute.startswith("_")):
                    yield f"{home}.{name}.{attribute}", value


@pytest.mark.parametrize("function", [pytest.param(function, id=name) for name, function in functions()])
def test_every_argument_and_every_result_has_a_type(function):
    signature = inspect.signature(function)
    untyped = [name for name, each in signature.parameters.items()
               if each.annotation is each.empty and name not in ("self", "cls")]
    if signature.return_annotation is signature.empty and function.__name__ != "__init__":
        untyped.append("the result")
    assert not untyped


def test_the_script_has_every_public_name():
    used = {ast.unparse(node) for node in ast.walk(ast.parse(SCRIPT.read_text())) if isinstance(node, ast.Attribute)}
    assert {f"{home}.{name}" for home, module in PUBLIC.items() for name in module.__all__} <= used


def test_type_checkers_are_told_that_there_are_types():
    assert (PACKAGE / "py.typed").read_text() == ""


@pytest.mark.deep
def test_mypy_finds_nothing_in_the_script_and_what_is_wrong_in_another(tmp_path):
    if find_spec("mypy") is None:
        pytest.skip("needs mypy, of the extra `test`")
    wrong = tmp_path / "wrong.py"
    wrong.write_text(WRONG)
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--no-error-summary",
               "--cache-dir", tmp_path, SCRIPT, wrong]
    done = subprocess.run([*map(str, command)], cwd=PACKAGE.parent, capture_output=True, text=True)
    found = {(Path(path).name, int(line)) for path, line in re.findall(r"^(.*?):(\d+): error: ", done.stdout, re.M)}
    assert found == {("wrong.py", line) for line in range(5, 14)}, done.stdout + done.stderr
