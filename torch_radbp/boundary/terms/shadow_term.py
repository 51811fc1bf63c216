"""What a boundary term of shadows is: one class in one file of this folder, registered by one line.

    @shadow_term
    class Caustics(ShadowTerm):
        ...

A term samples the places of each view at which light is cut off, and says how these move. `shadows.py` is the loop
over all terms.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple, TypeVar

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.curve.segments import Segments
from torch_radbp.boundary.curve.term import LineNumbers
from torch_radbp.boundary.eye.deposit import Deposit, attached_geometry, swept_areas
from torch_radbp.boundary.eye.seen_edges import Casting, Course
from torch_radbp.boundary.terms.lit_edges import EdgesFromLights
from torch_radbp.call.render_call import RenderCall
from torch_radbp.tensors.vec import Vec2, rows


class ShadowSearch(NamedTuple):
    """A call in which something moves, and the edges and curves that cut off light in its scene."""

    call: RenderCall  # attached
    still: RenderCall  # without derivatives
    casting: Casting | None  # edges; None: nothing moves shadows
    crossing: Segments | None  # where surfaces pass through each other, and lines that slide; None: nowhere
    lines: LineNumbers | None  # what those lines follow, attached
    from_lights: EdgesFromLights | None  # the edges `casting` as light samples see them


class TermSize(NamedTuple):
    """The greatest memory that a term needs in a view."""

    search: int = 0  # bytes, while edges are looked for
    found: int = 0  # samples, while it is computed how they move
    kept: int = 0  # samples, for the backward pass


class CutOff(NamedTuple):
    """K samples on borders at which light that reaches a view is cut off; detached.

    `sweep`, the area that the border sweeps if its edge moves outwards, serves to compare terms (`split.py`).
    """

    place: Vec2  # on the film, of the paths that see them: pixels from the upper left corner of the window
    normal: Vec2  # across the border, in the coordinates of `ShadowTerm.seen`; its length is that of the piece per sample
    strength: Tensor  # (3, K) float64, light lost per unit of motion along the normal
    samples: Any  # a record of the term's own, of what tells where they are
    sweep: Tensor | None = None  # (K,) swept area if all edges move by an equal step; None: unknown

    def independent(self) -> Tensor:
        """(3, K) changes of the image if all edges move alike, one for each sample, so that they are independent."""
        return self.strength * self.sweep


def cut_off(place: Vec2, course: Course, light: Tensor, samples: Any) -> CutOff | None:
    """Samples on borders of light, without those at which there is none; None: all are.

    Args:
        place, samples: as of `CutOff`.
        course: the `Course` of the border.
        light: (3, N) float64, on the side of the border that is not in shadow.
    """
    lost = torch.where((course.normal.x != 0.0) | (course.normal.y != 0.0), light, 0.0)
    kept = (lost != 0).any(0).nonzero().squeeze(1)
    place, course, samples = rows((place, course, samples), kept)
    lost = lost[:, kept]
    strength = torch.where(course.sweep > 0, lost, -lost)
    return CutOff(place, course.normal, strength, samples, course.sweep) if len(kept) else None


class ShadowTerm(ABC):
    """The interface of a boundary term of shadows: an integral of light that edges or curves cut off.

    Attributes:
        rank: the order among terms. For the first all samples are taken.
        needs: the fields of `ShadowSearch` that must not be None.
        through_media: True if it follows rays through boundaries of media.
        is_split: as many samples are taken as pay off beside the first term; `samples` takes a `split.Amount`, too, and
            returns `cuts.CutsOfView`.
    """

    rank: ClassVar[int]
    needs: ClassVar[tuple[str, ...]] = ("casting",)
    through_media: ClassVar[bool] = False
    is_split: ClassVar[bool] = False

    def __init__(self, search: ShadowSearch) -> None:
        self.call, self.still, self.casting, self.crossing, self.lines, self.from_lights = search

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        """The greatest memory that the term's samples need in a view."""
        return TermSize()

    @classmethod
    def turns(cls, call: RenderCall) -> bool:
        """True if the term contributes to the derivative even where no shadow moves."""
        return False

    @abstractmethod
    def applies(self) -> bool:
        """True if the term contributes to the derivative."""

    @abstractmethod
    def samples(self, number: int) -> Any:
        """Samples points at which light that reaches view `number` is cut off, detached; None: there are none."""

    def left_out(self, rendering: Rendering) -> set[str]:
        """The parameters that move borders of the term, if it is off and a few samples find them; `call` is eager."""
        return set()

    def jumps(self, number: int, found: Any) -> list[Deposit]:
        """The derivative from the samples `found` by `samples`, as deposits on the film of view `number`; attached."""
        seen = self.seen(number, attached_geometry(self.call.scene), found)
        return [Deposit(found.place, found.strength.unbind(), swept_areas(seen, found.normal))]

    def seen(self, number: int, geometry: Geometry, found: CutOff) -> Vec2:
        """The positions of samples, attached, in two coordinates in which borders sweep areas; `geometry`: attached."""
        raise NotImplementedError


Term = TypeVar("Term", bound="type[ShadowTerm]")

SHADOW_TERMS: list[type[ShadowTerm]] = []


def shadow_term(term: Term) -> Term:
    """Class decorator that registers a boundary term of shadows, so that derivatives include it."""
    SHADOW_TERMS.append(term)
    SHADOW_TERMS.sort(key=lambda other: other.rank)
    return term


def terms_of(search: ShadowSearch) -> list[ShadowTerm]:
    """The terms that contribute to the derivative of a call."""
    segments = search.call.scene.layout.traces_segments
    terms = [term(search) for term in SHADOW_TERMS
             if all(getattr(search, name) is not None for name in term.needs) and (term.through_media or not segments)]
    return [term for term in terms if term.applies()]
