"""The functions of one bounce, as they are or each compiled to one fused loop over lanes.

Only these are compiled, never the whole path: depth and seed are tensors, and lanes and tables may have any length, so that
bounces, chunks, iterations and scenes that contain the same share one compiled function.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from copy import copy

from torch_radbp.adjoint.bounce import bounce_adjoint
from torch_radbp.adjoint.local_map import attached_vertex
from torch_radbp.aov.material import material_value
from torch_radbp.aov.surface import surface_values
from torch_radbp.boundary.contour import contour_length, contour_place, crosses
from torch_radbp.boundary.edge_places import edge_place, edge_weight
from torch_radbp.boundary.in_sight import in_sight, paths_beside
from torch_radbp.boundary.intersections import boxes_around
from torch_radbp.boundary.motion import asked_of_places, slopes, swept
from torch_radbp.boundary.pierced import ray_along_edge
from torch_radbp.boundary.places import rays_beside
from torch_radbp.boundary.reflections.crossings import drawn_by_steps
from torch_radbp.boundary.reflections.differences import parted, unparted
from torch_radbp.boundary.reflections.ideal_steps import ideal_vertex, no_direction, scattered_ideally
from torch_radbp.boundary.reflections.surfaces import goes_on
from torch_radbp.boundary.segments import segment_place, segment_weight
from torch_radbp.boundary.shadows.border import border_course, film_sample, meets
from torch_radbp.boundary.shadows.crossed_surfaces import sheets_seen
from torch_radbp.boundary.shadows.edge_tree import descended, edge_bounds, merged_bounds
from torch_radbp.boundary.shadows.edges_tried import edge_tried
from torch_radbp.boundary.shadows.hidden_light import cut_course
from torch_radbp.boundary.shadows.light_points import light_eyes, light_lobes, light_samples
from torch_radbp.boundary.shadows.seen_edges import edge_found, edge_passed
from torch_radbp.boundary.shadows.segment_tree import segment_bounds, segment_found, segment_passed
from torch_radbp.boundary.shadows.viewpoints import picked_vertex
from torch_radbp.film.splat import asked, deposited
from torch_radbp.jit import LaneFunction, UnknownOperation
from torch_radbp.jit.allocator import keep_freed_memory
from torch_radbp.jit.arguments import Taken
from torch_radbp.jit.dual import DualFunction
from torch_radbp.jit.machine import made_once
from torch_radbp.jit.target import Target
from torch_radbp.path.bounce import (
    bounce,
    chance_of_light,
    emitter_met,
    ending,
    film_place,
    pick_light,
    places,
    sample_camera,
)
from torch_radbp.path.direct_light import direct_light, scattered
from torch_radbp.path.integrand import Stages
from torch_radbp.path.queues import appearance_met, shines, side_met
from torch_radbp.path.wavefront import brightened
from torch_radbp.scene.interaction import corner_rows
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.tensors.vec import rows

PATH, CURVES, MOTION = ("scene", "proposal", "arrival"), ("geometry", "sight"), ("geometry", "camera", "places")
OUTLINE = "geometry", "outline"
STAGES = {  # of each the arguments that are read at indices
    sample_camera: ("camera",), film_place: (), deposited: ("values", "place"), asked: ("pixels", "place"), bounce: PATH,
    ending: PATH, attached_vertex: PATH, bounce_adjoint: ("scene", "arrival", "adj_L", "memo"),
    places: ("scene", "arrival"), pick_light: ("scene", "choice"), emitter_met: ("scene",),
    chance_of_light: ("scene", "choice", "arrival"), appearance_met: ("scene",),
    side_met: ("scene", "ray", "hit", "image_lanes"), corner_rows: ("scene",), shines: ("scene",), rows: ("record",),
    brightened: ("L", "beta"), direct_light: ("scene", "arrival", "draw"), scattered: ("scene", "arrival", "d"),
    surface_values: ("scene",), material_value: ("scene",), edge_weight: CURVES, edge_place: (*CURVES, "outline", "lot"),
    crosses: CURVES, contour_length: CURVES, contour_place: (*CURVES, "faces", "lot"), segment_weight: CURVES,
    segment_place: (*CURVES, "segments", "lot"), rays_beside: ("sight", "places", "chosen"),
    in_sight: ("geometry", "places", "sent"), paths_beside: ("places", "chosen", "sent", "times", "shown"), swept: MOTION,
    slopes: MOTION, asked_of_places: ("camera", "pixels", "film"), boxes_around: ("geometry",),
    ray_along_edge: ("geometry", "bodies"),
    edge_bounds: (*OUTLINE, "slots"), merged_bounds: ("below",), descended: ("nodes", "eyes"),
    edge_found: ("geometry", "slots", "eyes"), edge_tried: (*OUTLINE, "eyes", "edges"),
    edge_passed: (*OUTLINE, "eyes", "lot", "found", "eye"), segment_bounds: ("geometry", "segments", "slots"),
    segment_found: ("geometry", "segments", "slots", "eyes"),
    segment_passed: ("geometry", "segments", "eyes", "lot", "found", "eye"), sheets_seen: ("geometry", "segments", "at"),
    border_course: ("scene", *OUTLINE, "camera"), cut_course: (*OUTLINE, "at"), light_eyes: ("scene",),
    light_lobes: ("scene",), picked_vertex: ("picked", "reached"), light_samples: ("choice", "kind"), meets: ("geometry",),
    goes_on: ("geometry",), ideal_vertex: ("surfaces",), no_direction: (), scattered_ideally: (),
    parted: ("surfaces", "vertices"), unparted: (), film_sample: ("camera",), drawn_by_steps: (),
}
EAGER = Stages(**{stage.__name__: stage for stage in STAGES})


def fused(target: Target | None = None) -> Stages:
    """The stages as fused loops for `target`; None: for the device that the tensors of a call lie on."""
    return Stages(**{stage.__name__: CompiledStage(stage, tables, target) for stage, tables in STAGES.items()})


@made_once
def compiled() -> Stages:
    """The stages as fused loops; one set for the whole process."""
    keep_freed_memory()
    return fused()


class CompiledStage:
    """A stage that is compiled for each kind of scene that it meets, or runs eagerly where it cannot be, and says so once.

    Of dual tensors, in forward mode, values and tangents are computed in one loop.

    Args:
        stage: the function.
        tables: its arguments that are read at indices.
        target: see `fused`.
    """

    def __init__(self, stage: Callable, tables: tuple[str, ...], target: Target | None = None):
        self.stage, self.fused = stage, LaneFunction(stage, tables, target)
        self.dual = DualFunction(stage, tables, target)
        self.told: list[str] = []  # why it could not be compiled, once said; one list for all copies

    def knowing(self, *arguments) -> CompiledStage:
        """The same stage, for calls that begin with these very arguments."""
        other = copy(self)
        other.fused = self.fused.knowing(*arguments)
        other.dual = self.dual.knowing(*map(as_it_is, arguments))
        return other

    def taken(self, **arguments) -> tuple[Taken, ...]:
        """Arguments by name, prepared for several calls."""
        return self.fused.taken(**arguments)

    def room(self, results) -> Taken:
        """What `into` writes into, prepared for several calls."""
        return self.fused.room(results)

    def __call__(self, *arguments):
        try:
            if inside_dual_level() and (parts := self.dual.parts(tuple(map(as_it_is, arguments)))).moving:
                return self.dual.of_parts(parts)
            return self.fused(*arguments)
        except UnknownOperation as error:
            return self.eagerly(error, arguments)

    def into(self, results, first: int, *arguments) -> None:
        """Writes what a call would return into the tensors of `results`, from the entry `first` on."""
        try:
            if inside_dual_level() and any_differentiated(as_it_is(results)):
                parts = self.dual.parts(tuple(map(as_it_is, arguments)))
                return self.dual.into(as_it_is(results), first, parts)
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
