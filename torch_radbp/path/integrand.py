"""The integrand: a scene, how it is sampled, and the functions that evaluate one bounce of it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.path.event import Ends, Event
from torch_radbp.path.queues import ImageLanes
from torch_radbp.path.state import Arrival, PathState, Position, Settings
from torch_radbp.raycast.protocol import RayCaster
from torch_radbp.sampling.sampler import depth_counter
from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.part import part_of
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.sensor.kind import Camera
from torch_radbp.texture.reader import Place

SURVIVE_AT_LEAST, SURVIVE_AT_MOST = 0.05, 0.95


class Stages(NamedTuple):
    """The functions that run once for each chunk, or for each bounce: in plain torch, or compiled."""

    sample_camera: Callable
    film_place: Callable
    deposited: Callable
    asked: Callable
    bounce: Callable
    ending: Callable
    attached_vertex: Callable
    bounce_adjoint: Callable
    places: Callable
    pick_light: Callable
    emitter_met: Callable
    chance_of_light: Callable
    appearance_met: Callable
    side_met: Callable
    corner_rows: Callable
    shines: Callable
    rows: Callable
    brightened: Callable
    direct_light: Callable
    scattered: Callable
    surface_values: Callable
    material_value: Callable
    edge_weight: Callable
    edge_place: Callable
    crosses: Callable
    contour_length: Callable
    contour_place: Callable
    segment_weight: Callable
    segment_place: Callable
    rays_beside: Callable
    in_sight: Callable
    paths_beside: Callable
    swept: Callable
    slopes: Callable
    asked_of_places: Callable
    boxes_around: Callable
    ray_along_edge: Callable
    edge_bounds: Callable
    merged_bounds: Callable
    descended: Callable
    edge_found: Callable
    edge_tried: Callable
    edge_passed: Callable
    segment_bounds: Callable
    segment_found: Callable
    segment_passed: Callable
    sheets_seen: Callable
    border_course: Callable
    cut_course: Callable
    light_eyes: Callable
    light_lobes: Callable
    picked_vertex: Callable
    light_samples: Callable
    meets: Callable
    goes_on: Callable
    ideal_vertex: Callable
    no_direction: Callable
    scattered_ideally: Callable
    parted: Callable
    unparted: Callable
    film_sample: Callable
    drawn_by_steps: Callable

    def eager(self) -> Stages:
        """The same in plain torch."""
        return Stages(*(getattr(stage, "stage", stage) for stage in self))


def knowing(stage: Callable, *arguments) -> Callable:
    """A stage, prepared for calls that begin with these very arguments."""
    return stage.knowing(*arguments) if hasattr(stage, "knowing") else stage


def taken(stage: Callable, **arguments) -> tuple:
    """Arguments that are the same in several calls of a stage, prepared for them."""
    return stage.taken(**arguments) if hasattr(stage, "taken") else tuple(arguments.values())


class Part(NamedTuple):
    """What the lanes of one queue go through."""

    scene: SceneTensors  # the part of the integrand's scene that they read
    proposal: SceneTensors  # the same, detached
    evaluate: Callable  # the stage of what happens to them, prepared for both
    tables: Any  # `proposal`, prepared for stages
    prepared: dict[Callable, Callable]  # other stages, for calls that begin with `proposal`

    def call(self, stage: Callable, *arguments):
        """What a stage returns of `proposal` and other arguments."""
        if stage not in self.prepared:
            self.prepared[stage] = knowing(stage, self.tables)
        return self.prepared[stage](self.proposal, *arguments)


class Integrand(NamedTuple):
    """The integrand with the functions that evaluate it: everything about a rendering but its lanes."""

    scene: SceneTensors  # attached if plain autograd is to record the loop
    proposal: SceneTensors  # the same, detached
    caster: RayCaster
    settings: Settings
    max_depth: int
    rr_depth: int
    stages: Stages
    parts: dict[Event, Part]  # filled when one first happens
    clipping: Camera | None = None  # the camera of the paths, if its far plane cuts the scene
    # () int32: so many lanes of the chunk, the first, are of the derivative alone, the others of the image alone. None: all
    # are of both.
    differentiated: Tensor | None = None

    def with_stages(self, stages: Stages) -> Integrand:
        """The same integrand, evaluated by other functions."""
        return self._replace(stages=stages, parts={})

    @property
    def attached(self) -> bool:
        """True if derivatives go through the loop over bounces, recorded by autograd or forward."""
        return self.scene is not self.proposal

    def still(self) -> Integrand:
        """The same without derivatives."""
        return self._replace(scene=self.proposal, parts={}) if self.attached else self

    def part(self, event: Event) -> Part:
        """What lanes go through to which this happens."""
        event = event if event.scatters else Ends.SURROUNDINGS  # where paths end the same is read, whatever ends them
        if event not in self.parts:
            scatterer = self.scatterer(event)
            proposal = part_of(self.proposal, scatterer)
            scene = part_of(self.scene, scatterer) if self.attached else proposal
            stage = event.stage(self.stages)
            tables, = taken(stage, proposal=proposal)
            prepared = knowing(stage, tables if scene is proposal else scene, tables)
            self.parts[event] = Part(scene, proposal, prepared, tables, {})
        return self.parts[event]

    def places(self, event: Event, arrival: Arrival, lanes: Tensor, depth: int) -> tuple[Place, ...]:
        """The places of the values of textures that are read outside, of these lanes; see `path.bounce.places`."""
        scatterer = self.scatterer(event)
        if not self.scene.layout.lit and (scatterer is None or not scatterer.outside):
            return ()
        return self.part(event).call(self.stages.places, arrival, lanes, self.at(depth), self.settings_at(depth))

    def at(self, depth: int) -> Position:
        """The position on the path as tensors."""
        like = self.scene.lights.choice.pmf
        return position(depth, depth + 1 >= self.rr_depth, like.dtype, like.device)

    def settings_at(self, depth: int) -> Settings:
        """The settings with what is special at the first bounce."""
        return self.settings._replace(hide_emitters=self.settings.hide_emitters and depth == 0)

    def image_lanes(self, state: PathState) -> ImageLanes | None:
        """The paths that are not differentiated; None: all may be."""
        if self.differentiated is None:
            return None
        return ImageLanes(state.lane, self.differentiated)

    @property
    def rejects_hits(self) -> bool:
        """True if the camera may not see the closest surface."""
        return self.clipping is not None or (self.settings.hide_emitters and self.proposal.layout.lit_surfaces)

    @property
    def no_appearance(self) -> Tensor:
        """() int32, the number of the queue of lanes that meet no surface: that after the appearances."""
        return number(len(self.proposal.layout.appearances), self.proposal.lights.choice.pmf.device)

    def is_last(self, depth: int) -> bool:
        """True if paths end at this bounce: nothing is scattered any more."""
        return depth + 1 >= self.max_depth

    def scatterer(self, event: Event) -> Appearance | None:
        """What light is scattered by; None: the path ends."""
        return event.scatterer(self.scene.layout)


@functools.cache
def number(value: int, device: torch.device) -> Tensor:
    """An int32."""
    return torch.full((), value, dtype=torch.int32, device=device)


@functools.lru_cache(maxsize=4096)
def position(depth: int, roulette: bool, dtype: torch.dtype, device: torch.device) -> Position:
    """The position of the bounce at `depth`, with roulette or without it."""
    least, most = (SURVIVE_AT_LEAST, SURVIVE_AT_MOST) if roulette else (1.0, 1.0)
    return Position(depth_counter(depth, device), torch.tensor(least, dtype=dtype, device=device),
                    torch.tensor(most, dtype=dtype, device=device))
