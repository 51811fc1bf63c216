"""Checks the arguments of a renderer and its calls: settings, samples per pixel, seeds and sensors."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Protocol, TypedDict

import numpy as np
import torch
from torch import nn

import torch_radbp.adjoint as adjoint
from torch_radbp.adjoint.strategy import AdjointStrategy
from torch_radbp.boundary.terms.jump_watch import JumpWatch
from torch_radbp.integrator.settings import depths
from torch_radbp.path.state import Settings
from torch_radbp.plugin import REGISTRY, Sensor, boolean, integer, nearest
from torch_radbp.rendering.memory import parse_budget
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.tables.light_choice import CHOICES
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.differentiated import any_differentiated

SensorChoice = int | str | Sequence[int | str] | None  # by index or name; None: all

INTERIOR, PRIMARY, SHADOW = "interior", "primary", "shadow"
TERMS = (INTERIOR, PRIMARY, SHADOW)  # of derivatives
SAMPLINGS = ("hybrid", "detached", "attached")
LIGHT_PATHS = ("camera", "caustics", "all", "auto")
OF_DERIVATIVE = 0x3F84D5B5B5470917  # what the seed of a derivative differs by: digits of pi, so far from any counter
UNLIMITED = 1024  # bounces; roulette ends a path long before


class RendererSettings(TypedDict, total=False):
    """The types of the keyword arguments of `Renderer` but scene and spp, for functions that pass these arguments on."""

    max_depth: int | None
    rr_depth: int | None
    hide_emitters: bool | None
    adjoint: AdjointStrategy | None
    sampling: str
    nee: bool | None
    chunk: int | None
    memory_budget: str | int | None
    compile: bool
    caster: str | None
    light_choice: str | None
    terms: Collection[str]
    share_samples: bool
    light_paths: str | None


class CheckedRenderer(Protocol):
    """What of a renderer the functions beside it read: its settings, checked, and its warnings."""

    scene: Scene
    sampling: str
    nee: bool
    hide_emitters: bool
    light_paths: str
    jump_watch: JumpWatch


def checked_scene(scene: Scene) -> Scene:
    """Checks that `scene` can be rendered, and returns it.

    Raises:
        TypeError: if it is no scene.
        ValueError: if it has no shape.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a torch_radbp.Scene (from load or load_dict), got {type(scene).__name__}")
    if not scene.shapes:
        raise ValueError(f"the scene has no shape to render: add a rectangle, cube or another of "
                         f"{', '.join(sorted(REGISTRY['shape']))}")
    return scene


def check_settings(renderer: nn.Module) -> None:
    """Checks the settings of a renderer, and converts each to the type in which it is used.

    Raises:
        ValueError: for a value that makes no sense.
        TypeError: for an adjoint that is none.
    """
    renderer.chosen_spp = None if renderer.chosen_spp is None else integer("spp", renderer.chosen_spp, 1)
    renderer.max_depth, renderer.rr_depth = depths(renderer.max_depth, renderer.rr_depth)
    renderer.hide_emitters = boolean("hide_emitters", renderer.hide_emitters)
    renderer.nee, renderer.compile_stages = boolean("nee", renderer.nee), boolean("compile", renderer.compile_stages)
    renderer.share_samples = boolean("share_samples", renderer.share_samples)
    renderer.chunk = None if renderer.chunk is None else integer("chunk", renderer.chunk, 1)
    renderer.memory_budget = None if renderer.memory_budget is None else parse_budget(renderer.memory_budget)
    if not isinstance(renderer.adjoint, AdjointStrategy):
        known = ", ".join(name for name in adjoint.__all__ if name != AdjointStrategy.__name__)
        raise TypeError(f"adjoint must be one of {known}, or of a class derived from AdjointStrategy, "
                        f"got {renderer.adjoint!r}")
    for name, known in (("light_choice", (*CHOICES, None)), ("light_paths", LIGHT_PATHS)):
        value = getattr(renderer, name)
        if value not in known:
            raise ValueError(f"{name}={value!r} is not known; {nearest(str(value), list(filter(None, known)))}")
    terms = renderer.terms
    if not isinstance(terms, Collection) or isinstance(terms, str) or any(term not in TERMS for term in terms):
        raise ValueError(f"terms={terms!r} is not known; it must be a set or list of some of {', '.join(TERMS)}")
    if renderer.sampling not in SAMPLINGS:
        raise ValueError(f"sampling={renderer.sampling!r} is not known; {nearest(str(renderer.sampling), SAMPLINGS)}")


def settings_of_integrand(renderer: CheckedRenderer, scene: SceneTensors, cameras: Sequence[Camera]) -> Settings:
    """The settings with which the integrand of a call is compiled: which rays carry derivatives."""
    sampling = renderer.sampling
    moving = sampling == "attached" or any_differentiated((scene.triangles, cameras)) or (
        sampling == "hybrid" and scene.layout.bending) or (scene.layout.traces_segments and scene.lights_move)
    if scene.layout.emitting_media and any(shape.bsdf.kind().straight for shape in renderer.scene.shapes):
        # What is emitted along a ray counts whatever the ray meets, a boundary or what is behind it. So its direction must
        # not follow a point there, as it does unless all sampling is attached.
        sampling = "attached"
    following = moving and sampling == "hybrid" and any(look.kind.follows for look in scene.layout.appearances)
    nee = renderer.nee and bool(renderer.scene.emitters)  # else media alone emit, to which nothing connects
    return Settings(nee=nee, hide_emitters=renderer.hide_emitters, moving=moving,
                    sampling=sampling if moving else "detached", following=following)


def refuse_tracing() -> None:
    """Raises RuntimeError inside of `torch.jit.trace`."""
    if torch.jit.is_tracing():
        raise RuntimeError("a rendering cannot be traced by torch.jit.trace, since its operations depend on the paths: "
                           "trace the networks around it, or call the renderer as it is")


def samples_per_pixel(spp: int | None, sensors: Sequence[Sensor]) -> int:
    """Samples per pixel: `spp`, or what the sensors' samplers say.

    Raises:
        ValueError: if it is no integer of at least 1, or nothing is chosen and the samplers disagree.
    """
    if spp is not None:
        return integer("spp", spp, 1)
    counts = {sensor.sampler.sample_count for sensor in sensors}
    if len(counts) > 1:
        raise ValueError(f"the sensors of one call must have samplers of one sample_count, got {sorted(counts)}; give "
                         f"spp, or render them in separate calls")
    return counts.pop()


def checked_seed(name: str, value: int) -> int:
    """Checks a seed: an int of at most 64 bits.

    Raises:
        ValueError: if it is no integer, or needs more bits.
    """
    seed = integer(name, value)
    if not -(1 << 63) <= seed < 1 << 64:
        raise ValueError(f"{name} must be from -2**63 to 2**64 - 1, got {seed}")
    return seed


def checked_seeds(seed: int | None, seed_grad: int | None, share_samples: bool) -> tuple[int, int]:
    """Checks the seeds of an image and of its derivative, and picks those that are None.

    Raises:
        ValueError: as `checked_seed`.
    """
    seed = checked_seed("seed", 0 if seed is None else seed)
    if seed_grad is not None:
        return seed, checked_seed("seed_grad", seed_grad)
    return seed, seed if share_samples else seed ^ OF_DERIVATIVE


def sensor_indices(scene: Scene, sensors: SensorChoice) -> list[int]:
    """The indices of sensors chosen by index or name, one or several; None: all.

    Raises:
        ValueError: if there is no such sensor, or none is chosen.
    """
    names = list(scene.named_sensors)
    wanted = range(len(names)) if sensors is None else [sensors] if np.ndim(sensors) == 0 else sensors
    indices = []
    for sensor in wanted:
        if isinstance(sensor, str) and sensor not in names:
            raise ValueError(f"the scene has no sensor {sensor!r}; {nearest(sensor, names)}")
        indices.append(names.index(sensor) if isinstance(sensor, str) else integer("sensors: an index", sensor))
    if not indices or any(not 0 <= index < len(names) for index in indices):
        raise ValueError(f"sensors must be indices from 0 to {len(names) - 1}, got {sensors}")
    return indices
