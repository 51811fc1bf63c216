"""How much the view that `rb.next_view` chooses is worth, beside the other candidates, by refits with each."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

import torch_radbp as rb
from benchmarks.uncertainty.tasks import Task, camera, near, rgb, scaled

SPP, STEPS = 256, 3  # of a refit


def views_of(number: int, refits: int) -> list[float]:
    """Root mean square errors of fits with each of five candidates, in their order by `next_view`."""
    generator = torch.Generator().manual_seed(number)

    def uniform(low: float, high: float, count: int = 1) -> list[float]:
        return (low + (high - low) * torch.rand(count, generator=generator)).tolist()

    def place(distance: float) -> list[float]:
        angle, height = uniform(0, 2 * math.pi)[0], uniform(-0.2, 2.5)[0]
        return [distance * math.cos(angle), height, distance * math.sin(angle)]

    def view() -> dict[str, Any]:
        """From near or far, at the ball or past it."""
        return camera(8, place(uniform(2.5, 8)[0]), [*uniform(-1.5, 1.5), -0.5, *uniform(-1.5, 1.5)])

    cameras = {name: view() for name in ("taken", "a", "b", "c", "d", "e")}
    ground = rb.look_at([0.0, -1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]).numpy() @ scaled(5)
    scene = rb.load_dict({
        "type": "scene", **cameras, "sky": {"type": "constant", "radiance": rgb(0.05, 0.05, 0.05)},
        "subject": {"type": "sphere", "bsdf": {"type": "roughconductor", "alpha": uniform(0.15, 0.5)[0],
                                               "specular_reflectance": rgb(*uniform(0.3, 0.9, 3))}},
        "floor": {"type": "rectangle", "to_world": ground,
                  "bsdf": {"type": "diffuse", "reflectance": rgb(*uniform(0.2, 0.8, 3))}},
        "lamp": {"type": "point", "position": [*uniform(-3, 3), 3.0, *uniform(-3, 3)], "intensity": rgb(30, 30, 30)}})
    names = ["subject.bsdf.alpha.value", "subject.bsdf.specular_reflectance.value", "floor.bsdf.reflectance.value"]
    renderer, candidates, noise, prior = rb.Renderer(scene, max_depth=3), list(cameras)[1:], 0.05, 0.05
    found = rb.next_view(renderer, candidates, names, noise=noise, prior=dict.fromkeys(names, prior), taken=["taken"],
                         spp=SPP)
    task = Task(lambda seed, spp: renderer(seed=seed, spp=spp), {name: scene.get_parameter(name) for name in names}, scene,
                near(0.0))
    truth, errors = task.position(), []
    for view in found.ranking:
        sensors, off = ["taken", view.name], []
        with torch.no_grad():
            exact = renderer(seed=10 ** 6, spp=4096, sensors=sensors)
        draws = torch.Generator().manual_seed(1)
        for refit in range(refits):
            believed = (truth + prior * torch.randn(len(truth), generator=draws)).clamp(0.05, 0.95)
            target = exact + noise * torch.randn(exact.shape, generator=draws)
            task.move(believed)

            def residuals(seed: int, spp: int | None, target: Tensor = target, believed: Tensor = believed,
                          sensors: list[str] = sensors) -> list[Tensor]:
                now = torch.cat([parameter.reshape(-1) for parameter in task.parameters.values()])
                return [(renderer(seed=seed, spp=spp, sensors=sensors) - target) / noise, (now - believed.to(now)) / prior]

            optimizer = rb.optim.GaussNewton(task.parameters.values(), scene, spp=SPP, max_spp=SPP, seed=1000 * refit)
            for _ in range(STEPS):
                optimizer.step(residuals)
            off.append((task.position() - truth) / prior)
        errors.append(float(torch.stack(off).square().mean().sqrt()))
        task.move(truth)
    return errors
