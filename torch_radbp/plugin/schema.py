"""The schema of a plugin class: its attributes, their annotations and defaults, read from the constructor's signature."""

from __future__ import annotations

import inspect
import types
import typing
from functools import cache
from typing import Any, NamedTuple

from torch import Tensor


class Matrix4(Tensor):
    """Annotation of a (4, 4) transform, world from local."""


class Point3(Tensor):
    """Annotation of three floats."""


class Filename(str):
    """Annotation of a path to a file, relative to the scene description."""


class TriangleMesh:
    """Annotation of a `trimesh.Trimesh` or a `trimesh.Scene`, or of a record `MeshArrays` made of one."""


class Attribute(NamedTuple):
    """One row of a plugin's schema."""

    annotation: Any
    default: Any
    required: bool


@cache
def attributes(cls: type) -> dict[str, Attribute]:
    """The schema of a plugin class, by attribute name; not to be changed."""
    hints = typing.get_type_hints(cls.__init__)
    schema = {}
    for name, parameter in inspect.signature(cls.__init__).parameters.items():
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
            required = parameter.default is inspect.Parameter.empty
            schema[name] = Attribute(hints[name], None if required else parameter.default, required)
    return schema


def options(annotation: Any) -> tuple[Any, ...]:
    """The members of a union, or the annotation alone."""
    is_union = typing.get_origin(annotation) in (types.UnionType, typing.Union)
    return typing.get_args(annotation) if is_union else (annotation,)
