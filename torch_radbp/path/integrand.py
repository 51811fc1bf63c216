"""The integrand: a scene, sampling settings, and the functions that evaluate one bounce."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.texture import Place
from torch_radbp.jit.recording.repetitions import LearntRepetitions, Repetitions
from torch_radbp.jit.target import Target
from torch_radbp.path.bounce import places
from torch_radbp.path.event import Ends, Event, events_of
from torch_radbp.path.queues import ImageLanes
from torch_radbp.path.state import Arrival, PathState, Position, Settings
from torch_radbp.raycast.protocol import RayCaster
from torch_radbp.sampling.sampler import depth_counter
from torch_radbp.scene.tables.appearance import Appearance
from torch_radbp.scene.tables.part import part_of
from torch_radbp.scene.tables.scene_tensors import SceneTensors, extent_of
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.stage import Stage, Stages

SURVIVE_AT_LEAST, SURVIVE_AT_MOST = 0.05, 0.95


class QueueStages(NamedTuple):
    """The scene tables and compiled functions for the lanes of one queue."""

    scene: SceneTensors  # part of the integrand's scene that they read
    proposal: SceneTensors  # the same, detached
    evaluate: Stage  # stage of their event, prepared for both
    tables: Any  # `proposal`, prepared for stages
    stages: Stages
    prepared: dict[Callable, Stage]  # other stages, prepared for calls that begin with `proposal`

    def call(self, stage: Callable, *arguments):
        """Runs a stage on the detached scene part `proposal` and further arguments."""
        if stage not in self.prepared:
            self.prepared[stage] = self.stages(stage).knowing(self.tables)
        return self.prepared[stage](self.proposal, *arguments)


class Integrand(NamedTuple):
    """The integrand: the scene, its ray caster, the sampling settings and the functions that evaluate a bounce."""

    scene: SceneTensors  # attached if plain autograd is to record the loop
    proposal: SceneTensors  # the same, detached
    caster: RayCaster
    settings: Settings
    max_depth: int
    rr_depth: int
    stages: Stages  # runs functions of lanes, compiled or not
    parts: dict[Event, QueueStages]  # by event, filled at first use
    clipping: Camera | None = None  # the camera of the paths, if its far plane cuts the scene
    # () int32: so many lanes of the chunk, the first, are of the derivative alone, the others of the image alone. None: all
    # are of both.
    differentiated: Tensor | None = None
    # How often sequences of launches repeat what is repeated for lanes, and what was left; None: the host decides.
    repetitions: Repetitions | None = None
    # By which whoever has no other occasion finds out himself; None: the host decides there, too.
    learnt: LearntRepetitions | None = None

    def with_stages(self, stages: Stages) -> Integrand:
        """The same integrand with another way to run stages."""
        return self._replace(stages=stages, parts={})

    @property
    def target(self) -> Target:
        """The device and instruction set for which stages are compiled."""
        return self.stages.target_on(self.proposal.lights.choice.pmf.device)

    @property
    def kernels_repeat(self) -> bool:
        """True if a call of a repeated stage, such as one of steps of delta tracking, goes on until each lane is done."""
        return self.stages.is_compiled and self.target.repeats

    @property
    def attached(self) -> bool:
        """True if derivatives pass through the loop over bounces, by autograd or in forward mode."""
        return self.scene is not self.proposal

    def still(self) -> Integrand:
        """The same integrand with a detached scene."""
        return self._replace(scene=self.proposal, parts={}) if self.attached else self

    def standing(self) -> Integrand:
        """The same integrand for paths whose rays carry no derivatives."""
        return self._replace(settings=self.settings._replace(moving=False))

    def for_derivatives(self, of_image: bool = False) -> Integrand:
        """The integrand whose media are sampled for derivatives; with `of_image` for the image as well."""
        kinds = self.proposal.layout.media
        if not self.proposal.layout.scattering_media:
            return self
        extent = extent_of(self.proposal).to(self.proposal.dtype)  # one tensor in both parts, as all that they share
        scene, proposal = (scene._replace(media=tuple(
            kind.sampled_for_derivatives(table, extent, of_image) for kind, table in zip(kinds, scene.media)))
            for scene in (self.scene, self.proposal))
        return self._replace(scene=scene if self.attached else proposal, proposal=proposal, parts={})

    def part(self, event: Event) -> QueueStages:
        """The scene tables and functions for lanes with an event."""
        event = event if event.scatters else Ends.SURROUNDINGS  # where paths end the same is read, whatever ends them
        if event not in self.parts:
            scatterer = self.scatterer(event)
            proposal = part_of(self.proposal, scatterer, event.vertex)
            scene = part_of(self.scene, scatterer, event.vertex) if self.attached else proposal
            stage = self.stages(event.stage)
            tables, = stage.taken(proposal=proposal)
            prepared = stage.knowing(tables if scene is proposal else scene, tables)
            self.parts[event] = QueueStages(scene, proposal, prepared, tables, self.stages, {})
        return self.parts[event]

    def places(self, event: Event, arrival: Arrival, lanes: Tensor, depth: int) -> tuple[Place, ...]:
        """The points at which lanes with an event look up network textures; see `path.bounce.places`."""
        scatterer = self.scatterer(event)
        if not self.scene.layout.lit and (scatterer is None or not scatterer.outside):
            return ()
        return self.part(event).call(places, arrival, lanes, self.at(depth), self.settings_at(depth))

    def at(self, depth: int) -> Position:
        """The depth of a bounce on the path and whether Russian roulette is played there, as () tensors."""
        like = self.scene.lights.choice.pmf
        return position(depth, depth + 1 >= self.rr_depth, like.dtype, like.device)

    @property
    def bounces(self) -> int:
        """The greatest number of bounces of a path; for paths from lamps one less, since nothing scatters at the last."""
        return self.max_depth - self.proposal.layout.from_lamps

    def settings_at(self, depth: int) -> Settings:
        """The settings at a bounce; at the first and the last bounce some differ."""
        ends = self.proposal.layout.from_lamps and depth + 1 >= self.bounces
        return settings_of_bounce(self.settings, depth == 0, ends)

    def image_lanes(self, state: PathState) -> ImageLanes | None:
        """The lanes that the backward pass does not differentiate; None: all may be differentiated."""
        if self.differentiated is None:
            return None
        return ImageLanes(state.lane, self.differentiated)

    @property
    def rejects_hits(self) -> bool:
        """True if the camera may not see the closest surface (hidden emitters, far plane)."""
        return self.clipping is not None or (self.settings.hide_emitters and self.proposal.layout.lit_surfaces)

    @property
    def no_appearance(self) -> Tensor:
        """() int32, the queue number of lanes that hit nothing: the number of events that scatter."""
        scatter = sum(event.scatters for event in events_of(self.proposal.layout, False))
        return int32_number(scatter, self.proposal.lights.choice.pmf.device)

    def is_last(self, depth: int) -> bool:
        """True at the last bounce, where paths end and only emission counts."""
        return depth + 1 >= self.max_depth

    def events(self, depth: int) -> tuple[Event, ...]:
        """The events that are possible at a bounce."""
        return events_of(self.proposal.layout, self.is_last(depth))

    def kind_at(self, depth: int) -> tuple[Settings, bool, bool]:
        """The settings at a bounce, and whether it is the last, the first: where these agree bounces share compiled code."""
        return self.settings_at(depth), self.is_last(depth), depth == 0

    def scatterer(self, event: Event) -> Appearance | None:
        """The appearance that scatters light in an event; None if there is none."""
        return event.scatterer(self.scene.layout)


@functools.lru_cache(maxsize=256)
def settings_of_bounce(settings: Settings, first: bool, ends: bool) -> Settings:
    """The settings at the first bounce or at a later one, which `ends` paths or does not."""
    return settings._replace(hide_emitters=settings.hide_emitters and first, ends=ends,
                             fixed_start=settings.fixed_start and first, ideal=settings.ideal and first)


@functools.cache
def int32_number(value: int, device: torch.device) -> Tensor:
    """A () int32 tensor of a value on a device, cached."""
    return torch.full((), value, dtype=torch.int32, device=device)


@functools.lru_cache(maxsize=4096)
def position(depth: int, roulette: bool, dtype: torch.dtype, device: torch.device) -> Position:
    """The depth of a bounce on its path, and whether Russian roulette is played there, as cached () tensors."""
    least, most = (SURVIVE_AT_LEAST, SURVIVE_AT_MOST) if roulette else (1.0, 1.0)
    return Position(depth_counter(depth, device), torch.tensor(least, dtype=dtype, device=device),
                    torch.tensor(most, dtype=dtype, device=device))
