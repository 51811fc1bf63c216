"""The renderers that are compared, each with the same scene: passes that are timed, gradients, images."""

from __future__ import annotations

import copy
import glob
import os
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

import torch_radbp as rb
from benchmarks.scenes.description import NO_ROULETTE, BenchmarkScene, cotangent

LLVM = ("/usr/lib/*/libLLVM.so.19*", "/usr/lib/*/libLLVM-19.so*")  # Debian's libllvm19
CHANGE = 1e-5  # relative, of parameters
PRB = ("interior",)  # the terms of derivatives that `prb` has


class Pass(NamedTuple):
    """What a forward and backward pass took, in seconds."""

    forward: float
    backward: float
    cpu: float  # of all threads, both passes

    @property
    def both(self) -> float:
        return self.forward + self.backward


def change(seed: int) -> float:
    """What the parameters are multiplied by before a pass, as an optimiser would change them; seeds in turn undo it."""
    return 1 + CHANGE if seed % 2 else 1 / (1 + CHANGE)


def timed(forward: Callable[[], object], backward: Callable[[object], None], settle: Callable[[], None]) -> Pass:
    """Times a forward pass, and the backward pass that is given its result; `settle` waits until the work is done."""
    settle()
    cpu, start = time.process_time(), time.perf_counter()
    image = forward()
    settle()
    middle = time.perf_counter()
    backward(image)
    settle()
    end = time.perf_counter()
    return Pass(middle - start, end - middle, time.process_time() - cpu)


class Ours:
    """This renderer, on the CPU or on CUDA."""

    def __init__(self, scene: BenchmarkScene, compiled: bool, device: str = "cpu", share_samples: bool = False,
                 terms: Sequence[str] = PRB):
        warnings.simplefilter("ignore", rb.SilhouetteWarning)
        self.renderer = scene.renderer(compiled, share_samples=share_samples, terms=terms).to(device)
        self.settle = torch.cuda.synchronize if device == "cuda" else lambda: None
        self.parameters = {name: self.renderer.scene.get_parameter(name) for name in scene.parameters}
        self.cotangent = torch.from_numpy(cotangent(scene.setting.resolution)).permute(2, 0, 1)[None].to(device)

    def run(self, seed: int) -> Pass:
        """A forward and backward pass with changed parameters."""
        with torch.no_grad():
            for parameter in self.parameters.values():
                parameter.mul_(change(seed))
        self.renderer.scene.zero_grad()

        def forward() -> Tensor:
            self.image_of_pass = self.rendering(seed)
            return self.image_of_pass

        return timed(forward, lambda image: (image * self.cotangent).sum().backward(), self.settle)

    def pixels(self) -> np.ndarray:
        """The image of the last pass."""
        return self.image_of_pass.detach().cpu().numpy()

    def gradients_found(self) -> dict[str, np.ndarray]:
        """Those of the last pass by parameter."""
        return {name: parameter.grad.cpu().numpy().copy() for name, parameter in self.parameters.items()}

    def rendering(self, seed: int) -> Tensor:
        """The images, attached to the parameters."""
        return self.renderer(seed=seed)

    def gradient_sums(self) -> dict[str, float]:
        """The sum of the gradient's entries, for each parameter."""
        return {name: float(parameter.grad.sum(dtype=torch.float64)) for name, parameter in self.parameters.items()}

    def image(self, spp: int, seed: int) -> Tensor:
        """(3, H, W) linear RGB."""
        with torch.no_grad():
            return self.renderer(seed=seed, spp=spp)[0]


VARIANTS = {"cpu": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}


def mitsuba_for(device: str):
    """The module `mitsuba` in its variant for a device.

    Raises:
        ImportError: if Mitsuba is not installed, or finds no LLVM.
    """
    libraries = [path for pattern in LLVM for path in sorted(glob.glob(pattern))]
    if libraries:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", libraries[0])
    import mitsuba as mi

    mi.set_variant(VARIANTS[device])
    mi.set_log_level(mi.LogLevel.Error)  # a material's colour may be brighter than 1 for a moment
    return mi


def translated(mi, description: dict) -> dict:
    """The description with Mitsuba's transforms, and without what it does unasked."""
    found = {}
    for key, value in description.items():
        if isinstance(value, dict):
            value = translated(mi, value)
        elif isinstance(value, np.ndarray):
            value = mi.ScalarTransform4f(value)
        if key != "recompute_normals":
            found[key] = value
    return found


class Mitsuba:
    """An integrator of Mitsuba's in the variant for a device; what it evaluates lazily is forced within the measured time.

    Args:
        scene: that is rendered.
        device: "cpu" or "cuda".
        integrator: in Mitsuba's dict vocabulary, without depths. If it has numbers of samples for the parts of a derivative,
            those hold, and images have the samples of the scene's sampler.

    Raises:
        ImportError: if Mitsuba is not installed, or finds no LLVM.
    """

    def __init__(self, scene: BenchmarkScene, device: str = "cpu", integrator: dict[str, Any] | None = None):
        mi = mitsuba_for(device)
        import drjit as dr

        self.dr, self.mi, (resolution, spp, self.max_depth) = dr, mi, scene.setting
        if isinstance(scene.source, Path):
            self.scene = mi.load_file(str(scene.source), resolution=resolution)
        else:
            self.scene = mi.load_dict(translated(mi, scene.source))
        self.use({"type": "prb"} if integrator is None else integrator, spp)
        self.parameters, self.names = mi.traverse(self.scene), scene.parameters
        self.parameters.keep(list(self.names))
        self.cotangent = mi.TensorXf(cotangent(resolution))
        dr.eval(self.cotangent)

    def use(self, integrator: dict[str, Any], spp: int) -> None:
        """Renders with an integrator, so many samples a pixel, from now on."""
        self.spp = 0 if "sppc" in integrator else spp
        self.integrator = self.mi.load_dict(integrator | {"max_depth": self.max_depth, "rr_depth": NO_ROULETTE})

    def using(self, integrator: dict[str, Any], spp: int) -> Mitsuba:
        """Another integrator with the same scene and parameters: kernels contain what every scene in memory has."""
        other = copy.copy(self)
        other.use(integrator, spp)
        return other

    def run(self, seed: int) -> Pass:
        """A forward and backward pass with changed parameters, both evaluated to the end."""
        dr, leaves = self.dr, {}
        for name in self.names:
            leaves[name] = dr.detach(self.parameters[name]) * change(seed)
            dr.eval(leaves[name])
            dr.enable_grad(leaves[name])
            self.parameters[name] = leaves[name]

        def forward():
            self.parameters.update()
            image = self.mi.render(self.scene, self.parameters, integrator=self.integrator, spp=self.spp, seed=2 * seed,
                                   seed_grad=2 * seed + 1)
            dr.eval(image)
            self.image_of_pass = image
            return image

        def backward(image) -> None:
            dr.backward(dr.sum(image * self.cotangent, axis=None))
            self.gradients = {name: dr.grad(leaf) for name, leaf in leaves.items()}
            dr.eval(self.gradients)

        return timed(forward, backward, dr.sync_thread)

    def pixels(self) -> np.ndarray:
        """The image of the last pass."""
        return np.array(self.image_of_pass)

    def gradients_found(self) -> dict[str, np.ndarray]:
        """Those of the last pass by parameter."""
        return {name: np.array(gradient) for name, gradient in self.gradients.items()}

    def gradient_sums(self) -> dict[str, float]:
        """The sum of the gradient's entries, for each parameter."""
        return {name: float(np.sum(np.array(gradient), dtype=np.float64)) for name, gradient in self.gradients.items()}

    def image(self, spp: int, seed: int) -> Tensor:
        """(3, H, W) linear RGB."""
        image = self.mi.render(self.scene, integrator=self.integrator, spp=spp, seed=seed)
        return torch.from_numpy(np.array(image)).permute(2, 0, 1).contiguous()
