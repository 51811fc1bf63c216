"""The events at the end of a ray. Lanes with the same event form a queue and run the same functions.

An event is a hashable value. It says which kind of vertex lanes have there, that is what is evaluated, forwards and for
derivatives; and what scatters light, which is the part of the scene that they read.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

from torch_radbp.path.bounce import bounce, ending
from torch_radbp.path.flight import FlightVertex
from torch_radbp.path.path_end import END
from torch_radbp.path.surface import SURFACE
from torch_radbp.path.vertex import VertexKind
from torch_radbp.scene.tables.appearance import Appearance
from torch_radbp.scene.tables.scene_tensors import Layout


@dataclass(frozen=True)
class SurfaceMet:
    """The event of hitting a surface of one appearance: light is emitted, received and scattered."""

    appearance: int  # of `Layout.appearances`
    scatters: ClassVar[bool] = True

    def scatterer(self, layout: Layout) -> Appearance:
        """The appearance (material and textures) of the surface."""
        return layout.appearances[self.appearance]

    def still(self, layout: Layout) -> tuple[bool, ...]:
        """For each value of the material, True if it depends on no differentiated parameter."""
        return layout.still[self.appearance]

    @property
    def vertex(self) -> VertexKind:
        """The formulas at a surface vertex."""
        return SURFACE

    @property
    def stage(self) -> Callable:
        """The stage that computes one bounce at a surface vertex."""
        return bounce


@dataclass(frozen=True)
class FlightEnd:
    """The event of scattering in a medium before a surface is met."""

    medium: int  # of `Layout.media`
    scatters: ClassVar[bool] = True

    def scatterer(self, layout: Layout) -> None:
        """None: a medium has no appearance."""

    def still(self, layout: Layout) -> tuple[()]:
        """Empty: a medium has no material whose values could be differentiated."""
        return ()

    @property
    def vertex(self) -> VertexKind:
        """The formulas at a vertex in the medium."""
        return FlightVertex(self.medium)

    @property
    def stage(self) -> Callable:
        """The stage that computes one bounce at a vertex in the medium."""
        return bounce


class Ends(Enum):
    """The events that end a path: only emission counts."""

    SURROUNDINGS = "the ray leaves the scene, which has light around it, or in media"
    LAST_BOUNCE = "paths have as many bounces as they may"

    @property
    def scatters(self) -> bool:
        """False: the path ends here."""
        return False

    def scatterer(self, layout: Layout) -> None:
        """None: nothing scatters light where a path ends."""

    def still(self, layout: Layout) -> tuple[()]:
        """Empty: where a path ends there is no material whose values could be differentiated."""
        return ()

    @property
    def vertex(self) -> VertexKind:
        """The formulas at the end of a path."""
        return END

    @property
    def stage(self) -> Callable:
        """The stage that computes the emission seen by paths that end."""
        return ending


Event = SurfaceMet | FlightEnd | Ends


def events_of(layout: Layout, last: bool) -> tuple[Event, ...]:
    """The events that are possible at a bounce of a scene, in the order by which lanes are sorted into queues.

    Args:
        layout: of the scene.
        last: whether it is the last bounce of paths.
    """
    if last:
        return (Ends.LAST_BOUNCE,)
    surroundings = layout.surround is not None or bool(layout.emitting_media)
    return scattering_and_end(len(layout.appearances), layout.scattering_media, surroundings)


@functools.lru_cache(maxsize=256)
def scattering_and_end(appearances: int, media: tuple[int, ...], surroundings: bool) -> tuple[Event, ...]:
    """The events of hitting a surface of each appearance, of scattering in each of some media, and of leaving the scene if
    something is seen there."""
    end = (Ends.SURROUNDINGS,) if surroundings else ()
    return (*map(SurfaceMet, range(appearances)), *map(FlightEnd, media), *end)
