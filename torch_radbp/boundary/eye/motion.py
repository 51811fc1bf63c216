"""The motion of discontinuity curves on the film, and its derivative by what the curves depend on.

Where the backward pass alone is asked for, how curves follow is computed at once, so that nothing of the scene is kept.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.adjoint.function import asks_for_gradient
from torch_radbp.adjoint.scatter import Contribution, Gradients, gradients_of
from torch_radbp.boundary.curve.film_term import FILM_TERMS
from torch_radbp.boundary.curve.geometry import Geometry
from torch_radbp.boundary.curve.places import Places
from torch_radbp.boundary.eye.deposit import MotionFunction
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.differentiated import detached, differentiable, primal
from torch_radbp.tensors.lookup import Tap, summed, tapped
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import rows
from torch_radbp.tensors.vector_jacobian import TableAdjoint, table_adjoints, vector_jacobian_product, zeros_unless


class JumpPlaces(NamedTuple):
    """Visible samples on discontinuity curves, with the jump of the image at each."""

    places: Places  # among others
    shown: Tensor  # (K,) int32, indices of the visible ones
    strength: tuple[Tensor, ...]  # (K,) float64 for each channel: value behind the curve less value ahead
    kinds: tuple[int, ...]  # kinds of curves inside of triangles among them


def moved_places(stages: Stages, geometry: Geometry, camera: Camera, jumps: JumpPlaces, taped: bool) -> Tensor:
    """(K,) float64 zeros whose derivatives are those of the areas that the curves sweep on the film at samples.

    Args:
        stages: of the call.
        geometry, camera: attached.
        jumps: the samples.
        taped: whether autograd records all operations, for second derivatives.
    """
    if taped or has_tangents((geometry, camera)):
        geometry = geometry if has_tangents(geometry) else summed(geometry)
        return stages(swept)(geometry, camera, jumps.places, jumps.shown, jumps.kinds)
    wanted, leaves = [tuple(asks_for_gradient(part)) for part in (geometry, camera)], [
        leaf for part in (geometry, camera) for leaf in differentiable(part)]
    tables, lens = stages(slopes)(detached(geometry), detached(camera), *wanted, jumps.places, jumps.shown, jumps.kinds)
    found = [Contribution(leaf, *read) for leaf, reads in enumerate(tables) for read in reads]
    found += [Contribution(len(tables) + number, torch.zeros_like(jumps.shown), slope) for number, slope in enumerate(lens)]
    shapes = [leaf.detach() for leaf in leaves]

    def adjoint(asked: Tensor) -> list[Tensor | None]:
        gradients = Gradients(shapes)
        scaled = stages(scaled_slopes)(tuple([part.adjoint for part in found]), asked)
        gradients.add([part._replace(adjoint=own) for part, own in zip(found, scaled)])
        return gradients_of([gradients])[0]

    return MotionFunction.apply(len(jumps.shown), adjoint, *leaves)


@stage()
def scaled_slopes(slopes: tuple[Tensor, ...], by_area: Tensor) -> tuple[Tensor, ...]:
    """The derivatives of the loss by what swept areas depend on, (K,) float64 each; `by_area`: those by the areas."""
    return tuple(slope * by_area for slope in slopes)


@stage("geometry", "camera", "places")
def swept(geometry: Geometry, camera: Camera, places: Places, chosen: Tensor, kinds: tuple[int, ...]) -> Tensor:
    """(K,) zeros whose derivatives are those of the areas of the film, in pixels, that pieces of curves sweep.

    Args:
        geometry: of the scene, attached.
        camera: attached.
        places: the samples, of which some are used.
        chosen: (K,) int32, the indices of the samples to use.
        kinds: the kinds of curves that may be among the samples.
    """
    area = signed_area(geometry, camera, rows(places, chosen), kinds)
    return area - primal(area)


def signed_area(geometry: Geometry, camera: Camera, places: Places, kinds: tuple[int, ...]) -> Tensor:
    """The areas that pieces of curves sweep, up to constants, (N,) attached: film position along the piece's normal, and
    level. Args as for `swept`.
    """
    seen = camera.kind.project(camera.lens, places.at(geometry), places.aperture)
    area = seen.x * camera.film.size_x * places.normal.x + seen.y * camera.film.size_y * places.normal.y
    for kind in kinds:
        term, = (term for term in FILM_TERMS if kind in term.kinds)
        level = term.level(geometry, camera, places, kind)
        if level is not None:
            area = area + torch.where(places.kind == kind, places.drift * level, 0.0)
    return area


class Slopes(NamedTuple):
    """The derivatives of swept areas by scene and camera, (K,) each."""

    tables: list[list[TableAdjoint]]  # for each differentiated leaf of the geometry, per entry read
    lens: list[Tensor]  # for each differentiated leaf of the camera


@stage("geometry", "camera", "places")
def slopes(geometry: Geometry, camera: Camera, wanted: tuple[bool, ...], wanted_of_camera: tuple[bool, ...],
           places: Places, chosen: Tensor, kinds: tuple[int, ...]) -> Slopes:
    """The derivatives of the areas that pieces of curves sweep on the film, by what geometry and camera hold.

    Args:
        geometry, camera: detached; the rest as for `swept`.
        wanted, wanted_of_camera: for each leaf, in the order of `leaves_of`, whether to differentiate by it.
    """
    places = rows(places, chosen)
    taps: list[Tap] = []
    attached, _ = tapped(geometry, wanted, 0, taps)
    none = torch.zeros_like(places.u)
    numbers = [(none + leaf).requires_grad_() if want else leaf for leaf, want in zip(leaves_of(camera), wanted_of_camera)]
    lens = [leaf for leaf, want in zip(numbers, wanted_of_camera) if want]
    with torch.enable_grad():
        area = signed_area(attached, with_leaves(camera, numbers), places, kinds)
        reads = [read.leaf for tap in taps for read in tap.reads]
        adjoints = iter(vector_jacobian_product([area], [*reads, *lens], [torch.ones_like(area)]))
    tables = [by_index(table_adjoints(tap, adjoints)) for tap in taps]
    return Slopes(tables, [zeros_unless(next(adjoints), leaf) for leaf in lens])


def by_index(reads: list[TableAdjoint]) -> list[TableAdjoint]:
    """The adjoints of a table's reads, with those of equal indices summed in float64."""
    found: dict[int, TableAdjoint] = {}
    for index, adjoint in reads:
        known = found.get(id(index))
        found[id(index)] = TableAdjoint(index, adjoint.double() if known is None else known.adjoint + adjoint.double())
    return list(found.values())
