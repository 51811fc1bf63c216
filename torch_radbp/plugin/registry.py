"""The registry of plugins by category and type name, and of Mitsuba's plugins that are missing here."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, MutableMapping
from typing import TypeVar

Class = TypeVar("Class", bound=type)
PACKAGES = ("bsdf", "emitter", "film", "integrator", "medium", "phase", "sensor", "shape", "texture", "volume")  # of plugins


class PluginTypes(MutableMapping):
    """The plugin classes of one category by type name; the package's own are imported at first use."""

    complete = False  # all of the package's plugins are imported, those of every category

    def __init__(self) -> None:
        self.registered: dict[str, type] = {}

    def all(self) -> dict[str, type]:
        """All registered classes by name, after importing the package's plugins."""
        if not PluginTypes.complete:
            for package in PACKAGES:
                importlib.import_module(f"torch_radbp.{package}")
            PluginTypes.complete = True
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


REGISTRY: dict[str, PluginTypes] = {
    name: PluginTypes()
    for name in ("shape", "bsdf", "texture", "emitter", "sensor", "film", "rfilter", "sampler", "integrator",
                 "medium", "phase", "volume")
}


ABSENT: dict[tuple[str, str], str] = {}  # plugins of Mitsuba that are not there: why, and what to use


def register(category: str, name: str) -> Callable[[Class], Class]:
    """Class decorator that registers a plugin as `category` / `name`."""

    def add(cls: Class) -> Class:
        cls.category, cls.type = category, name
        REGISTRY.setdefault(category, PluginTypes())[name] = cls
        return cls

    return add


def absent(category: str, name: str, reason: str) -> None:
    """Registers why a plugin of Mitsuba is missing, and what to use in its place, for the loader's error."""
    ABSENT[category, name] = reason
