"""What the stages of a rendering are called with, in the forward and the backward pass."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from importlib import import_module
from unittest import mock

import torch

import torch_radbp as rb
from tests.gradients import cotangent
from tests.scenes.everything import EVERYTHING, build_everything
from tests.scenes.networks import lit_room, room
from torch_radbp.film.gaussian import Gaussian
from torch_radbp.jit.recording.structure import flatten
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.stage import DECLARED, PlainStages

NETWORKS = {"networks": room, "shining networks": lit_room}
SEED = 1
SCENES = (*EVERYTHING, *NETWORKS)
SAMPLINGS = ("hybrid", "attached")
Calls = dict[str, dict[tuple, tuple]]  # arguments, by the stage's name and their structure


def stages_of_the_package() -> list[Callable]:
    """All stages but those that tests declare."""
    return [stage for stage in DECLARED if stage.__module__.startswith("torch_radbp.")]


def recording() -> tuple[PlainStages, Calls]:
    """The eager stages, and where the arguments of their calls are noted."""
    found: Calls = {stage.__name__: {} for stage in stages_of_the_package()}

    def watched(stage: Callable) -> Callable:
        def call(*arguments):
            key: list = []
            flatten(arguments, [], key)
            found[stage.__name__].setdefault(tuple(key), detached(arguments))  # some calls are recorded by autograd
            return stage(*arguments)
        return call

    return PlainStages({stage: watched(stage) for stage in stages_of_the_package()}), found


def stage_named(name: str) -> Callable:
    """The stage of a name."""
    stage, = (stage for stage in stages_of_the_package() if stage.__name__ == name)
    return stage


def build(name: str, dtype: torch.dtype = torch.float64) -> rb.Scene:
    """A scene of `SCENES`, of which everything is differentiated."""
    return (NETWORKS[name](dtype=dtype) if name in NETWORKS else build_everything(name, dtype)).requires_grad_()


@functools.lru_cache(maxsize=1)  # of those that follow each other in a file
def calls_of(name: str, sampling: str, dtype: torch.dtype = torch.float64) -> Calls:
    """The arguments of all calls of the stages while a scene of `SCENES` is rendered, differentiated and described."""
    stages, found = recording()
    with mock.patch.object(import_module("torch_radbp.rendering.renderer"), "EAGER", stages), warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.SilhouetteWarning)
        warnings.simplefilter("ignore", rb.JumpWarning)
        scene = build(name, dtype)
        for sensor in scene.sensors:
            sensor.film.rfilter = Gaussian()  # a box counts in one pixel, which takes no function of lanes
        renderer = rb.Renderer(scene, spp=2, max_depth=4, rr_depth=2, sampling=sampling, compile=False)
        image = renderer(seed=SEED)
        image.backward(cotangent(image.detach()))
        if not any(isinstance(emitter.radiated(), rb.NeuralTexture) for emitter in scene.emitters):
            seeing = [number for number, each in enumerate(scene.sensors) if each.tensors().kind.sees_points]
            renderer.light_paths = "all"
            image = renderer(seed=SEED, sensors=seeing[:1])
            image.backward(cotangent(image.detach()))
            renderer.light_paths = "camera"
        with torch.no_grad():
            tangents = {name: torch.zeros_like(value) for name, value in scene.named_parameters()}
            tangents[next(name for name in tangents if name.endswith("to_world"))][0, 3] = 1.0
            settings = {"spp": 2, "max_depth": 4, "rr_depth": 2, "sampling": sampling, "compile": False}
            assert rb.jvp(scene, tangents, seed=SEED, **settings).any()
            assert all(values.isfinite().all() for values in renderer.aovs(["sh_normal", "uv", "albedo"]).values())
    return found
