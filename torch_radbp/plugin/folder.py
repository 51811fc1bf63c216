"""Imports all plugin files of a folder, each of which registers itself."""

from collections.abc import Iterable
from importlib import import_module
from pkgutil import iter_modules


def import_files(package: str, path: Iterable[str]) -> None:
    """Imports every file of a package, given its `__name__` and `__path__`."""
    for file in iter_modules(path, f"{package}."):
        import_module(file.name)
