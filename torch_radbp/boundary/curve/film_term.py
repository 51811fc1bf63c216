"""What a boundary term of curves that the camera sees is: one class in one file of this folder, registered by one line.

    @film_term
    class Cracks(FilmTerm):
        ...

A term finds its curves in a view, samples places on them, and says how they move over their triangles. What is seen on
either side of a place, and how the image changes by that, is computed for all of them in `terms/primary.py`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, TypeVar

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry
from torch_radbp.boundary.curve.outline import Jumps, Outline
from torch_radbp.boundary.curve.places import Places, Sight, lot_of
from torch_radbp.boundary.curve.segments import Segments
from torch_radbp.call.render_call import RenderCall
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.stage import Stages


class ExaminedView(NamedTuple):
    """A view whose discontinuity curves are sampled."""

    stages: Stages
    geometry: Geometry | Any  # detached; prepared for the stages
    sight: Sight | Any  # likewise
    camera: Camera
    rims: bool  # surfaces are smoothly shaded, and what is seen differs on their two sides
    clips: bool  # something lies beyond the far plane


class CurvesInView(NamedTuple):
    """The discontinuity curves of one kind in a view, and a function that samples them."""

    length: float  # on the film, pixels; weak discontinuities count less
    places: Callable[[int], Places]  # samples so many points in proportion to length


class FilmTerm(ABC):
    """The interface of a kind of curve along which the image of a camera is discontinuous.

    Attributes:
        rank: the order among terms.
        kinds: the kinds of its curves that may move over their triangles.
    """

    rank: ClassVar[int]
    kinds: ClassVar[tuple[int, ...]] = ()

    @abstractmethod
    def in_view(self, viewed: ExaminedView, jumps: Jumps) -> list[CurvesInView]:
        """The curves in a view, kind by kind; `jumps`: the edges and triangles that may have some."""

    def most(self, call: RenderCall) -> int:
        """The greatest number of kinds of curves in a view."""
        return 1

    def level(self, geometry: Geometry, camera: Camera, places: Places, kind: int) -> Tensor | None:
        """The level function by which curves move over triangles, at samples fixed to these, (N,) attached; None: none."""
        return None


Term = TypeVar("Term", bound="type[FilmTerm]")

FILM_TERMS: list[FilmTerm] = []


def film_term(term: Term) -> Term:
    """Class decorator that registers a kind of curve of the film, so that its discontinuities are differentiated."""
    FILM_TERMS.append(term())
    FILM_TERMS.sort(key=lambda other: other.rank)
    return term


def lines_in_view(viewed: ExaminedView, lines: Outline | Segments | None, weigh: Callable,
                  place: Callable) -> list[CurvesInView]:
    """The total length in view of straight curves, with a function that samples them; none if none is visible.

    Args:
        viewed: the view.
        lines: edges or segments in the world; None: there are none.
        weigh, place: the stages that compute their lengths in view, and sample points on them.
    """
    stages, geometry, sight = viewed[:3]
    if lines is None:
        return []
    weight = stages(weigh)(geometry, sight, lines)
    total = running_sum(weight)
    length = float(total[-1])

    def places(count: int) -> Places:
        return stages(place)(geometry, sight, lines, lot_of(weight, count, total), lanes(count, weight))

    return [CurvesInView(length, places)] if length > 0.0 else []


def lanes(count: int, like: Tensor) -> Tensor:
    """The int32 tensor 0, 1, ..., count - 1."""
    return torch.arange(count, dtype=torch.int32, device=like.device)
