"""The order of the package and of its tests: imports go one way, and what is public is documented."""

import ast
import importlib.util
import inspect
import pkgutil
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

import torch_radbp as rb

PACKAGE = Path(rb.__file__).parent
TRAINING = PACKAGE.parent / "training"
TESTS = Path(__file__).parent
PICTURE = TESTS.parent / "docs" / "reading_the_code.md"

# A room is a folder with code, or a file in none; what is in the package's own folder is called by the package's name. Their
# order is that of their picture, where names stand before three spaces: a room may import from those above it.
SHOWN = PICTURE.read_text(encoding="utf-8").split("## The rooms")[1].split("##")[0]
ROOMS = [name.replace("/", ".") for line in SHOWN.splitlines() if line.startswith("    ")
         for name in re.split(" {3,}", line.strip())[0].split()]
RANK = {name: rank for rank, name in enumerate(ROOMS)}
FLOORS = 14  # the most rooms, one above the other, that a change of the lowest may reach


class Import(NamedTuple):
    """An import of one room by another."""

    file: str
    line: int
    importer: str
    imported: str


def room_of(path: Path) -> str:
    """The room of a file of the package, or of its `training`."""
    if path.is_relative_to(TRAINING):
        return "training"
    folder = path.relative_to(PACKAGE).parent.parts
    return ".".join(folder) or (path.stem if path.stem not in ("__init__", "public") else "torch_radbp")


def room_named(module: str) -> str:
    """The room of a module or of a name in one, `torch_radbp.` before it."""
    parts = module.split(".")[1:]
    if parts[:1] == ["training"]:
        return "training"
    while parts:
        place = PACKAGE.joinpath(*parts)
        if place.is_dir() or place.with_suffix(".py").exists():
            return room_of(place / "__init__.py" if place.is_dir() else place.with_suffix(".py"))
        parts.pop()
    return "torch_radbp"


def is_stage(node: ast.AST) -> bool:
    """True for a function that is declared by `@stage(...)`."""
    return isinstance(node, ast.FunctionDef) and any(
        isinstance(each, ast.Call) and ast.unparse(each.func) == "stage" for each in node.decorator_list)


def modules_named(tree: ast.Module, path: Path) -> Iterator[tuple[int, str]]:
    """The modules and names that a file imports, inside of functions and for type checkers, too, or names without an import:
    modules in texts, and stages as attributes of `stages` or as fields of a record of functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}, line {node.lineno}: relative import"
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Constant) and re.fullmatch(r"torch_radbp(\.\w+)+", str(node.value)):
            yield node.lineno, node.value
        elif isinstance(node, ast.Attribute) and node.attr in STAGES and ast.unparse(node.value).endswith("stages"):
            yield node.lineno, STAGES[node.attr]
        elif isinstance(node, ast.AnnAssign) and ast.unparse(node.annotation).startswith(("Callable", "Stage")):
            yield from ((node.lineno, STAGES[name]) for name in [ast.unparse(node.target)] if name in STAGES)


def imports(path: Path) -> list[Import]:
    """What a file takes from rooms, its own included."""
    return [Import(str(path), line, room_of(path), room_named(name))
            for line, name in modules_named(ast.parse(path.read_text()), path) if name.split(".")[0] == "torch_radbp"]


def named(node: ast.Import | ast.ImportFrom) -> list[str]:
    """The modules and names that an import names, with dots between."""
    return [f"{getattr(node, 'module', None) or ''}.{alias.name}" for alias in node.names]


def running(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a module but for those that type checkers alone read."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")):
            yield from (node, *running(node))


FILES = sorted(path for folder in (PACKAGE, TRAINING) for path in folder.rglob("*.py"))
# Where functions over lanes are defined, by their names: who names one in a text means the function.
STAGES = {node.name: ".".join(("torch_radbp", *path.relative_to(PACKAGE).with_suffix("").parts))
          for path in PACKAGE.rglob("*.py") for node in ast.walk(ast.parse(path.read_text())) if is_stage(node)}
IMPORTS = [found for path in FILES for found in imports(path)]
BETWEEN = [each for each in IMPORTS if each.imported != each.importer]


def say(wrong: list[Import]) -> str:
    return "\n".join(f"{i.file}:{i.line}: {i.importer} imports {i.imported}" for i in wrong)


def floors() -> dict[str, int]:
    """The floor of each room: 1 if it imports none, else one above the highest that it imports.

    Raises:
        graphlib.CycleError: naming the rooms, if some import each other in a circle.
    """
    below = {room: {each.imported for each in BETWEEN if each.importer == room} for room in ROOMS}
    floor: dict[str, int] = {}
    for room in TopologicalSorter(below).static_order():
        floor[room] = 1 + max((floor[other] for other in below.get(room, ())), default=0)
    return floor


@pytest.fixture(scope="module")
def trees() -> dict[Path, ast.Module]:
    """All files of the package, which are read once for several tests."""
    return {path: ast.parse(path.read_text()) for path in FILES}


def test_the_imports_are_found():
    assert len(IMPORTS) > 1000 and len(STAGES) > 50
    assert {"path", "adjoint", "scene.tables", "tensors", "torch_radbp"} <= {i.imported for i in IMPORTS}


def test_names_of_modules_and_stages_count_as_imports():
    stage, home = next(iter(STAGES.items()))
    tree = ast.parse(f"""
run = by_name("torch_radbp.path.trace")
other = call.stages.{stage}(lanes)
class Functions:
    {stage}: Callable
    length: int = len({stage!r})
""")
    assert set(modules_named(tree, Path())) == {(2, "torch_radbp.path.trace"), (3, home), (5, home)}


def test_every_room_is_in_the_picture_once(trees):
    with_code = {room_of(path) for path, tree in trees.items() if len(tree.body) > 1}
    assert sorted(with_code) == sorted(ROOMS)


def test_imports_go_one_way():
    wrong = [i for i in BETWEEN if RANK[i.imported] > RANK[i.importer]]
    assert not wrong, say(wrong)


def test_rooms_have_few_floors_and_no_circles():
    floor = floors()
    assert max(floor.values()) <= FLOORS, sorted(floor.items(), key=lambda each: each[1])


def test_a_part_is_not_asked_of_the_package(trees):
    """`from torch_radbp import adjoint` imports all public names first, and so, perhaps, the module that it stands in."""
    wrong = [f"{path}:{node.lineno}" for path, tree in trees.items() if not path.is_relative_to(TRAINING)
             for node in running(tree)
             if isinstance(node, ast.ImportFrom) and node.module == "torch_radbp"]
    assert not wrong, wrong


def is_module(name: str) -> bool:
    """Whether there is a module of that name."""
    return importlib.util.find_spec(name) is not None


def test_what_is_imported_exists(trees):
    """Inside functions, too, which no other test need run."""
    wrong = []
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("torch_radbp"):
                module = importlib.import_module(node.module)
                for alias in node.names:
                    if alias.name != "*" and not (hasattr(module, alias.name) or is_module(f"{node.module}.{alias.name}")):
                        wrong += [f"{path}:{node.lineno}: {node.module} has no {alias.name}"]
    assert not wrong, "\n".join(wrong)


def test_only_training_imports_the_package_as_a_whole():
    wrong = [i for i in BETWEEN if i.imported == "torch_radbp" and i.importer != "training"]
    assert not wrong, say(wrong)


def test_nothing_is_imported_from_a_test():
    """What two tests need, or a benchmark, stands in a module of its own; scenes in `tests/scenes`."""
    files = [path for name in ("tests", "benchmarks", "docs") for path in (TESTS.parent / name).rglob("*.py")]
    found = [(path, node) for path in files for node in ast.walk(ast.parse(path.read_text()))
             if isinstance(node, ast.Import | ast.ImportFrom)]
    wrong = [f"{path}:{node.lineno}" for path, node in found
             if any(part.startswith("test_") for name in named(node) for part in name.split("."))]
    assert len(found) > 1000 and not wrong, wrong


def test_no_two_things_of_the_package_have_one_name(trees):
    """Classes and functions at the top of files; those with a leading underscore are for their file alone."""
    homes: dict[str, set[str]] = {}
    for path in (path for path in FILES if path.is_relative_to(PACKAGE)):
        for node in trees[path].body:
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
