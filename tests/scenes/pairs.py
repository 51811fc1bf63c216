"""Which pairs of plugin and parameter there are, by the code, and which a scene examines."""

from __future__ import annotations

import functools
import inspect
import re
import typing
from typing import NamedTuple

import torch_radbp as rb
from tests.scenes.every_plugin import subjects
from torch_radbp.plugin import BSDF, REGISTRY, Phase, Plugin, Texture, attributes

CATEGORIES = ("shape", "bsdf", "texture", "emitter", "sensor", "medium", "phase", "volume")


class Pair(NamedTuple):
    """A parameter of a plugin; of what it nests, the attribute that holds it."""

    plugin: str
    parameter: str

    def __str__(self) -> str:
        return f"{self.plugin}: {self.parameter}"


def registered() -> set[Pair]:
    """All pairs: what the classes register as parameters, and the textures that they take."""
    return {Pair(f"{category} {kind}", parameter) for category in CATEGORIES for kind, plugin in REGISTRY[category].items()
            for parameter in own_parameters(plugin) | nested(plugin)}


source = functools.cache(inspect.getsource)


@functools.cache
def own_parameters(plugin: type[Plugin]) -> set[str]:
    """Names that the code of a class, or of what it is derived from, gives to `freeze` or to torch, or says it may give."""
    code = "".join(source(base) for base in plugin.__mro__ if issubclass(base, Plugin) and base is not Plugin)
    return set(re.findall(r"(?:freeze|register_parameter)\(\s*\"(\w+)\"", code)) | set(
        re.findall(r"self\.(\w+) = (?:torch\.)?nn\.Parameter", code)) | set(getattr(plugin, "optional_parameters", ()))


def nested(plugin: type[Plugin]) -> set[str]:
    """Attributes that take a texture, and the two materials or phase functions of one that takes several."""
    found = set()
    for name, attribute in attributes(plugin).items():
        if Texture in (attribute.annotation, *typing.get_args(attribute.annotation)):
            found.add(name)
        if attribute.annotation in (list[BSDF], list[Phase]):
            found |= {f"{name}_0", f"{name}_1"}
    return found


def pairs_of(scene: rb.Scene, name: str) -> set[Pair]:
    """The pairs that a parameter belongs to: its plugin's, and those of the plugins that hold it."""
    path, found = name.split("."), set()
    for depth in range(1, len(path)):
        plugin = scene.get_submodule(".".join(path[:depth]))
        found.add(Pair(f"{plugin.category} {plugin.type}", path[depth]))
    return found


def examined(scene: rb.Scene) -> set[Pair]:
    """The pairs that the parameters of the scene's subject belong to."""
    return set().union(*(pairs_of(scene, name) for name in subjects(scene)))
