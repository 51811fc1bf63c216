"""The registry of the plugins of one category."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, MutableMapping

PACKAGES = ("bsdf", "emitter", "film", "integrator", "sensor", "shape", "texture")  # their import registers plugins


class PluginTypes(MutableMapping):
    """The plugin classes of one category by type name; the package's own are imported when they are first asked for."""

    def __init__(self) -> None:
        self.registered: dict[str, type] = {}

    def all(self) -> dict[str, type]:
        """All registered classes by name; imports the package's plugins first."""
        for package in PACKAGES:
            importlib.import_module(f"torch_radbp.{package}")
        return self.registered

    def __getitem__(self, name: str) -> type:
        return self.all()[name]

    def __setitem__(self, name: str, cls: type) -> None:
        self.registered[name] = cls

    def __delitem__(self, name: str) -> None:
        del self.registered[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.all())

    def __len__(self) -> int:
        return len(self.all())
