"""`check_gradient`: is the derivative that the renderer computes the derivative of what it renders?

Two estimates of the same derivative image are rendered, in R independent batches each:

    finite differences  D_r = (I(theta + h d; seed_r) - I(theta - h d; seed_r)) / (2 h)
    forward mode        J_r = JVP(theta, d; other seed_r)

Both images of a difference share their samples, which removes most of the noise and does not change the expectation, even
where the integrand jumps: each of the two is an unbiased image. Forward mode uses other samples, so that the two estimates
are independent, and an error that depends on the samples cannot hide in both.

The backward pass is compared with forward mode on the same samples, where <w, J_1> = <VJP_1(w), d> must hold to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call
from torch.nn.functional import interpolate

from torch_radbp.check.outcome import GradientCheck, judge
from torch_radbp.check.statistics import Cotangent, Samples, compare
from torch_radbp.entry import arguments_of, check_arguments, entry
from torch_radbp.jvp import rendering_with_tangent
from torch_radbp.plugin import finite, integer
from torch_radbp.render import Renderer
from torch_radbp.scene import Scene

BATCHES = 16
FEWEST_BATCHES = 8  # with fewer, a standard error is itself too uncertain
RELATIVE_STEP = 0.02  # a product of 8 reflectances is a polynomial whose central difference is then 0.4% off
NEXT_SEED = 0x1000193
DIRECTIONS = ("random", "ones")
STILL = ("value", "data", "scale")  # attributes that move nothing: textures, and factors of emitters


@entry
def check_gradient(scene: Scene, name: str, *, direction: Tensor | str | None = None, spp: int = 256, seed: int = 0,
                   step: float | None = None, sensors: Sequence[int] | None = None, batches: int = BATCHES,
                   progress: Callable[[int, int], None] | None = None, **settings) -> GradientCheck:
    """Compares the derivatives of a rendering, by JVP and by VJP, with finite differences of independent samples.

        print(rb.check_gradient(scene, "white.reflectance.value", spp=256, max_depth=6))

    Args:
        scene: left as it is; nothing needs `requires_grad`.
        name: of the parameter, as in `scene.get_parameter`.
        direction: along which the parameter moves: a tensor of its shape; "ones"; or "random", numbers from 0.5 to 1.5, so
            that no symmetry can hide an error and nothing cancels. None: "ones" for a single number, else "random". The
            two named directions leave the last row of (4, 4) transforms alone.
        spp: samples per pixel of each of the two estimates, over all batches (rounded up to a multiple of `batches`).
        seed: of the random numbers; the same seed gives the same outcome.
        step: h, to both sides, in units of `direction`. None: a step that moves the largest entry of the parameter by
            about 2%, or by 0.02 if the parameter is zero. Where geometry moves, larger steps have less noise, but a larger
            error of their own from the curvature of the image; halving the step reduces that error to a quarter.
        sensors: indices of the sensors to render; None: all.
        batches: independent repetitions, from which standard errors are estimated; at least 8.
        progress: called with the renderings done and all renderings to do.
        **settings: of `Renderer`: `max_depth`, `nee`, `adjoint`, `sampling`, ...

    Returns:
        The figures, with a verdict in words; its `str()` is a table.

    Raises:
        AttributeError: if the scene has no such parameter; the message lists the nearest names.
        ValueError: if an argument makes no sense.
    """
    check_arguments(check_gradient, settings, arguments_of(check_gradient, Renderer.__init__))
    renderer = Renderer(scene, **{"share_samples": True} | settings)
    parameter = scene.get_parameter(name).detach()
    spp, batches = integer("spp", spp, 1), integer("batches", batches, 1)
    if batches < FEWEST_BATCHES:
        raise ValueError(f"batches must be at least {FEWEST_BATCHES}, so that standard errors can be trusted, got {batches}")
    d = checked_direction(name, parameter, direction)
    finite(f"parameter {name!r}", parameter)
    h = checked_step(parameter, d, step)
    measurement = Measurement(renderer, f"scene.{name}", parameter, d, h, -(-spp // batches), seed, sensors, progress,
                              total=4 * batches + 5)
    image, tangent = measurement.forward(batches + 1)
    reference, _ = measurement.difference(0)
    differences, sizes = zip(*(measurement.difference(k) for k in range(1, batches + 1)))
    tangents = [tangent, *(measurement.forward(k)[1] for k in range(batches + 2, 2 * batches + 1))]
    # The rounding of two pixels makes their difference uncertain, even where there is no noise.
    rounding = torch.finfo(image.dtype).eps * torch.stack(sizes).amax(0) / h
    samples = Samples(torch.stack(differences), torch.stack(tangents), rounding)
    cotangents = informative_cotangents(reference, seed)
    backward = measurement.backward(batches + 1, [cotangent.image for cotangent in cotangents])
    comparison = compare(samples, cotangents, backward, torch.finfo(image.dtype).eps)
    return judge(name, d, h, measurement.spp * batches, batches, seed, what_it_sets(name) not in STILL, comparison)


class Measurement:
    """Renderings of a scene with one of its parameters moved."""

    def __init__(self, renderer: Renderer, name: str, value: Tensor, direction: Tensor, step: float, spp: int, seed: int,
                 sensors: Sequence[int] | None, progress: Callable[[int, int], None] | None, total: int):
        self.renderer, self.name, self.value, self.direction, self.step = renderer, name, value, direction, step
        self.spp, self.seed, self.sensors = spp, seed, sensors
        self.progress, self.done, self.total = progress, 0, total

    def arguments(self, number: int) -> dict:
        """The arguments of the rendering of batch `number`; different batches share no samples."""
        return {"seed": self.seed + number * NEXT_SEED, "sensors": self.sensors, "spp": self.spp}

    def count(self, renderings: int) -> None:
        self.done += renderings
        if self.progress is not None:
            self.progress(self.done, self.total)

    def difference(self, number: int) -> tuple[Tensor, Tensor]:
        """The difference quotient of a batch, and the larger of its two images' magnitudes; (B, 3, H, W) float64 each."""
        parameters = {f"scene.{name}": value.detach() for name, value in self.renderer.scene.named_parameters()}
        with torch.no_grad():
            after, before = (functional_call(self.renderer, parameters | {self.name: self.value + h * self.direction},
                                             kwargs=self.arguments(number)).double() for h in (self.step, -self.step))
        self.count(2)
        return (after - before) / (2 * self.step), torch.maximum(after.abs(), before.abs())

    def forward(self, number: int) -> tuple[Tensor, Tensor]:
        """The image of a batch in the scene's dtype, and its derivative by forward mode in float64."""
        tangents = {self.name.removeprefix("scene."): self.direction}
        image, tangent = rendering_with_tangent(self.renderer, tangents, **self.arguments(number))
        self.count(2)
        return image, tangent.double()

    def backward(self, number: int, cotangents: list[Tensor]) -> list[float]:
        """<VJP(w), direction> for each cotangent w, by the backward pass of one batch."""
        value = self.value.clone().requires_grad_()
        parameters = {f"scene.{name}": value.detach() for name, value in self.renderer.scene.named_parameters()}
        with torch.enable_grad():
            image = functional_call(self.renderer, parameters | {self.name: value}, kwargs=self.arguments(number))
        results = []
        for w in cotangents:
            gradient = torch.autograd.grad(image, value, w.to(image.dtype), retain_graph=True, allow_unused=True)[0] \
                if image.requires_grad else None
            results.append(0.0 if gradient is None else float((gradient.double() * self.direction.double()).sum()))
            self.count(1)
        return results


def informative_cotangents(reference: Tensor, seed: int) -> list[Cotangent]:
    """Cotangents that each reveal other errors of a derivative image.

    Args:
        reference: (B, 3, H, W) an estimate of the derivative, independent of those that are compared.
        seed: of the random cotangent.
    """
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.randn(*reference.shape[:2], 4, 4, generator=generator, dtype=reference.dtype, device="cpu")
    smooth = interpolate(coarse, reference.shape[2:], mode="bilinear", align_corners=True).to(reference.device)
    # Each pixel is divided by its own size, too, so that a few bright ones do not drown the others.
    size = reference.abs() + reference.abs().mean()
    own = torch.where(size > 0, reference / torch.where(size > 0, size, 1.0), 0.0)
    return [Cotangent("ones", torch.ones_like(reference)), Cotangent("derivative image", own),
            Cotangent("smooth random", smooth)]


def checked_direction(name: str, parameter: Tensor, direction: Tensor | str | None) -> Tensor:
    """The direction as a tensor like the parameter; raises as `check_gradient` says."""
    if direction is None:
        direction = "ones" if parameter.numel() == 1 else "random"
    if isinstance(direction, str):
        if direction not in DIRECTIONS:
            raise ValueError(f"direction must be {' or '.join(map(repr, DIRECTIONS))} or an array of shape "
                             f"{tuple(parameter.shape)}, got {direction!r}")
        d = torch.ones(parameter.shape, dtype=torch.float64, device="cpu")
        if direction == "random":
            generator = torch.Generator().manual_seed(0)
            d = 0.5 + torch.rand(parameter.shape, generator=generator, dtype=torch.float64, device="cpu")
        if parameter.shape[-2:] == (4, 4):
            d[..., 3, :] = 0
        return d.to(parameter)
    if not isinstance(direction, Tensor):
        direction = torch.from_numpy(np.asarray(direction, dtype=np.float64))
    d = finite(f"direction of {name!r}", direction.detach(), tuple(parameter.shape)).to(parameter)
    if not d.any():
        raise ValueError(f"direction of {name!r} must not be zero everywhere")
    return d


def checked_step(parameter: Tensor, direction: Tensor, step: float | None) -> float:
    """The step, or a suitable one if it is None."""
    if step is None:
        largest = float(parameter.abs().max())
        return RELATIVE_STEP * (largest or 1.0) / float(direction.abs().max())
    if not 0 < step < float("inf"):
        raise ValueError(f"step must be greater than 0 and finite, got {step}; leave it out to have one chosen")
    return float(step)


def what_it_sets(name: str) -> str:
    """The attribute that a parameter sets, directly or through a parametrisation of `torch.nn.utils.parametrize`."""
    parts = name.split(".")
    return parts[parts.index("parametrizations") + 1] if "parametrizations" in parts else parts[-1]
