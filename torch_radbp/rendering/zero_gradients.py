"""Detects parameters that require a gradient but do not affect any image.

A backward pass that reaches a rendering is watched from there to its end, with hooks that are gone afterwards: a hook on the
image sees whether the loss asks for anything, and hooks on parameters see their gradients, summed over all of the pass. Once
a parameter has had a gradient other than 0 it is not looked at again.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Collection, Mapping
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.hooks import RemovableHandle, unserializable_hook

from torch_radbp.boundary.curve.rendering import listed
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.view import View
from torch_radbp.plugin import Sensor
from torch_radbp.plugin.errors import level_of_the_caller
from torch_radbp.public_call import public_call
from torch_radbp.tensors.torch_internals import at_end_of_backward, backward_pass, batched

ROUNDS = 10  # after so many over a scene's sensors, parts and random choices of views count as all of it
CAUSES = ("what the loss uses of the images does not depend on it. Likely causes: it is out of view or hidden (look at the "
          "image; cameras look along their local +z with y up, not as OpenCV's and OpenGL's do); it is black; no light "
          "reaches it; a lamp is off or faces away; max_depth, terms or the loss leave out what depends on it")
RAYS = 0.1  # of a round, what a call for rays counts as: there may be others


class ZeroGradientWarning(UserWarning):
    """The gradient of a parameter was exactly 0 in the first backward passes, so that an optimisation would not move it.

    Of a scene with several sensors this is said after a round over all of them. It is not said where the loss has no
    derivative, nor of parameters that are used in part. Each renderer says it once;
    `warnings.simplefilter("ignore", rb.ZeroGradientWarning)` silences it.
    """


class UsedImage(NamedTuple):
    """An image that the loss of a backward pass uses."""

    sensor: str | None  # its name, if the loss uses its whole image, black pixels aside
    share: float  # fraction of all images of the scene


class Pass:
    """The state of a backward pass that is being observed."""

    def __init__(self):
        self.looks: dict[str, list[UsedImage]] = {}  # of each parameter, at the images that may depend on it
        self.hooks: list[RemovableHandle] = []
        self.found: dict[str, Tensor | bool] = {}  # of each parameter that was reached, whether its gradient is not 0


class Unseen:
    """The images in which a parameter has had no gradient so far."""

    def __init__(self):
        self.sensors: set[str] = set()
        self.rounds = 0.0  # over all sensors

    def add(self, looks: list[UsedImage]) -> None:
        """Adds the images of one more backward pass that gave the parameter no gradient."""
        self.sensors |= {look.sensor for look in looks if look.sensor is not None}
        self.rounds += sum(look.share for look in looks)

    def suffices(self, sensors: Collection[str]) -> bool:
        """True after a round over all sensors that may see it, or after many images that may have been partial."""
        # Processes that share the views of a scene see their own ones only.
        alone = not (torch.distributed.is_available() and torch.distributed.is_initialized())
        return self.sensors.issuperset(sensors) or (alone and self.rounds > ROUNDS - 0.5 * RAYS)


class GradientWatch:
    """Warns once if the backward passes of a renderer give parameters a gradient of exactly 0."""

    def __init__(self):
        self.told = False
        self.seen: set[str] = set()  # parameters that have had a gradient
        self.unseen: dict[str, Unseen] = {}  # others
        self.passes: dict[int, Pass] = {}

    def __reduce__(self):
        return GradientWatch, ()

    def watched(self, images: Tensor, call: RenderCall) -> Tensor:
        """Adds a hook to images (B, 3, H, W), or radiance along rays (N, 3), if needed; returns the same tensor."""
        if images.requires_grad and not self.told and not call.parameters.keys() <= self.seen:
            sensors = call.module.named_sensors
            looks = [look_of(view, sensors) for view in call.views]
            shown = images.detach().ne(0).any(1)
            images.register_hook(partial(self.begin, call.parameters, looks, list(sensors), shown))
        return images

    @public_call
    def begin(self, parameters: Mapping[str, Tensor], looks: list[UsedImage], sensors: list[str], shown: Tensor,
              adjoint: Tensor | None) -> None:
        """Starts to observe a backward pass that has reached images.

        Args:
            parameters: by name, all that derivatives are wanted of.
            looks: one for each image, if the loss uses all of it.
            sensors: names of all of the scene.
            shown: bool, of each pixel or ray, whether it is not black.
            adjoint: of the images; None: 0.
        """
        number = backward_pass()
        if self.told or number is None or adjoint is None or batched(adjoint):
            return
        if number not in self.passes:
            self.passes[number] = Pass()
            at_end_of_backward(partial(self.conclude, number, sensors))
        now, used = self.passes[number], adjoint.detach().ne(0).any(1)
        asked, left_out = (part.reshape(len(looks), -1).any(1).tolist() for part in (used, shown & ~used))
        looks = [look._replace(sensor=None) if partly else look
                 for look, some, partly in zip(looks, asked, left_out) if some]
        for name in parameters if looks else ():
            if name in self.seen:
                continue
            if name not in now.looks:
                now.hooks.append(parameters[name].register_hook(unserializable_hook(partial(self.note, now, name))))
            now.looks.setdefault(name, []).extend(looks)

    @staticmethod
    @public_call
    def note(now: Pass, name: str, gradient: Tensor | None) -> None:
        """Receives the gradient of a parameter, summed over a backward pass."""
        now.found[name] = gradient is not None and (gradient.layout != torch.strided or gradient.detach().ne(0).any())

    @public_call
    def conclude(self, number: int, sensors: list[str]) -> None:
        """Ends the observation of a backward pass; warns if it shows that parameters have no gradient."""
        now = self.passes.pop(number)
        for hook in now.hooks:
            hook.remove()
        whole: dict[str, list[str]] = {}
        for name in now.looks:
            if name in now.found:
                whole.setdefault(whole_name(name), []).append(name)
        for name, parts in whole.items():
            if any(bool(now.found[part]) for part in parts):
                self.unseen.pop(name, None)
                self.seen |= {part for part in now.looks if whole_name(part) == name}
            else:
                self.unseen.setdefault(name, Unseen()).add(now.looks[parts[0]])
        silent = [name for name, unseen in self.unseen.items() if unseen.suffices(which_see(name, sensors))]
        if silent and not self.told:
            self.told, self.unseen = True, {}
            warnings.warn(f"the gradient of {listed(silent)} was exactly 0 in all backward passes so far: {CAUSES}",
                          ZeroGradientWarning, stacklevel=level_of_the_caller())


def which_see(parameter: str, sensors: list[str]) -> list[str]:
    """The sensors whose images a parameter may affect: a camera's parameter only its own."""
    return [sensor for sensor in sensors if parameter.startswith(f"{sensor}.")] or sensors


def look_of(view: View, sensors: Mapping[str, Sensor]) -> UsedImage:
    """The image of a view, all of which the loss uses, as a share of the scene's images; `sensors`: all of the scene."""
    name = next((name for name, sensor in sensors.items() if sensor is view.sensor), None)
    if name is None:
        return UsedImage(None, RAYS)
    film = view.sensor.film
    share = view.width * view.height / (film.crop_width * film.crop_height)
    return UsedImage(name if share == 1 else None, share / len(sensors))


def whole_name(parameter: str) -> str:
    """The scene's name for what a parameter is part of: a network, a parametrised tensor, or itself."""
    return re.sub(r"parametrizations\.(\w+)\..*", r"\1", parameter).partition(".module.")[0]
