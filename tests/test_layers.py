"""The order of the package and of its tests: imports go one way, and what is public is documented."""

import ast
import importlib.util
import inspect
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import torch_radbp as rb

PACKAGE = Path(rb.__file__).parent
TRAINING = PACKAGE.parent / "training"
TESTS = Path(__file__).parent

# Data flows down this list; a part may import from the layers above its own, and nothing beside itself.
LAYERS = [
    {"tensors", "plugin", "install_hint"},
    {"jit", "sampling", "film", "transforms", "pose", "losses", "priors", "integrator", "formats"},
    {"texture", "sensor", "phase", "public_call"}, {"shape", "bsdf", "emitter", "volume"}, {"medium"}, {"scene"},
    {"raycast", "optim", "io", "bake"}, {"path", "photographs"}, {"call"}, {"adjoint"}, {"boundary", "aov"}, {"rendering"},
    {"check"}, {"public"}, {"training"},
]
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}


class Import(NamedTuple):
    """An import of one part of the package by another; parts are the first names below `torch_radbp`."""

    file: str
    line: int
    importer: str
    imported: str


def part_of(path: Path) -> str:
    if path.is_relative_to(TRAINING):
        return "training"
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(path: Path) -> list[Import]:
    """All imports of torch_radbp in a file, those inside functions and behind TYPE_CHECKING included."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}, line {node.lineno}: relative import"
            whole = node.module == "torch_radbp"
            names = [f"{node.module}.{alias.name}" for alias in node.names] if whole else [node.module]
        found += [Import(str(path), node.lineno, part_of(path), name.split(".")[1] if "." in name else "__init__")
                  for name in names if name.split(".")[0] == "torch_radbp"]
    return found


def named(node: ast.Import | ast.ImportFrom) -> list[str]:
    """The modules and names that an import names, with dots between."""
    return [f"{getattr(node, 'module', None) or ''}.{alias.name}" for alias in node.names]


def running(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a module but for those that type checkers alone read."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")):
            yield from (node, *running(node))


FILES = sorted(path for folder in (PACKAGE, TRAINING) for path in folder.rglob("*.py"))
IMPORTS = [found for path in FILES for found in imports(path)]


def say(wrong: list[Import]) -> str:
    return "\n".join(f"{i.file}:{i.line}: {i.importer} imports {i.imported}" for i in wrong)


def test_the_imports_are_found():
    assert len(IMPORTS) > 100
    assert {"path", "adjoint", "scene", "tensors"} <= {i.imported for i in IMPORTS}


def test_every_part_has_its_layer():
    known = {*RANK, "__init__"}
    assert {part_of(path) for path in FILES} <= known
    assert {i.imported for i in IMPORTS} <= known


def test_imports_go_one_way():
    wrong = [i for i in IMPORTS if i.importer in RANK and i.imported in RANK and i.imported != i.importer
             and RANK[i.imported] >= RANK[i.importer]]
    assert not wrong, say(wrong)


def test_a_part_is_not_asked_of_the_package():
    """`from torch_radbp import adjoint` imports all public names first, and so, perhaps, the module that it stands in."""
    wrong = [f"{path}:{node.lineno}" for path in FILES if not path.is_relative_to(TRAINING)
             for node in running(ast.parse(path.read_text()))
             if isinstance(node, ast.ImportFrom) and node.module == "torch_radbp"]
    assert not wrong, wrong


def is_module(name: str) -> bool:
    """Whether there is a module of that name."""
    return importlib.util.find_spec(name) is not None


def test_what_is_imported_exists():
    """Inside functions, too, which no other test need run."""
    wrong = []
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("torch_radbp"):
                module = importlib.import_module(node.module)
                for alias in node.names:
                    if alias.name != "*" and not (hasattr(module, alias.name) or is_module(f"{node.module}.{alias.name}")):
                        wrong += [f"{path}:{node.lineno}: {node.module} has no {alias.name}"]
    assert not wrong, "\n".join(wrong)


def test_only_training_imports_the_package_as_a_whole():
    wrong = [i for i in IMPORTS if i.imported in ("__init__", "public") and i.importer not in ("__init__", "training")]
    assert not wrong, say(wrong)


def test_nothing_is_imported_from_a_test():
    """What two tests need, or a benchmark, stands in a module of its own; scenes in `tests/scenes`."""
    files = [path for name in ("tests", "benchmarks", "docs") for path in (TESTS.parent / name).rglob("*.py")]
    found = [(path, node) for path in files for node in ast.walk(ast.parse(path.read_text()))
             if isinstance(node, ast.Import | ast.ImportFrom)]
    wrong = [f"{path}:{node.lineno}" for path, node in found
             if any(part.startswith("test_") for name in named(node) for part in name.split("."))]
    assert len(found) > 1000 and not wrong, wrong


def test_no_two_things_of_the_package_have_one_name():
    """Classes and functions at the top of files; those with a leading underscore are for their file alone."""
    homes: dict[str, set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and not node.name.startswith("_"):
                homes.setdefault(node.name, set()).add(str(path.relative_to(PACKAGE)))
    shared = [f"{name}: {', '.join(sorted(files))}" for name, files in sorted(homes.items()) if len(files) > 1]
    assert len(homes) > 1000 and not shared, "\n".join(shared)


def modules() -> list[str]:
    names = [module.name for module in pkgutil.walk_packages(rb.__path__, "torch_radbp.")]
    return ["torch_radbp", *names]


@pytest.mark.parametrize("name", modules())
def test_a_module_says_what_it_is(name):
    if name == "torch_radbp.raycast.warp":
        pytest.importorskip("warp")
    doc = importlib.import_module(name).__doc__
    assert doc and doc.strip()[0].isupper() | doc.strip().startswith(("`", "torch_radbp", "[")), name


def documented(thing) -> bool:
    return bool(thing.__doc__) and not thing.__doc__.startswith(f"{thing.__name__}(")  # as dataclasses write it themselves


@pytest.mark.parametrize("name", rb.__all__)
def test_every_public_name_has_a_docstring_and_so_have_its_methods(name):
    thing = getattr(rb, name)
    assert documented(thing), name
    if inspect.isclass(thing):
        own = {key: value for key, value in vars(thing).items() if not key.startswith("_") and inspect.isfunction(value)}
        # What every strategy has to offer is said once, where the sweep calls it.
        missing = [key for key, value in own.items() if not value.__doc__ and key != "kept"]
        assert not missing, f"{name}: {missing}"


def test_public_names_are_sorted_and_there():
    assert sorted(rb.__all__) == rb.__all__
    assert all(hasattr(rb, name) for name in rb.__all__)


@pytest.mark.parametrize("path", [path for path in FILES if path.name != "__init__.py"],
                         ids=lambda path: str(path.relative_to(PACKAGE.parent)))
def test_a_file_has_one_thing_and_a_name_that_says_which(path):
    assert path.stem not in ("utils", "helpers", "common", "misc")
    assert len(path.read_text().splitlines()) <= 400, "take a hard look: past 300 lines there is a second thing in it"
