"""What can happen to a path at a vertex. Lanes to which the same happens form a queue and go through the same functions."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from torch_radbp.path.bounce import bounce, ending
from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.tensors import Layout


class Scatters(NamedTuple):
    """A surface of one appearance is met: light is emitted, received and scattered, and the path may go on."""

    appearance: int  # of `Layout.appearances`

    scatters = True

    def scatterer(self, layout: Layout) -> Appearance:
        """What light is scattered by."""
        return layout.appearances[self.appearance]

    def still(self, layout: Layout) -> tuple[bool, ...]:
        """Of each value of the material, whether no parameter that it comes from is differentiated."""
        return layout.still[self.appearance]

    @property
    def stage(self) -> Callable:
        """The stage that computes the vertex."""
        return bounce


class Ends(Enum):
    """The path ends, and only what is emitted there counts."""

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
        """The stage that computes the vertex."""
        return ending


Event = Scatters | Ends
