"""Noise where lamps shine through or off what is narrow, by who brings the light: ``python -m benchmarks.caustic_noise``.

Lamps of some extent, so that paths from the camera find all light, if by chance: a ball of glass under a lamp, a bulb (a
lamp in a ball of glass), a mirror beside a lamp, a glossy ball under a small lamp; 32 x 32 pixels, 64 samples, depth 5. Each
is rendered and differentiated with paths from the camera alone (`Renderer(light_paths="camera")`) and in the other ways, in
turns. For image and for the derivative of each parameter it prints variance times CPU seconds over that of the camera's
paths: below 1 the way is better. Variances are sums over entries, of many seeds; `z` is the greatest difference of a
derivative's sum from the camera's, in standard errors: where mirrors and glass move, the camera's lacks edges of lamps that
surfaces see there, as a warning says. The loss is the mean of the image, weighted by a fixed pattern. Image and derivative
have samples of their own.

``--balls`` prints instead how noisy the derivative by the place of a ball of plastic before a floor is beside that of a
diffuse one, with terms of the interior alone and with all terms. ``z`` is that of each of the three entries against
differences of images all of whose light comes from lamps (`Renderer(light_paths="all")`), with the same random numbers on
both sides, four times the samples and at most 64 seeds: with "camera" alone derivatives are biased, since they lack edges of
the lamp that the floor sees in the coat, as a warning says.
"""

from __future__ import annotations

import argparse
import statistics
import time
import warnings
from typing import Any, NamedTuple

import numpy as np
import torch
from rich.progress import track
from torch import Tensor

import torch_radbp as rb

SIZE, SPP, DEPTH = 32, 64, 5
STEP, FINER, MOST_DIFFERENCES = 0.02, 4, 64  # of differences: by what a ball moves, times as many samples, seeds
WAYS = ("camera", "auto", "caustics", "all")
GLASS, MIRROR = {"type": "dielectric"}, {"type": "conductor", "material": "none"}


def rgb(*values: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(values)}


def rectangle(at: list[float], towards: list[float], size: float, **more: Any) -> dict[str, Any]:
    """A square, `size` from its middle to its sides, that faces a point."""
    pose = rb.look_at(at, towards, up=[0, 1, 0.01]).numpy() @ np.diag([size, size, 1.0, 1.0])
    return {"type": "rectangle", "to_world": pose, **more}


def ball(at: list[float], radius: float, **more: Any) -> dict[str, Any]:
    return {"type": "sphere", "center": at, "radius": radius, **more}


def lamp(brightness: float) -> dict[str, Any]:
    return {"type": "area", "radiance": rgb(brightness, 0.9 * brightness, 0.8 * brightness)}


def room(**things: Any) -> dict[str, Any]:
    """A floor that the camera looks down at, with things on it."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "gaussian"}, "pixel_format": "rgb"}
    eye = rb.look_at([0, -2.6, 3.4], [0, 0, 0.2], up=[0, 0, 1]).numpy()
    return {"type": "scene", "integrator": {"type": "path", "max_depth": DEPTH, "rr_depth": 100},
            "camera": {"type": "perspective", "fov": 45.0, "to_world": eye, "film": film},
            "floor": rectangle([0, 0, 0], [0, 0, 1], 3.0, bsdf={"type": "diffuse", "reflectance": rgb(0.6, 0.5, 0.4)}),
            **things}


ABOVE = rectangle([0.6, 0.3, 3.0], [0, 0, 0], 0.25, emitter=lamp(20.0))
FLOOR = "floor.bsdf.reflectance.value"
SCENES = {
    "glass ball": (room(lamp=ABOVE, ball=ball([0, 0, 0.7], 0.5, bsdf=GLASS)),
                   ("ball.to_world", "ball.bsdf.eta", "lamp.emitter.radiance.value", FLOOR)),
    "bulb": (room(lamp=ball([0, 0, 0.8], 0.1, emitter=lamp(20.0)), ball=ball([0, 0, 0.8], 0.5, bsdf=GLASS)),
             ("ball.to_world", "lamp.emitter.radiance.value", FLOOR)),
    "mirror": (room(lamp=rectangle([-0.9, 0, 1.0], [0.6, 0, 0.8], 0.1, emitter=lamp(60.0)),
                    mirror=rectangle([0.9, 0, 0.8], [-0.6, 0, 0.2], 0.5, bsdf=MIRROR)),
               ("mirror.to_world", "lamp.emitter.radiance.value", FLOOR)),
    "glossy ball": (room(lamp=rectangle([0.6, 0.3, 3.0], [0, 0, 0], 0.08, emitter=lamp(200.0)),
                         ball=ball([0, 0, 0.7], 0.5, bsdf={"type": "roughconductor", "material": "none", "alpha": 0.1})),
                    ("ball.to_world", "ball.bsdf.alpha.value", FLOOR)),
}
PLASTIC = {"type": "plastic", "diffuse_reflectance": rgb(0.5, 0.4, 0.3)}
BALLS = {name: (room(lamp=ABOVE, ball=ball([0, 0, 0.7], 0.5, bsdf=bsdf)), ("ball.to_world",)) for name, bsdf in
         {"diffuse": {"type": "diffuse", "reflectance": rgb(0.5, 0.4, 0.3)}, "plastic": PLASTIC}.items()}


def loss_of(image: Tensor) -> Tensor:
    return (image * torch.linspace(0.5, 1.5, SIZE * SIZE).view(SIZE, SIZE)).mean()


class Samples(NamedTuple):
    """What seeds have given: images and derivatives, and CPU seconds of both passes."""

    images: list[Tensor]
    gradients: list[list[Tensor]]
    seconds: list[float]


class Way:
    """A scene by one way of bringing light. Args: see `main`."""

    def __init__(self, description: dict[str, Any], names: tuple[str, ...], light_paths: str, terms: tuple[str, ...] | None):
        scene = rb.load_dict(description)
        settings = {} if terms is None else {"terms": terms}
        self.renderer = rb.Renderer(scene, spp=SPP, light_paths=light_paths, **settings)
        parameters = dict(scene.named_parameters())
        self.parameters = [parameters[name].requires_grad_() for name in names]
        self.samples = Samples([], [], [])

    def run(self, seed: int, counts: bool) -> None:
        """Both passes; what they give counts, or they only warm up."""
        start = time.process_time()
        image = self.renderer(seed=seed)
        gradients = torch.autograd.grad(loss_of(image), self.parameters)
        seconds = time.process_time() - start
        if counts:
            for found, value in zip(self.samples, (image.detach().double(), [each.double() for each in gradients], seconds)):
                found.append(value)

    def costs(self) -> list[float]:
        """Variance times seconds of the image and of each derivative."""
        found = [self.samples.images, *map(list, zip(*self.samples.gradients))]
        seconds = statistics.median(self.samples.seconds)
        return [seconds * torch.stack(values).var(0).sum().item() for values in found]

    def derivative(self) -> tuple[Tensor, Tensor]:
        """The sum of each derivative's entries, and its variance."""
        sums = torch.tensor([[each.sum() for each in gradients] for gradients in self.samples.gradients])
        return sums.mean(0), sums.var(0) / len(sums)


def measured(description: dict[str, Any], names: tuple[str, ...], ways: tuple[str, ...], seeds: int,
             terms: tuple[str, ...] | None, title: str) -> dict[str, Way]:
    """All ways, in turns."""
    found = {way: Way(description, names, way, terms) for way in ways}
    for seed in track(range(-1, seeds), title, transient=True):
        for number, way in enumerate(found.values()):
            way.run(1 + seed + (number + 1) * 10**6, seed >= 0)
    return found


def scene_rows(seeds: int, only: list[str]) -> None:
    """The table of the scenes."""
    print("| scene | way | image | derivatives | z |", "|---" * 5 + "|", sep="\n")
    for name in only:
        description, names = SCENES[name]
        found = measured(description, names, WAYS, seeds, None, name)
        before, (mean, variance) = found["camera"].costs(), found["camera"].derivative()
        for way in WAYS[1:]:
            image, *costs = (after / first for after, first in zip(found[way].costs(), before))
            other, doubt = found[way].derivative()
            z = ((other - mean) / (variance + doubt).sqrt().clamp_min(1e-30)).tolist()
            cells = ", ".join(f"`{each}` {cost:.2f}" for each, cost in zip(names, costs))
            worst = max(z, key=abs)
            print(f"| {name} | {way} | {image:.2f} | {cells} | {worst:+.1f} `{names[z.index(worst)]}` |", flush=True)


def differences(description: dict[str, Any], name: str, seeds: int) -> Tensor:
    """(seeds, 3) differences of the loss by the place of a pose, all of whose light comes from lamps."""
    scene = rb.load_dict(description)
    renderer, pose = rb.Renderer(scene, spp=FINER * SPP, light_paths="all"), scene.get_parameter(name)
    found = torch.zeros(seeds, 3, dtype=torch.float64)
    with torch.no_grad():
        for seed in track(range(seeds), "differences", transient=True):
            for axis in range(3):
                for sign in (1, -1):
                    pose[axis, 3] += sign * STEP
                    found[seed, axis] += sign * loss_of(renderer(seed=seed).double()) / (2 * STEP)
                    pose[axis, 3] -= sign * STEP
    return found


def mean_and_variance(values: Tensor) -> tuple[Tensor, Tensor]:
    """The mean of rows, and the variance of that."""
    return values.mean(0), values.var(0) / len(values)


def ball_rows(seeds: int) -> None:
    """The table of the two balls: standard deviations of the ball's place, three entries, at equal time."""
    mean, doubt = mean_and_variance(differences(BALLS["plastic"][0], "ball.to_world", min(seeds, MOST_DIFFERENCES)))
    print("Differences by the place of the ball of plastic:",
          ", ".join(f"{value:.3g} +- {error:.1g}" for value, error in zip(mean.tolist(), doubt.sqrt().tolist())))
    print("| terms | way | deviation, diffuse | plastic | ratio at equal time | seconds, diffuse | plastic | z, plastic |",
          "|---" * 8 + "|", sep="\n")
    for terms, told in ((("interior",), "interior"), (None, "all")):
        balls = {name: measured(*ball, WAYS, seeds, terms, f"{name}, {told}") for name, ball in BALLS.items()}
        for way in WAYS:
            diffuse, plastic = (each[way].samples for each in balls.values())
            places = [torch.stack([gradient[:3, 3] for gradient, in samples.gradients]) for samples in (diffuse, plastic)]
            deviations = [found.std(0) for found in places]
            seconds = [statistics.median(samples.seconds) for samples in (diffuse, plastic)]
            ratio = (deviations[1] / deviations[0] * (seconds[1] / seconds[0]) ** 0.5).tolist()
            found, error = mean_and_variance(places[1])
            z = "" if terms else " ".join(f"{each:+.1f}" for each in ((found - mean) / (doubt + error).sqrt()).tolist())
            cells = [told, way, *(" ".join(f"{each:.2g}" for each in deviation.tolist()) for deviation in deviations),
                     " ".join(f"{each:.2f}" for each in ratio), *(f"{each:.3f}" for each in seconds), z]
            print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="*", default=[*SCENES], choices=SCENES)
    parser.add_argument("--seeds", type=int, default=64)
    parser.add_argument("--balls", action="store_true", help="the ball of plastic beside the diffuse one instead")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    if options.balls:
        ball_rows(options.seeds)
    else:
        scene_rows(options.seeds, options.scenes)


if __name__ == "__main__":
    main()
