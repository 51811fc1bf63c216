"""The loop of a task with either renderer, as a newcomer writes it."""

from __future__ import annotations

import time

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.headline.task import Task
from benchmarks.scenes.description import NO_ROULETTE


def first_seed(task: Task, run: int) -> int:
    """The seed of the first rendering of a run; not 0, for which Mitsuba compiles other kernels."""
    return 1 + run * task.steps


class OurLoop:
    """The loop with this renderer.

    Args:
        task: what is to be recovered.
        targets: (views, H, W, 3) linear RGB.
        seed: of the whole run.
    """

    def __init__(self, task: Task, targets: np.ndarray, seed: int):
        scene = task.load()
        self.variables = {unknown.name: unknown.ours(scene) for unknown in task.unknowns}
        self.renderer, self.seed = task.renderer(scene), first_seed(task, seed)
        self.targets = torch.from_numpy(targets).permute(0, 3, 1, 2).contiguous()

    def step(self, number: int) -> float:
        """One step; the seconds that it took."""
        start = time.perf_counter()
        for variable in self.variables.values():
            variable.optimizer.zero_grad()
        images = self.renderer(seed=self.seed + number)
        (images - self.targets).square().mean().backward()
        for variable in self.variables.values():
            variable.optimizer.step()
            variable.clamp()
        return time.perf_counter() - start

    def found(self) -> dict[str, np.ndarray]:
        """What has been found so far."""
        return {name: variable.found() for name, variable in self.variables.items()}


class OurGaussNewton(OurLoop):
    """The loop with this renderer by Gauss-Newton, which chooses its samples itself, from those of the task on.

    Args: as for `OurLoop`.
    """

    def __init__(self, task: Task, targets: np.ndarray, seed: int):
        super().__init__(task, targets, seed)
        leaves = [leaf for variable in self.variables.values() for group in variable.optimizer.param_groups
                  for leaf in group["params"]]
        self.size = sum(leaf.numel() for leaf in leaves)
        self.optimizer = rb.optim.GaussNewton(leaves, self.renderer.scene, spp=task.setting.spp, seed=self.seed)

    def step(self, number: int) -> float:
        """One step; the seconds that it took."""
        start = time.perf_counter()
        self.optimizer.step(lambda seed, spp: self.renderer(seed=seed, spp=spp) - self.targets)
        for variable in self.variables.values():
            variable.clamp()
        return time.perf_counter() - start


class MitsubaLoop:
    """The loop with Mitsuba: as its tutorials have it, each view is rendered and differentiated by itself before a step.

    Args:
        task, targets, seed: as for `OurLoop`.
        integrator: the name of one of the task's.
        mi: the module, in its variant.
    """

    def __init__(self, task: Task, integrator: str, mi, targets: np.ndarray, seed: int):
        import drjit as dr

        self.mi, self.dr, self.views = mi, dr, task.views
        self.scene = task.load_in_mitsuba(mi, task.scene)
        self.parameters = mi.traverse(self.scene)
        self.variables = {unknown.name: unknown.mitsubas(mi, self.parameters) for unknown in task.unknowns}
        _, self.spp, max_depth = task.setting
        self.integrator = mi.load_dict(task.integrators[integrator] | {"max_depth": max_depth, "rr_depth": NO_ROULETTE})
        self.targets, self.seed = [mi.TensorXf(target) for target in targets], first_seed(task, seed)
        dr.eval(self.targets)

    def step(self, number: int) -> float:
        """One step; the seconds that it took."""
        dr = self.dr
        dr.sync_thread()
        start = time.perf_counter()
        for view, target in enumerate(self.targets):
            for variable in self.variables.values():
                variable.apply()
            self.parameters.update()
            image = self.mi.render(self.scene, self.parameters, sensor=view, integrator=self.integrator, spp=self.spp,
                                   seed=(self.seed + number) * self.views + view)
            dr.backward(dr.mean(dr.square(image - target), axis=None) / self.views)
        for variable in self.variables.values():
            variable.optimizer.step()
            variable.clamp()
            dr.eval([variable.optimizer[key] for key in variable.optimizer.keys()])
        dr.sync_thread()
        return time.perf_counter() - start

    def found(self) -> dict[str, np.ndarray]:
        """What has been found so far."""
        return {name: variable.found() for name, variable in self.variables.items()}
