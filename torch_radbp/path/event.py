"""The events at the end of a ray. Lanes with the same event form a queue and run the same functions.

An event is a hashable value. It says which kind of vertex lanes have there, that is what is evaluated, forwards and for
derivatives; and what scatters light, which is the part of the scene that they read.
"""

from __future__ import annotations

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
        """The appearance of the surface."""
        return layout.appearances[self.appearance]

    def still(self, layout: Layout) -> tuple[bool, ...]:
        """Of each value of the material, whether no parameter that it comes from is differentiated."""
        return layout.still[self.appearance]

    @property
    def vertex(self) -> VertexKind:
        """The functions of the vertex."""
        return SURFACE

    @property
    def stage(self) -> Callable:
        """The stage that computes the vertex."""
        return bounce


@dataclass(frozen=True)
class FlightEnd:
    """The event of scattering in a medium before a surface is met."""

    medium: int  # of `Layout.media`
    scatters: ClassVar[bool] = True

    def scatterer(self, layout: Layout) -> None:
        """There is no surface."""

    def still(self, layout: Layout) -> tuple[()]:
        """There is no material."""
        return ()

    @property
    def vertex(self) -> VertexKind:
        """The functions of the vertex."""
        return FlightVertex(self.medium)

    @property
    def stage(self) -> Callable:
        """The stage that computes the vertex."""
        return bounce


class Ends(Enum):
    """The events that end a path: only emission counts."""

    SURROUNDINGS = "the ray leaves the scene, which has light around it, or in media"
    LAST_BOUNCE = "paths have as many bounces as they may"

    @property
    def scatters(self) -> bool:
        """No path goes on."""
        return False

    def scatterer(self, layout: Layout) -> None:
        """Nothing scatters light."""

    def still(self, layout: Layout) -> tuple[()]:
        """There is no material."""
        return ()

    @property
    def vertex(self) -> VertexKind:
        """The functions of the vertex."""
        return END

    @property
    def stage(self) -> Callable:
        """The stage that computes the vertex."""
        return ending


Event = SurfaceMet | FlightEnd | Ends


def events_of(layout: Layout, last: bool) -> tuple[Event, ...]:
    """The events that are possible at a bounce, in the order of the numbers by which lanes are sorted.

    Args:
        layout: of the scene.
        last: whether it is the last bounce of paths.
    """
    if last:
        return (Ends.LAST_BOUNCE,)
    surfaces = map(SurfaceMet, range(len(layout.appearances)))
    return (*surfaces, *map(FlightEnd, layout.scattering_media),
            *([] if layout.surround is None and not layout.emitting_media else [Ends.SURROUNDINGS]))
