"""Renderings as functions of parameters in which decisions stay what they were.

A detached derivative is that of the integrand with proposal and hits held, and not that of the image at one seed, whose
samples move. `Decisions` writes down, at one point, everything that is detached and every answer of the ray caster; later
renderings get the same again, whatever their parameters. What is left is the function that is differentiated.

An attached derivative is that of the image itself, but for discrete choices (reflection or transmission, which light, which
part of the environment), whose probabilities are constants: here only what is detached on behalf of those is held.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module

import torch
from torch import Tensor
from torch.func import functional_call
from torch.overrides import TorchFunctionMode

import torch_radbp as rb
from torch_radbp.adjoint.attached import bounce_attached
from torch_radbp.adjoint.images import render_images
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.packing.pack import pack
from torch_radbp.scene.tables.scene_tensors import SceneTensors, proposal_of
from torch_radbp.tensors.differentiated import detached, settled
from torch_radbp.tensors.record import leaves_of, with_leaves

RENDER = import_module("torch_radbp.rendering.renderer")


class Decisions(TorchFunctionMode):
    """While active, `Tensor.detach` and the ray caster answer as they did the first time that it was active, in order.

    What belongs to a choice is told by `torch_radbp.tensors.differentiated.settled`, which detaches it.

    Args:
        choices: only what `settled` detaches, and the tables of lights and media; else everything.
    """

    def __init__(self, choices: bool = False):
        super().__init__()
        self.choices, self.answers, self.next = choices, [], None
        self.recording, self.asking = False, False

    def __enter__(self) -> Decisions:
        self.recording = self.next is None
        self.next = 0
        RENDER.proposal_of = self.proposal
        return super().__enter__()

    def __exit__(self, *error) -> None:
        super().__exit__(*error)
        RENDER.proposal_of = proposal_of
        if error[0] is None:
            assert self.next == len(self.answers), "a rendering took other decisions than the first one"

    def __torch_function__(self, function, types, arguments=(), keywords=None):
        """What torch asks a mode about every operation: all but `detach` do what they always do."""
        if function is not Tensor.detach:
            return function(*arguments, **(keywords or {}))
        held = not self.asking and (not self.choices or sys._getframe(1).f_code is settled.__code__)
        return self.held(*arguments) if held else function(*arguments)

    def answer(self, ask: Callable):
        """What was answered the first time."""
        if self.recording:
            self.asking = True  # what is detached on the way to the answer is not asked for later
            self.answers.append(ask())
            self.asking = False
        self.next += 1
        return self.answers[self.next - 1]

    def held(self, value: Tensor) -> Tensor:
        """The value that it had the first time, detached."""
        held = self.answer(lambda: value.detach().clone())
        assert held.shape == value.shape and held.dtype == value.dtype
        return held.view_as(held)

    def proposal(self, scene: SceneTensors) -> SceneTensors:
        """`proposal_of`, held: all of it, or only the media by which distances are sampled and the tables from which lights
        are chosen, without the areas that densities on a chosen one are the inverse of."""
        if not self.choices:
            return self.all_held(scene)
        lights, now = self.all_held(scene.lights), detached(scene)
        tables = (held._replace(inverse_area=own.inverse_area) if hasattr(own, "inverse_area") else held
                  for held, own in zip(lights.tables, now.lights.tables))
        return now._replace(lights=lights._replace(tables=tuple(tables)), media=self.all_held(scene.media))

    def all_held(self, record):
        """Every tensor of a record held, also of one without derivatives."""
        return with_leaves(record, [self.held(leaf) if isinstance(leaf, Tensor) else leaf for leaf in leaves_of(record)])


class HeldCaster:
    """The ray caster of a renderer, whose answers are held."""

    def __init__(self, caster, decisions: Decisions):
        self.caster, self.decisions, self.vertices, self.faces = caster, decisions, caster.vertices, caster.faces

    recorded_as = None

    def intersect(self, ray):
        return self.decisions.answer(lambda: self.caster.intersect(ray))

    def occluded(self, ray, tmax):
        return self.decisions.answer(lambda: self.caster.occluded(ray, tmax))


class Rendering:
    """An image as a function of parameters, at one seed.

    Args:
        scene: the scene; its parameters give the point around which decisions are held.
        names: of the parameters.
        seed: of the random numbers.
        **settings: of `Renderer`.
    """

    def __init__(self, scene: rb.Scene, names: list[str], seed: int, **settings):
        self.names, self.seed = names, seed
        # What fused loops detach cannot be held.
        # The places on edges move with the edges.
        self.renderer = rb.Renderer(scene, compile=False, terms=["interior"], share_samples=True, **settings)
        self.decisions = Decisions(choices=settings["sampling"] == "attached")
        # Made now, so that it asks nothing later.
        self.held = HeldCaster(self.renderer.caster_of(pack(scene)), self.decisions)

    def live(self, values: list[Tensor]) -> Tensor:
        """The image with its derivative, as users get it."""
        return functional_call(self.renderer, self.parameters(values), kwargs={"seed": self.seed})

    def with_choices_held(self, values: list[Tensor]) -> Tensor:
        """The image as a function of the parameters around the point, for attached sampling; no derivative."""
        values = attached(values)
        self.forget()
        with self.decisions, torch.enable_grad():
            return self.live(values).detach()

    def along_the_tape(self, values: list[Tensor]) -> Tensor:
        """The same with the decisions held, of which the forward pass makes no use, by the loop that plain autograd records.

        Detached and hybrid sampling hold everything. Attached sampling holds the choice of a smooth lobe: the
        forward pass has its probability inside of the density, and the derivative takes it out.
        """
        parameters = {f"renderer.{name}": value for name, value in self.parameters(attached(values)).items()}
        caster = None if self.decisions.choices else self.held
        self.forget()
        with self.decisions, torch.enable_grad():
            return functional_call(TapedImage(self.renderer, self.seed, caster), parameters)

    def forget(self) -> None:
        """Every rendering packs all anew, so that it detaches the same in the same order as the first one."""
        self.renderer.cache = PackCache()

    def parameters(self, values: list[Tensor]) -> dict[str, Tensor]:
        return {f"scene.{name}": value for name, value in zip(self.names, values)}


def attached(values: list[Tensor]) -> list[Tensor]:
    """Values that require grad: what is derived from them is then packed as it is for a derivative."""
    return [value.detach().requires_grad_() for value in values]


class TapedImage(torch.nn.Module):
    """Renders by the loop over bounces that plain autograd records, but records nothing."""

    def __init__(self, renderer: rb.Renderer, seed: int, caster: HeldCaster | None):
        super().__init__()
        self.renderer, self.seed, self.caster = renderer, seed, caster

    def forward(self) -> Tensor:
        call = self.renderer.prepare(self.seed, None, self.renderer.spp, None)
        integrand = call.make_integrand(call.scene)
        if self.caster is not None:
            integrand = integrand._replace(caster=self.caster)
        with torch.no_grad():
            return render_images(call, integrand, record=False, bounce=bounce_attached(integrand))[0]
