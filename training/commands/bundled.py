"""The recipes that come with the package, by name."""

from pathlib import Path

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

FOLDER = Path(__file__).parents[1] / "recipes"


def bundled_recipes() -> dict[str, Path]:
    """Returns the recipes that come with the package by name, sorted."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.toml"))}


def is_bundled(path: Path) -> bool:
    """Returns whether a recipe comes with the package; such name files of the package's assets."""
    return path.resolve().parent == FOLDER.resolve()


def recipe_path(given: Path) -> Path:
    """Returns the file that an argument of the command line means: a path, or the name of a bundled recipe.

    Raises:
        FileNotFoundError: neither; the message lists the names.
    """
    bundled = bundled_recipes()
    if given.is_file():
        return given
    if str(given) in bundled:
        return bundled[str(given)]
    problem = f"{given} is a folder, not a recipe" if given.is_dir() else f"no such recipe: {given}"
    raise FileNotFoundError(f"{problem}; those that come with the package are {', '.join(bundled)}")


def listing() -> str:
    """Returns one line for each bundled recipe: its name and its title."""
    titles = {name: tomllib.loads(path.read_text(encoding="utf-8"))["title"] for name, path in bundled_recipes().items()}
    width = max(map(len, titles))
    return "\n".join(f"{name:{width}}  {title}" for name, title in titles.items())
