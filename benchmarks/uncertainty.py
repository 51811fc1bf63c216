"""How well deviations are predicted, and how soon Gauss-Newton is there: ``python -m benchmarks.uncertainty``.

*Calibration.* Each task is fitted to ``--refits`` targets by `rb.optim.GaussNewton`: a rendering of many samples, of a seed
of its own, with normal noise of 5 % of each pixel (and of 0.1). Printed are the standard deviations of what is found over
those that `rb.covariance` predicts, root mean square over parameters, the least and greatest of them, and the share of the
95 % intervals that hold the truth. Fits begin near the truth: what is asked is the spread, not whether they arrive.

*Speed.* ``--speed``: from a start that is off, seconds until the root mean square of the relative errors of the parameters
is at most 1.2 times what Gauss-Newton ends with, for it and for Adam with each of five learning rates, of the same
renderer and loss, by two buffers of 16 or of 64 samples per pixel. Targets have no noise but that of their samples. The
first of Adam's steps that is there counts, even where the next is not; what is not there within ``--patience`` times
Gauss-Newton's seconds is printed as more than these.

*Views.* ``--views``: in random set-ups of a ball and a floor, seen by one camera, `rb.next_view` chooses one of five more.
Each candidate is then fitted, together with the first view and with the prior, to noisy images; printed are in how many
set-ups the error of its choice, root mean square in units of the prior, is below that of the median candidate, and its rank.

Seconds are the processor's, with ``OMP_NUM_THREADS=1``, so that a busy machine changes little; what runs first, and
compiles, is not timed.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import product
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

import torch_radbp as rb

FLOOR = 0.1  # of radiance, added to what noise and errors are relative to
LEVEL = 0.05  # noise of a pixel, relative
STEPS, SPP = 5, 64  # of a refit
RATES = (0.003, 0.01, 0.03, 0.1, 0.3)  # of Adam, times the size of each parameter
EYE = [0.0, 0.0, 4.0]


class Task(NamedTuple):
    """Images by parameters, which stand at the truth."""

    images: Callable[[int, int | None], Tensor]
    parameters: dict[str, Tensor]
    scene: rb.Scene
    start: Callable[[Tensor, torch.Generator], Tensor]  # where a search begins, of the truth
    unit: Callable[[Tensor], Tensor] = torch.abs  # what errors are relative to, of the truth


class Rigid(nn.Module):
    """Motions of a pose by u, (2, 3): radians about the world's axes, and a translation."""

    def __init__(self, base: Tensor):
        super().__init__()
        self.base = base

    def forward(self, u: Tensor) -> Tensor:
        return rb.se3(u[0], u[1]) @ self.base

    def right_inverse(self, pose: Tensor) -> Tensor:
        return pose.new_zeros(2, 3)


def rgb(*value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(value)}


def camera(size: int = 16, eye=EYE) -> dict[str, Any]:
    pose = rb.look_at(eye, [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]).numpy()
    return {"type": "perspective", "fov": 40, "to_world": pose, "film": {
        "type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}}


def lit(subject: dict[str, Any], sensors: dict[str, Any] | None = None, **objects: Any) -> rb.Scene:
    """A ball or a wall before a floor of grey, under a lamp and an even sky."""
    return rb.load_dict({"type": "scene", **(sensors or {"sensor": camera()}), "subject": subject,
                         "sky": {"type": "constant", "radiance": rgb(0.3, 0.4, 0.5)},
                         "lamp": {"type": "point", "position": [2, 3, 4], "intensity": rgb(40, 38, 35)}} | objects)


def near(share: float) -> Callable[[Tensor, torch.Generator], Tensor]:
    """A start that is off by up to a share of each value."""
    return lambda truth, generator: truth * (1 + share * (2 * torch.rand(len(truth), generator=generator,
                                                                          dtype=truth.dtype) - 1))


def rendered(scene: rb.Scene, names: list[str], depth: int = 4, share: float = 0.4) -> Task:
    renderer = rb.Renderer(scene, max_depth=depth)
    return Task(lambda seed, spp: renderer(seed=seed, spp=spp), {name: scene.get_parameter(name) for name in names}, scene,
                near(share))


def cornell() -> rb.Scene:
    return rb.load(rb.asset("cornell_box/scene.xml"), resolution=16)


REFLECTANCES = [f"{name}.reflectance.value" for name in ("white", "green", "red")]
LAMP = "light.emitter.radiance.value"


def roughness() -> Task:
    ball = {"type": "sphere", "bsdf": {"type": "roughconductor", "alpha": 0.3, "specular_reflectance": rgb(0.8, 0.6, 0.4)}}
    return rendered(lit(ball), ["subject.bsdf.alpha.value", "subject.bsdf.specular_reflectance.value"])


def index() -> Task:
    ball = {"type": "sphere", "bsdf": {"type": "dielectric", "int_ior": 1.5}}
    floor = {"type": "rectangle", "to_world": rb.look_at([0.0, 0, -3], [0.0, 0, 0], [0.0, 1, 0]).numpy() @ _scaled(6),
             "bsdf": {"type": "diffuse", "reflectance": {"type": "checkerboard", "color0": rgb(0.1, 0.2, 0.3),
                                                         "color1": rgb(0.8, 0.7, 0.6)}}}
    return rendered(lit(ball, floor=floor), ["subject.bsdf.eta"], 6, 0.03)


def _scaled(factor: float):
    return torch.diag(torch.tensor([factor, factor, factor, 1.0])).numpy()


def pose() -> Task:
    scene = lit({"type": "cube", "to_world": _scaled(0.7), "bsdf": {"type": "diffuse", "reflectance": rgb(0.7, 0.5, 0.3)}})
    parametrize.register_parametrization(scene.subject, "to_world", Rigid(scene.subject.to_world.detach().clone()))
    renderer, motion = rb.Renderer(scene, max_depth=2), scene.subject.parametrizations.to_world.original
    with torch.no_grad():
        motion[0] += torch.tensor([0.4, 0.5, 0.1])  # corners of a cube that is seen head on are degenerate
    return Task(lambda seed, spp: renderer(seed=seed, spp=spp), {"motion": motion}, scene, lambda truth, generator:
                truth + 0.1 * (torch.rand(6, generator=generator, dtype=truth.dtype) - 0.5), torch.ones_like)


def texture(height: int = 14, width: int = 14) -> Task:
    """Of one channel, 196 texels, in a view of 24 x 24 pixels."""
    texels = 0.2 + 0.6 * torch.rand(height, width, 1, generator=torch.Generator().manual_seed(1))
    wall = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {
        "type": "bitmap", "data": texels.numpy(), "raw": True}}}
    return rendered(lit(wall, {"sensor": camera(24, [0.0, 0.0, 2.8])}), ["subject.bsdf.reflectance.data"], 2)


def environment() -> Task:
    """Of 4 x 8 texels, which a rough ball of metal shows to two cameras."""
    sky = 0.3 + torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(2))
    ball = {"type": "sphere", "bsdf": {"type": "roughconductor", "alpha": 0.15}}
    scene = rb.load_dict({"type": "scene", "sensor": camera(), "other": camera(16, [0.0, 1.0, -4.0]), "subject": ball,
                          "sky": {"type": "envmap", "bitmap": sky.numpy()}})
    return rendered(scene, ["sky.data"], 3)


def exposure() -> Task:
    """The colour of a ball and the gains of the second and third of three views."""
    sensors = {f"view{number}": camera(12, [3 * math.sin(angle), 1.0, 3 * math.cos(angle)])
               for number, angle in enumerate((0.0, 1.0, 2.0))}
    scene = lit({"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": rgb(0.7, 0.5, 0.3)}}, sensors)
    gains = rb.Exposure(3, fixed=0, white_balance=False, gains=torch.tensor([1.0, 1.6, 0.7]))
    renderer = rb.Renderer(scene, max_depth=2)
    return Task(lambda seed, spp: gains(renderer(seed=seed, spp=spp), torch.arange(3)),
                {"colour": scene.get_parameter("subject.bsdf.reflectance.value"), "log_gain": gains.log_gain}, scene,
                lambda truth, generator: near(0.4)(truth, generator) * torch.tensor([1, 1, 1, 0, 1, 1], dtype=truth.dtype),
                lambda truth: truth.abs().clamp_min(0.1))


TASKS: dict[str, Callable[[], Task]] = {
    "colours": lambda: rendered(cornell(), REFLECTANCES[1:]),
    "roughness": roughness,
    "lamp": lambda: rendered(cornell(), [LAMP]),
    "pose": pose,
    "index": index,
    "exposure": exposure,
    "Cornell box": lambda: rendered(cornell(), [*REFLECTANCES, LAMP], share=0.25),
    "environment": environment,
    "texture": texture,
}


def position(task: Task) -> Tensor:
    """The values of all parameters, (n,) float64."""
    return torch.cat([parameter.detach().reshape(-1).double() for parameter in task.parameters.values()])


def move(task: Task, values: Tensor) -> None:
    parts = values.split([parameter.numel() for parameter in task.parameters.values()])
    with torch.no_grad():
        for parameter, part in zip(task.parameters.values(), parts, strict=True):
            parameter.copy_(part.view(parameter.shape))


class Calibration(NamedTuple):
    """Deviations of refits over predicted ones, of each parameter, and the share of intervals that hold the truth."""

    ratios: Tensor
    coverage: float
    flat: int
    seconds: float


def calibrated(task: Task, refits: int) -> Calibration:
    """Fits a task to many noisy targets."""
    began, truth = time.perf_counter(), position(task)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        exact = task.images(10 ** 6, 4096)
    noise = LEVEL * (exact + FLOOR)
    predicted = rb.covariance(task.images, exact, task.parameters, noise=noise, spp=256, repeats=4, seed=10 ** 5)
    deviation = predicted.matrix.diag().sqrt()
    found = []
    for refit in range(refits):
        target = exact + noise * torch.randn(exact.shape, generator=generator)
        move(task, truth + (task.start(truth, generator) - truth) / 4)
        optimizer = rb.optim.GaussNewton(task.parameters.values(), task.scene, spp=SPP, max_spp=4 * SPP, seed=1000 * refit)
        for _ in range(STEPS):
            optimizer.step(lambda seed, spp, target=target: (task.images(seed, spp) - target) / noise)
        found.append(position(task))
    move(task, truth)
    told = deviation.isfinite()
    all_found = torch.stack(found)[:, told]
    inside = ((all_found - truth[told]).abs() <= 1.96 * deviation[told]).double().mean()
    return Calibration(all_found.std(0) / deviation[told], float(inside), int((~told).sum()), time.perf_counter() - began)


class Race(NamedTuple):
    """Seconds to an error, and the error; Adam's, by its best learning rate, may be infinite."""

    error: float
    gauss_newton: float
    adam: float
    rate: float
    patience: float


def raced(task: Task, patience: float) -> Race:
    """Seconds of Gauss-Newton and Adam from one start to the same error."""
    truth, generator = position(task), torch.Generator().manual_seed(3)
    with torch.no_grad():
        target = task.images(10 ** 6, 16384)
    scale, start, unit = target + FLOOR, task.start(truth, generator), task.unit(truth)

    def error() -> float:
        off = (position(task) - truth) / unit.clamp_min(1e-12)
        return float(off[unit > 0].square().mean().sqrt())

    def residuals(seed: int, spp: int | None) -> Tensor:
        return (task.images(seed, spp) - target) / scale

    def newton() -> list[tuple[float, float]]:
        move(task, start)
        optimizer = rb.optim.GaussNewton(task.parameters.values(), task.scene, spp=64, max_spp=1024)
        return timed(lambda number: optimizer.step(residuals), error, 12, math.inf)

    newton()
    course = newton()
    level = 1.2 * course[-1][1]
    seconds = next(at for at, off in course if off <= level)
    limit, best, rate = patience * seconds, math.inf, math.nan
    for parameter in task.parameters.values():
        parameter.requires_grad_()
    for spp in (16, 64):
        residuals(10 ** 5, spp).square().mean().backward()  # compiles
    for each, spp in product(RATES, (16, 64)):
        move(task, start)
        adam = rb.optim.bounded(torch.optim.Adam([
            {"params": [parameter], "lr": each * float(parameter.detach().abs().mean().clamp_min(0.1))}
            for parameter in task.parameters.values()]), task.scene)

        def step(number: int, adam: torch.optim.Adam = adam, spp: int = spp) -> None:
            adam.zero_grad()
            a, b = (residuals(2 * number + k, spp) for k in (0, 1))
            (a * b).mean().backward()
            adam.step()

        at = next((at for at, off in timed(step, error, 10 ** 6, min(limit, best), level) if off <= level), math.inf)
        if at < best:
            best, rate = at, each
    move(task, truth)
    return Race(level, seconds, best, rate, limit)


def timed(step: Callable[[int], Any], error: Callable[[], float], steps: int, limit: float, level: float = 0.0
          ) -> list[tuple[float, float]]:
    """Seconds of the processor after each step, and the error there, until one is reached; the error is not timed."""
    spent, course = 0.0, []
    for number in range(steps):
        began = time.process_time()
        step(number)
        spent += time.process_time() - began
        course.append((spent, error()))
        if spent > limit or course[-1][1] <= level:
            break
    return course


def views_of(number: int, refits: int) -> list[float]:
    """Root mean square errors of fits with each of five candidates, in their order by `next_view`."""
    generator = torch.Generator().manual_seed(number)

    def uniform(low: float, high: float, count: int = 1) -> list[float]:
        return (low + (high - low) * torch.rand(count, generator=generator)).tolist()

    def eye() -> list[float]:
        angle, height = uniform(0, 2 * math.pi)[0], uniform(-0.2, 2.5)[0]
        return [3.5 * math.cos(angle), height, 3.5 * math.sin(angle)]

    cameras = {name: camera(8, eye()) for name in ("taken", "a", "b", "c", "d", "e")}
    ground = rb.look_at([0.0, -1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]).numpy() @ _scaled(5)
    scene = rb.load_dict({
        "type": "scene", **cameras, "sky": {"type": "constant", "radiance": rgb(0.05, 0.05, 0.05)},
        "subject": {"type": "sphere", "bsdf": {"type": "roughconductor", "alpha": uniform(0.15, 0.5)[0],
                                               "specular_reflectance": rgb(*uniform(0.3, 0.9, 3))}},
        "floor": {"type": "rectangle", "to_world": ground,
                  "bsdf": {"type": "diffuse", "reflectance": rgb(*uniform(0.2, 0.8, 3))}},
        "lamp": {"type": "point", "position": [eye()[0], 3.0, eye()[2]], "intensity": rgb(30, 30, 30)}})
    names = ["subject.bsdf.alpha.value", "subject.bsdf.specular_reflectance.value", "floor.bsdf.reflectance.value"]
    renderer, candidates, noise, prior = rb.Renderer(scene, max_depth=3), list(cameras)[1:], 0.1, 0.1
    found = rb.next_view(renderer, candidates, names, noise=noise, prior=dict.fromkeys(names, prior), taken=["taken"],
                         spp=128)
    task = Task(lambda seed, spp: renderer(seed=seed, spp=spp), {name: scene.get_parameter(name) for name in names}, scene,
                near(0.0))
    truth, errors = position(task), []
    for view in found.ranking:
        sensors, off = ["taken", view.name], []
        with torch.no_grad():
            exact = renderer(seed=10 ** 6, spp=4096, sensors=sensors)
        draws = torch.Generator().manual_seed(1)
        for refit in range(refits):
            believed = (truth + prior * torch.randn(len(truth), generator=draws)).clamp(0.05, 0.95)
            target = exact + noise * torch.randn(exact.shape, generator=draws)
            move(task, believed)

            def residuals(seed: int, spp: int | None, target: Tensor = target, believed: Tensor = believed,
                          sensors: list[str] = sensors) -> list[Tensor]:
                now = torch.cat([parameter.reshape(-1) for parameter in task.parameters.values()])
                return [(renderer(seed=seed, spp=spp, sensors=sensors) - target) / noise, (now - believed.to(now)) / prior]

            optimizer = rb.optim.GaussNewton(task.parameters.values(), scene, spp=64, max_spp=64, seed=1000 * refit)
            for _ in range(3):
                optimizer.step(residuals)
            off.append((position(task) - truth) / prior)
        errors.append(float(torch.stack(off).square().mean().sqrt()))
        move(task, truth)
    return errors


@contextmanager
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def main() -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("tasks", nargs="*", default=[], help=f"of {', '.join(TASKS)}; none: all")
    parser.add_argument("--refits", type=int, default=100)
    parser.add_argument("--speed", action="store_true", help="beside Adam, instead of the calibration")
    parser.add_argument("--views", type=int, default=0, metavar="N", help="instead, the next view in N random set-ups")
    parser.add_argument("--patience", type=float, default=10.0)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    with one_thread():
        won = 0
        for number in range(given.views):
            errors = views_of(number, given.refits)
            chosen, median = errors[0], sorted(errors)[2]
            won += chosen < median
            print(f"set-up {number}: {chosen:.3f} of the prior by the view that is chosen, rank "
                  f"{1 + sorted(errors).index(chosen)}, {median:.3f} by the median one; better in {won} of {number + 1}",
                  flush=True)
        for name in [] if given.views else given.tasks or TASKS:
            task = TASKS[name]()
            size = sum(parameter.numel() for parameter in task.parameters.values())
            if given.speed:
                race = raced(task, given.patience)
                adam = f"{race.adam:7.2f} s, rate {race.rate}" if race.adam < math.inf else f"> {race.patience:5.2f} s"
                share = race.gauss_newton / min(race.adam, race.patience)
                print(f"{name:12} {size:4} parameters, error {100 * race.error:6.2f} %: Gauss-Newton "
                      f"{race.gauss_newton:6.2f} s, Adam {adam}; over Adam {share:.3f}", flush=True)
                continue
            found = calibrated(task, given.refits)
            least, greatest, typical = found.ratios.min(), found.ratios.max(), found.ratios.square().mean().sqrt()
            print(f"{name:12} {size:4} parameters, {found.flat} not told: deviations of {given.refits} refits over "
                  f"predicted {float(typical):.2f} ({float(least):.2f} to {float(greatest):.2f}), coverage "
                  f"{100 * found.coverage:.1f} %, {found.seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main()
