"""`check_gradient`: compares the renderer's derivatives with finite differences of its images.

Two estimates of the same derivative image are rendered, in R independent batches each:

    finite differences  D_r = (I(theta + h d; seed_r) - I(theta - h d; seed_r)) / (2 h)
    forward mode        J_r = JVP(theta, d; other seed_r)

The images of a difference share their samples, which removes most of the noise and does not change the expectation, even
where the integrand jumps: each is an unbiased image. Forward mode uses other samples, so that the two estimates are
independent, and an error that depends on the samples cannot hide in both. At the end of a parameter's domain the differences
go to the side that is inside, through three images, to the same order; none is rendered outside (`check.stencil`).

Where an edge moves over the border between two pixels, a pixel has a kink: one derivative before it, another after it, and
the differences are a mean of both. So if geometry moves, the second difference I(theta + h d) - 2 I(theta) + I(theta - h d)
is looked at, too. Where it is not noise, half of it over h is how far differences to one side lie from those to both, and so
much of an error is put down to the step.

What else the step h does to the differences shows by half of it: an error of theirs shrinks to a quarter, or to a half where
the image bends sharply, and one of the derivative stays. So if it shrinks by more than noise explains, the step was too
large, and nothing is said of the derivative.

The backward pass is compared with forward mode on the same samples, where <w, J_1> = <VJP_1(w), d> must hold to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from numbers import Real
from typing import NamedTuple

import torch
from torch import Tensor
from torch.func import functional_call
from torch.nn.functional import interpolate
from typing_extensions import Unpack

from torch_radbp.boundary.terms.jump_watch import SilhouetteWarning
from torch_radbp.check.outcome import BIASED, TOO_LARGE, GradientCheck, Question, judge, said_of_floor, said_of_step
from torch_radbp.check.statistics import Cotangent, Estimates, compare
from torch_radbp.check.stencil import ParameterMove, floor_of, inside
from torch_radbp.plugin import finite, integer
from torch_radbp.public_call import passing_on, public_call
from torch_radbp.rendering.jvp import rendering_with_tangent
from torch_radbp.rendering.renderer import Renderer
from torch_radbp.rendering.settings import TERMS, RendererSettings, SensorChoice, checked_seed
from torch_radbp.scene.modules.scene import Scene

BATCHES = 16
FEWEST_BATCHES = 8  # with fewer, a standard error is itself too uncertain
RELATIVE_STEP = 0.02  # a product of 8 reflectances is a polynomial whose central difference is then 0.4% off
FINER = 8.0  # by which a step is divided if it is too large, or geometry moves and nothing else explains an error
TRIES = 3  # steps, of which each is so much finer
NEXT_SEED = 0x1000193
DIRECTIONS = ("random", "ones")
STILL = ("value", "data", "scale")  # attributes that move nothing: textures, and factors of emitters


@public_call
@passing_on(RendererSettings.__annotations__, Renderer.__init__, share_samples=True)
def check_gradient(scene: Scene, name: str, *, direction: Tensor | str | None = None, spp: int = 256, seed: int = 0,
                   step: float | None = None, sensors: SensorChoice = None, batches: int = BATCHES,
                   progress: Callable[[int, int], None] | None = None,
                   **settings: Unpack[RendererSettings]) -> GradientCheck:
    """Compares the derivatives of a rendering, by JVP and by VJP, with finite differences of independent samples.

        print(rb.check_gradient(scene, "white.reflectance.value", spp=256, max_depth=6))

    Args:
        scene: left as it is; nothing needs `requires_grad`.
        name: of the parameter, as in `scene.get_parameter`.
        direction: along which the parameter moves: a tensor of its shape; "ones"; or "random", numbers from 0.5 to 1.5, so
            that no symmetry can hide an error and nothing cancels. None: "ones" for a single number, else "random". The
            named directions leave the last row of (4, 4) transforms alone, and are negative for entries at the upper end of
            their range, if others are at the lower one.
        spp: samples per pixel of each of the two estimates, over all batches (rounded up to a multiple of `batches`).
        seed: of the random numbers; the same seed gives the same outcome.
        step: h, to both sides, in units of `direction`; where that leaves the domain of the parameter, 2 h to one side.
            None: a step that moves the largest entry of the parameter by about 2%, or by 0.02 if the parameter is zero, or
            less if the domain is narrow; an eighth of that, or a 64th, if it is too large, and an eighth if geometry moves
            and nothing else explains an error. Where geometry moves, larger steps have less noise, but a larger error of
            their own from the curvature of the image; halving the step reduces that error to a quarter.
        sensors: index or name of the sensor to render, or several of them; None: all.
        batches: independent repetitions, from which standard errors are estimated; at least 8.
        progress: called with the renderings done and all renderings to do.
        **settings: of `Renderer`: `max_depth`, `nee`, `adjoint`, `sampling`, ...

    Returns:
        The figures, with a verdict in words; its `str()` is a table.

    Raises:
        AttributeError: if the scene has no such parameter; the message lists the nearest names.
        ValueError: if an argument makes no sense, or the step leaves the domain of the parameter to both sides.
    """
    renderer = Renderer(scene, **RendererSettings(share_samples=True) | settings)
    renderer.gradient_watch.told = True  # that a derivative is zero is what the result says
    parameter = scene.get_parameter(name).detach()
    seed = checked_seed("seed", seed)
    spp, batches = integer("spp", spp, 1), integer("batches", batches, 1)
    if batches < FEWEST_BATCHES:
        raise ValueError(f"batches must be at least {FEWEST_BATCHES}, so that standard errors can be trusted, got {batches}")
    d = checked_direction(name, parameter, direction)
    finite(f"parameter {name!r}", parameter)
    place = inside(scene, name, d, checked_step(parameter, d, step), chosen=step is not None,
                   turns=direction is None or isinstance(direction, str))
    batch, moves = BatchRendering(-(-spp // batches), seed, sensors), what_it_sets(name) not in STILL
    for tried in range(TRIES if step is None else 1):
        finer = place._replace(step=place.step / FINER**tried)
        measurement = Measurement(renderer, f"scene.{name}", parameter, finer, batch, moves, progress)
        result = outcome(measurement, name, batches)
        if result.verdict != TOO_LARGE and not (result.verdict == BIASED and moves and tried == 0):
            break
    floor = floor_of(scene, name)
    return said_of_floor(result, floor) if result.verdict in (BIASED, TOO_LARGE) and (parameter < floor).any() else result


def outcome(measurement: Measurement, name: str, batches: int) -> GradientCheck:
    """Evaluates the batches of a measurement to the check's outcome; tests the step of the differences, too."""
    step, stencil, direction = measurement.place
    measurement.total = (batches + 1) * len(measurement.offsets) + 2 * batches + 3
    image, tangent = measurement.forward(batches + 1)
    reference = measurement.difference(0).value
    differences = [measurement.difference(k) for k in range(1, batches + 1)]
    tangents = [tangent, *(measurement.forward(k)[1] for k in range(batches + 2, 2 * batches + 1))]
    # The rounding of the pixels makes their difference uncertain, even where there is no noise.
    eps = torch.finfo(image.dtype).eps
    rounding = eps * sum(map(abs, stencil.weights)) * torch.stack([each.size for each in differences]).amax(0) / step
    samples = Estimates(torch.stack([difference.value for difference in differences]), torch.stack(tangents), rounding,
                        torch.stack([difference.bend for difference in differences]) if measurement.bends else None)
    cotangents = informative_cotangents(reference, measurement.batch.seed)
    backward = measurement.backward(batches + 1, [cotangent.image for cotangent in cotangents])
    spp, seed = measurement.batch.spp * batches, measurement.batch.seed
    question = Question(name, direction, step, stencil.words, spp, batches, seed, measurement.bends,
                        _left_out(measurement.renderer))
    result = judge(question, compare(samples, cotangents, backward, eps))
    if result.verdict != BIASED:
        return result
    finer = measurement.with_step(step / 2)
    halved = torch.stack([finer.difference(k).value for k in range(1, batches + 1)])
    return said_of_step(question, result, *(compare(of, cotangents, backward, eps) for of in (
        samples._replace(difference=halved, rounding=2 * rounding), samples.changed(halved))))


class ImageDifference(NamedTuple):
    """The finite difference of the images of one batch, (B, 3, H, W) float64 each."""

    value: Tensor  # the difference quotient
    size: Tensor  # the largest magnitude of the images
    bend: Tensor | None  # half of the second difference, divided by the step


class BatchRendering(NamedTuple):
    """The arguments of the renderings of a batch."""

    spp: int
    seed: int  # of the first batch
    sensors: SensorChoice = None


class Measurement:
    """Renders a scene with one of its parameters moved, batch by batch."""

    def __init__(self, renderer: Renderer, name: str, value: Tensor, place: ParameterMove, batch: BatchRendering,
                 bends: bool = False, progress: Callable[[int, int], None] | None = None):
        self.renderer, self.name, self.value = renderer, name, value
        self.step, stencil, self.direction = self.place = place
        self.weights, self.bends = dict(zip(stencil.offsets, stencil.weights)), bends
        self.offsets = [offset for offset, weight in self.weights.items() if weight or bends]
        self.batch = batch
        self.progress, self.done, self.total = progress, 0, 0

    def with_step(self, step: float) -> Measurement:
        """A copy of this measurement with another step of the differences, and the same samples."""
        return Measurement(self.renderer, self.name, self.value, self.place._replace(step=step), self.batch)

    def arguments(self, number: int) -> dict:
        """Arguments of the rendering of batch `number`; different batches share no samples."""
        return self.batch._replace(seed=self.batch.seed + number * NEXT_SEED)._asdict()

    def count(self, renderings: int) -> None:
        self.done += renderings
        if self.progress is not None:
            self.progress(self.done, self.total)

    def difference(self, number: int) -> ImageDifference:
        """The finite difference of the images of a batch."""
        parameters = {f"scene.{name}": value.detach() for name, value in self.renderer.scene.named_parameters()}
        images = {}
        with torch.no_grad():
            for offset in self.offsets:
                moved = (self.value + offset * self.step * self.direction).requires_grad_()  # sampled as if differentiated
                images[offset] = functional_call(self.renderer, parameters | {self.name: moved},
                                                 kwargs=self.arguments(number)).double()
        self.count(len(images))
        value = sum(self.weights[offset] * image for offset, image in images.items()) / self.step
        bend = None
        if self.bends:
            before, middle, after = images.values()
            bend = (before - 2 * middle + after) / (2 * self.step)
        return ImageDifference(value, torch.stack([image.abs() for image in images.values()]).amax(0), bend)

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
    image = torch.where(size > 0, reference / torch.where(size > 0, size, 1.0), 0.0)
    return [Cotangent("ones", torch.ones_like(reference)), Cotangent("derivative image", image),
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
    direction = direction.detach() if isinstance(direction, Tensor) else direction
    d = finite(f"direction of {name!r}", direction, tuple(parameter.shape)).to(parameter)
    if not d.any():
        raise ValueError(f"direction of {name!r} must not be zero everywhere")
    return d


def checked_step(parameter: Tensor, direction: Tensor, step: float | None) -> float:
    """The step given, or a suitable one if it is None."""
    if step is None:
        largest = float(parameter.abs().max())
        return RELATIVE_STEP * (largest or 1.0) / float(direction.abs().max())
    if isinstance(step, bool) or not isinstance(step, Real):
        raise ValueError(f"step must be a number, got {step!r}; leave it out to have one chosen")
    if not 0 < step < float("inf"):
        raise ValueError(f"step must be greater than 0 and finite, got {step}; leave it out to have one chosen")
    return float(step)


def _left_out(renderer: Renderer) -> list[str]:
    """Known omissions in the derivatives of a renderer: by its settings, and by its warnings."""
    omissions = [f"terms={tuple(renderer.terms)!r} leaves out {term!r}" for term in TERMS if term not in renderer.terms]
    return omissions + [str(said).partition(". ")[0] for said in renderer.jump_watch.said.values()
                        if isinstance(said, SilhouetteWarning)]


def what_it_sets(name: str) -> str:
    """The attribute behind a parameter's name, also through a parametrisation of `torch.nn.utils.parametrize`."""
    parts = name.split(".")
    return parts[parts.index("parametrizations") + 1] if "parametrizations" in parts else parts[-1]
