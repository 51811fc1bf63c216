"""The functions of one bounce, as they are or each compiled to one fused loop over lanes.

Only these are compiled, never the whole path: depth and seed are tensors, and lanes and tables may have any length, so that
bounces, chunks, iterations and scenes that contain the same share one compiled function.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from copy import copy

from torch_radbp.adjoint.bounce import bounce_adjoint
from torch_radbp.aov.material import material_value
from torch_radbp.aov.surface import surface_values
from torch_radbp.film.splat import asked, deposited
from torch_radbp.jit import LaneFunction, UnknownOperation
from torch_radbp.jit.arguments import Taken
from torch_radbp.jit.machine import made_once
from torch_radbp.jit.target import Target
from torch_radbp.path.bounce import bounce, chance_of_light, ending, film_place, pick_light, places, sample_camera
from torch_radbp.path.integrand import Stages
from torch_radbp.path.queues import appearance_met, shines, side_met
from torch_radbp.path.wavefront import brightened
from torch_radbp.record import leaves_of
from torch_radbp.vec import rows

EAGER = Stages(sample_camera, film_place, deposited, asked, bounce, ending, bounce_adjoint, places, pick_light,
               chance_of_light, appearance_met, side_met, shines, rows, brightened, surface_values, material_value)


PATH = "scene", "proposal", "arrival"
TABLES = Stages(  # of each stage the arguments that are read at indices
    sample_camera=("camera",), film_place=(), deposited=("values", "place"), asked=("pixels", "place"), bounce=PATH,
    ending=PATH, bounce_adjoint=("scene", "arrival", "adj_L", "memo"), places=("scene", "arrival"),
    pick_light=("scene", "choice"), chance_of_light=("scene", "choice", "arrival"), appearance_met=("scene",),
    side_met=("scene", "ray", "hit"), shines=("scene",), rows=("record",), brightened=("L", "beta"),
    surface_values=("scene",), material_value=("scene",))


def fused(target: Target | None = None) -> Stages:
    """The stages as fused loops for `target`; None: for the device that the tensors of a call lie on."""
    return Stages(*(CompiledStage(stage, tables, target) for stage, tables in zip(EAGER, TABLES)))


@made_once
def compiled() -> Stages:
    """The stages as fused loops; one set for the whole process."""
    return fused()


class CompiledStage:
    """A stage that is compiled for each kind of scene that it meets, or runs eagerly where it cannot be, and says so once.

    Args:
        stage: the function.
        tables: its arguments that are read at indices.
        target: see `fused`.
    """

    def __init__(self, stage: Callable, tables: tuple[str, ...], target: Target | None = None):
        self.stage, self.fused = stage, LaneFunction(stage, tables, target)
        self.told: list[str] = []  # why it could not be compiled, once said; one list for all copies

    def knowing(self, *arguments) -> CompiledStage:
        """The same stage, for calls that begin with these very arguments."""
        other = copy(self)
        other.fused = self.fused.knowing(*arguments)
        return other

    def taken(self, **arguments) -> tuple[Taken, ...]:
        """Arguments by name, prepared for several calls."""
        return self.fused.taken(**arguments)

    def room(self, results) -> Taken:
        """What `into` writes into, prepared for several calls."""
        return self.fused.room(results)

    def __call__(self, *arguments):
        try:
            return self.fused(*arguments)
        except UnknownOperation as error:
            return self.eagerly(error, arguments)

    def into(self, results, first: int, *arguments) -> None:
        """Writes what a call would return into the tensors of `results`, from the entry `first` on."""
        try:
            self.fused.into(results, first, *arguments)
        except UnknownOperation as error:
            for target, found in zip(leaves_of(as_it_is(results)), leaves_of(self.eagerly(error, arguments))):
                if found is not None:
                    target[first:first + len(found)] = found

    def eagerly(self, error: UnknownOperation, arguments: tuple):
        """What the stage returns in plain torch; says once why."""
        if not self.told:
            self.told.append(str(error))
            warnings.warn(f"{self.stage.__name__} runs eagerly, which is slower: {error}", RuntimeWarning, stacklevel=3)
        return self.stage(*map(as_it_is, arguments))


def as_it_is(argument):
    """An argument that may be prepared for several calls, as it was given."""
    return argument.argument if isinstance(argument, Taken) else argument
