"""The kinds of light in a scene's light table, and the lanes that have each."""

from __future__ import annotations

import functools
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.emitter import LightKind
from torch_radbp.interface.texture import TexturePoint, TextureValue
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import selected
from torch_radbp.tensors.vec import Vec3, where


class Case(NamedTuple):
    """One kind of light in a scene, and the lanes whose light is of that kind."""

    number: int  # in `Layout.lights`
    kind: LightKind
    mask: Tensor | None  # (N,) bool: the lanes that it concerns; None: all


def light_cases(scene: SceneTensors, element: Tensor, kinds: dict[int, LightKind]) -> list[Case]:
    """For each kind of light the lanes whose element of the light table has it."""
    if len(kinds) == 1:
        return [Case(*item, None) for item in kinds.items()]
    which = lookup(scene.lights.kind, element)
    return [Case(number, kind, which == number) for number, kind in kinds.items()]


def visible_cases(scene: SceneTensors, element: Tensor) -> list[Case]:
    """For each kind of surface light that is visible as an emitter, the lanes whose element has it."""
    return [case for case in light_cases(scene, element, scene.layout.surface_lights) if not case.kind.delta]


def rows_of_case(scene: SceneTensors, element: Tensor, case: Case) -> Tensor:
    """The rows of elements in the table of one kind of light; 0 for elements of another kind."""
    if case.mask is None:
        return element  # those of one kind come in the order of its table
    return torch.where(case.mask, lookup(scene.lights.row, element), 0)


def in_lanes_of(case: Case, condition: Tensor) -> Tensor:
    """A condition, (N,) bool, restricted to the lanes of one kind of light."""
    return condition if case.mask is None else case.mask & condition


def texture_of_light(scene: SceneTensors, element: Tensor, p: Vec3, point: TexturePoint,
                     texture_values: tuple[TextureValue, ...]) -> Vec3:
    """The emission textures of elements of the light table, evaluated at points; attached.

    Args:
        scene, element: the light table, and (N,) rows of it.
        p: world positions of the points.
        point: the same as texture coordinates.
        texture_values: for each of `Layout.lit` its network texture values there.
    """
    value = scene.layout.radiance.read(scene.radiance, lookup(scene.lights.radiance, element), point)
    for reader, rows, outside_value in zip(scene.layout.lit, scene.lights.outside, texture_values):
        value = where(lookup(rows, element) >= 0, outside_value.at(reader.place(p, point.uv)), value)
    return value


def among(cases: list[Case], wanted: list[bool], element: Tensor) -> Tensor | None:
    """(N,) bool: lanes whose kind of light is one of those flagged in `wanted`; None if no kind is."""
    if all(wanted):
        return torch.ones_like(element, dtype=torch.bool)
    masks = [case.mask for case, want in zip(cases, wanted) if want]
    return functools.reduce(torch.logical_or, masks) if masks else None


def merged_by_case(cases: list[Case], values: list):
    """Merges values that were computed for each kind of light by the kind of each lane; None only if all are None."""
    result = None
    for case, value in zip(cases, values):
        if result is None:
            result = value
        elif value is not None:
            result = selected(case.mask, value, result)
    return result
