"""Recipes as TOML files: reading with overrides by `-D`, and writing the recipe as used."""

import re
from pathlib import Path

import tomli_w
from pydantic import ValidationError

from torch_radbp.formats.atomic import replacing
from torch_radbp.training.commands.bundled import is_bundled
from torch_radbp.training.recipe import Recipe
from torch_radbp.training.recipe_parameter import OFFSET, VALUE

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib


SHOWN = 10  # faults of a recipe that a message lists
AGAIN = "# To run it again: radbp optimize recipe.toml --allow-outside (its files lie elsewhere)\n\n"
# An array of numbers as tomli_w writes it, one to a line.
NUMBERS = re.compile(r"\[\n\s*((?:[-+.\w]+,?\s+)*)\]")


class RecipeError(ValueError):
    """A recipe that cannot be run; the message names the file, the table and the key."""


def read_recipe(path, overrides: list[str] = (), allow_outside: bool = False) -> Recipe:
    """Reads and checks a recipe.

    Args:
        path: the TOML file; paths inside are relative to it.
        overrides: `key=value` strings, keys dotted (`render.spp=32`, `parameters.0.initial=[0.2, 0.2, 0.2]`), values in
            TOML (a bare word is a string).
        allow_outside: also take files that do not lie in the recipe's folder, or below. Those
            of recipes that come with the package are taken anyway.

    Raises:
        RecipeError: not TOML, unknown key, wrong value, missing file, or one outside of the folder.
        FileNotFoundError: no such recipe.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such recipe: {path}")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RecipeError(f"{path}: not valid TOML: {error}") from None
    except RecursionError:
        raise RecipeError(f"{path}: not a recipe: arrays or tables are nested too deeply") from None
    for override in overrides:
        _override(data, override)
    try:
        return Recipe.model_validate(data, context={"base_dir": path.resolve().parent,
                                                    "allow_outside": allow_outside or is_bundled(path)})
    except ValidationError as error:
        lines = _lines(error, data)
        more = [f"and {len(lines) - SHOWN} more"] if len(lines) > SHOWN else []
        raise RecipeError("\n".join(f"{path}: {line}" for line in [*lines[:SHOWN], *more])) from None


def write_recipe(recipe: Recipe, path: Path) -> None:
    """Writes the recipe, wholly or not at all; its paths become relative to the new file, so that it can be run."""
    context = {"base_dir": path.resolve().parent}
    text = tomli_w.dumps(recipe.model_dump(mode="json", exclude_none=True, context=context))
    # tomli_w puts every number of an array on a line of its own; bounds and colours read better on one.
    text = NUMBERS.sub(lambda array: f"[{array[1].strip().rstrip(',')}]", text)
    text = re.sub(r"(?<=[\d.]),\n\s+(?=[-+\d])", ", ", text)
    with replacing(path) as partial:
        partial.write_text(AGAIN + text, encoding="utf-8")


def _override(data: dict, override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise RecipeError(f"-D {override!r}: expected key=value, for instance render.spp=32")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    *parents, last = key.strip().split(".")
    table = data
    for name in parents:
        table = _step_into(table, name, override)
    if isinstance(table, list):
        table[_list_index(table, last, override)] = value
    else:
        table[last] = value


def _step_into(table, name: str, override: str):
    if isinstance(table, list):
        table = table[_list_index(table, name, override)]
    else:
        table = table.setdefault(name, {})
    if not isinstance(table, (dict, list)):
        raise RecipeError(f"-D {override!r}: {name!r} is a value, not a table")
    return table


def _list_index(table: list, name: str, override: str) -> int:
    if not name.isdigit() or int(name) >= len(table):
        raise RecipeError(f"-D {override!r}: expected an index from 0 to {len(table) - 1}, got {name!r}")
    return int(name)


def _lines(error: ValidationError, data: dict) -> list[str]:
    """One line for each place that is wrong; the branches of a union that share a place share the line."""
    messages: dict[str, list[str]] = {}
    for each in error.errors(include_url=False):
        place = _place(each["loc"], data)
        message = each["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
        if each["type"] == "missing":
            message = "this key is required"
        elif each["type"] == "path_type":
            message = f"must be the path of a file, got {each['input']!r}"
        elif each["type"].startswith("union_tag"):
            tags = each["ctx"].get("expected_tags", "")
            tag = each["ctx"].get("tag")
            message = f"name must be one of {tags}, got {tag!r}" if tag else 'a key name = "..." is required'
        elif not isinstance(each["input"], (dict, list)) and each["type"] != "value_error":
            message = f"{message}, got {each['input']!r}"
        if message not in messages.setdefault(place, []):
            messages[place].append(message)
    return [f"{place}: {'; or '.join(found)}" for place, found in messages.items()]


def _place(location: tuple, data) -> str:
    """Says where in the TOML text a pydantic location is, without the names of union branches."""
    parts = []
    for name in location:
        if name in (VALUE, OFFSET):
            continue
        if isinstance(name, int):
            if parts:
                parts[-1] += f"[{name}]"
            data = data[name] if isinstance(data, list) and name < len(data) else None
            if isinstance(data, dict) and isinstance(data.get("name"), str):
                parts[-1] += f" ({data['name']!r})"
        elif isinstance(data, dict) and name in data:
            parts.append(name)
            data = data[name]
        elif name in Recipe.model_fields or isinstance(data, dict) and data.get("name") != name:
            parts.append(name)
            data = None
    return ".".join(parts) if parts else "recipe"
