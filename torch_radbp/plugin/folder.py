"""Folders of plugins: a file in one is a plugin, and registers itself when it is imported."""

from collections.abc import Iterable
from importlib import import_module
from pkgutil import iter_modules


def import_files(package: str, path: Iterable[str]) -> None:
    """Imports every file of a package, of which `__name__` and `__path__` are given."""
    for file in iter_modules(path, f"{package}."):
        import_module(file.name)
