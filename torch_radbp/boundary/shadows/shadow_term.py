"""What a boundary term of shadows is: one class in one file of this folder, registered by one line.

    @shadow_term
    class Caustics(ShadowTerm):
        ...

A term samples the places of each view at which light is cut off, and says how these move. `shadows/__init__.py` is the loop
over all terms.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple, TypeVar

from torch_radbp.boundary.rendering import Rendering
from torch_radbp.boundary.segments import Segments
from torch_radbp.boundary.shadows.film_jumps import FilmJumps
from torch_radbp.boundary.shadows.seen_edges import Casting
from torch_radbp.boundary.shadows.split import ALL, Amount
from torch_radbp.boundary.term import LineNumbers
from torch_radbp.call.render_call import RenderCall


class ShadowSearch(NamedTuple):
    """A call of which something moves, and what hides light in its scene."""

    call: RenderCall  # attached
    still: RenderCall  # without derivatives
    casting: Casting | None  # edges; None: nothing moves shadows
    crossing: Segments | None  # where surfaces pass through each other, and lines that slide; None: nowhere
    lines: LineNumbers | None  # what those lines follow, attached


class TermSize(NamedTuple):
    """The greatest memory of a term's samples in a view."""

    search: int = 0  # bytes, while edges are looked for
    found: int = 0  # samples, while it is computed how they move
    kept: int = 0  # samples, for the backward pass


class ShadowTerm(ABC):
    """One of the integrals of light that edges or curves cut off.

    Attributes:
        rank: its place among the terms. Of the first all samples are taken.
        needs: what of the search there has to be.
        is_split: as many samples are taken as pay off beside the first term; they are `hidden_light.CutsOfView`.
    """

    rank: ClassVar[int]
    needs: ClassVar[tuple[str, ...]] = ("casting",)
    is_split: ClassVar[bool] = False

    def __init__(self, search: ShadowSearch) -> None:
        self.call, self.still, self.casting, self.crossing, self.lines = search

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        """The greatest memory of its samples, whatever is found."""
        return TermSize()

    @abstractmethod
    def applies(self) -> bool:
        """True if the term has a part in the derivative."""

    @abstractmethod
    def samples(self, number: int, amount: Amount = ALL) -> Any:
        """Samples places at which light that reaches view `number` is cut off, detached; None: there are none.

        `amount`: how many, if `is_split`.
        """

    def left_out(self, rendering: Rendering) -> set[str]:
        """The parameters that move places of the term, as far as it is off and a few samples find them; `call` is eager."""
        return set()

    @abstractmethod
    def jumps(self, number: int, found: Any) -> FilmJumps:
        """What places, `found` by `samples`, add to the derivative of view `number`; attached."""


Term = TypeVar("Term", bound="type[ShadowTerm]")

SHADOW_TERMS: list[type[ShadowTerm]] = []


def shadow_term(term: Term) -> Term:
    """Registers a term."""
    SHADOW_TERMS.append(term)
    SHADOW_TERMS.sort(key=lambda other: other.rank)
    return term


def terms_of(search: ShadowSearch) -> list[ShadowTerm]:
    """The terms that have a part in the derivative of a call."""
    terms = [term(search) for term in SHADOW_TERMS if all(getattr(search, name) is not None for name in term.needs)]
    return [term for term in terms if term.applies()]


def films_have_area(call: RenderCall) -> bool:
    """True if pixels of all views have an area; along a single ray there is no border to be seen."""
    return all(view.camera.kind.has_area for view in call.views)


def glues(call: RenderCall) -> bool:
    """True if random hits of paths are fixed to surfaces, except behind rough glass."""
    return call.integrand.settings.sampling != "attached"


def follows(call: RenderCall) -> bool:
    """True if some random hits of paths follow directions that carry derivatives."""
    return not glues(call) or call.integrand.settings.following


def sharp_lights_later(call: RenderCall) -> bool:
    """True if lights without extent are sampled at the second vertices of paths, or later ones."""
    settings, lights = call.integrand.settings, call.scene.layout.lights
    return settings.nee and call.integrand.max_depth > 2 and any(kind.delta for kind in lights)
