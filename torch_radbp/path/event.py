"""The events at a path vertex. Lanes with the same event form a queue and run the same functions."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from torch_radbp.path.bounce import bounce, ending
from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.tensors import Layout


class Scatters(NamedTuple):
    """The event of hitting a surface of one appearance: light is emitted, received and scattered."""

    appearance: int  # of `Layout.appearances`

    scatters = True

    def scatterer(self, layout: Layout) -> Appearance:
        """The appearance of the surface."""
        return layout.appearances[self.appearance]

    def still(self, layout: Layout) -> tuple[bool, ...]:
        """Of each value of the material, whether no parameter that it comes from is differentiated."""
        return layout.still[self.appearance]

    @property
    def stage(self) -> Callable:
        """The stage that computes the vertex."""
        return bounce


class Ends(Enum):
    """The events that end a path: only emission counts."""

    SURROUNDINGS = "the ray leaves the scene"
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
    def stage(self) -> Callable:
        """The stage that computes the emission at the end."""
        return ending


Event = Scatters | Ends
