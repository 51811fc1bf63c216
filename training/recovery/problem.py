"""`Recovery`: an inverse-rendering problem, checked, and the state of its solution."""

import warnings

import torch
from torch import Tensor

import torch_radbp as rb
from torch_radbp.formats.files import opened_files
from torch_radbp.tensors.differentiated import differentiable
from torch_radbp.training import recipe as schema
from torch_radbp.training.device import usable_device
from torch_radbp.training.ranks import ALONE, Ranks
from torch_radbp.training.recipe_optimizer import GaussNewton
from torch_radbp.training.recovery.continuation import Expected, recipe_fields
from torch_radbp.training.recovery.gains import recovered_gains
from torch_radbp.training.recovery.gauss_newton import JointSteps
from torch_radbp.training.recovery.levels import Level, Levels
from torch_radbp.training.recovery.losses import Objective
from torch_radbp.training.recovery.optimizers import expected_moments, make_optimizers, moments_of, put_moments
from torch_radbp.training.recovery.parameters import choose_parameters
from torch_radbp.training.recovery.plan import Plan
from torch_radbp.training.recovery.priors import Priors
from torch_radbp.training.recovery.recovered import RecoveredParameter
from torch_radbp.training.recovery.renderers import make_renderer
from torch_radbp.training.recovery.sources import digests
from torch_radbp.training.recovery.targets import read_targets, sensor_films


class Recovery:
    """An inverse-rendering problem and the state of its solution. Building it checks everything and writes nothing.

    Args:
        recipe: a checked recipe.
        ranks: the processes that solve it together.
        allow_outside: of a glTF scene, also read files outside of its folder.

    Raises:
        ValueError: the scene, the parameters or the targets do not fit the recipe, or this machine lacks its device.
    """

    def __init__(self, recipe: schema.Recipe, ranks: Ranks = ALONE, allow_outside: bool = False):
        self.recipe, self.ranks = recipe, ranks
        device = usable_device(recipe.render.device)
        with opened_files() as files:
            self.scene = rb.load(recipe.scene, allow_outside=allow_outside, **recipe.variables).to(device)
            self.targets = read_targets(recipe.targets, sensor_films(self.scene)).to(device)
            self.parameters = choose_parameters(self.scene, recipe.parameters)
        self.sources = digests(files, recipe.scene.parent)
        self.renderer = make_renderer(self.scene, recipe.render)
        # The renderer checks parameters and caster when it first renders: make it do so now, before files are written.
        call = self.renderer.prepare(seed=0, sensors=self.targets.sensors, spp=1, seed_grad=None)
        check_influence(self.parameters, differentiable((call.scene, [view.camera for view in call.views])))
        self.exposure = None
        if recipe.gains is not None:
            gains = recovered_gains(recipe.gains, self.targets.names, self.targets.images)
            self.parameters.append(gains)
            self.exposure = gains.module
        self.plan = Plan(recipe, self.parameters, len(self.targets.images))
        self.levels = Levels(self.scene, self.targets, self.plan.scales(), self.parameters)
        self.objective, self.priors = Objective(recipe.loss), Priors(recipe.priors, self.parameters)
        for level in self.levels.levels.values():
            check_losses(self.objective, level)
        self.joint = JointSteps(self) if isinstance(recipe.optimizer, GaussNewton) else None
        self.optimizers = {} if self.joint else make_optimizers(self.parameters, recipe)
        self.step = 0
        self.skipped = 0
        self.seconds = 0.0

    def state_dict(self) -> dict:
        """Returns what the next step depends on beside the recipe, and what it was reached with."""
        return {
            "step": self.step,
            "skipped": self.skipped,
            "seconds": self.seconds,
            "processes": self.ranks.count,
            "recipe": recipe_fields(self.recipe),
            "sources": self.sources,
            "parameters": {name: value for each in self.parameters for name, value in each.held.items()},
            "moments": {name: moments for name, optimizer in self.optimizers.items() if (moments := moments_of(optimizer))},
            "joint": self.joint.state() if self.joint else None,
        }

    def load_state_dict(self, state: dict) -> None:
        """Continues from a state, on whatever device it was reached."""
        self.step, self.skipped, self.seconds = state["step"], state["skipped"], state["seconds"]
        if state["processes"] != self.ranks.count:
            warnings.warn(f"the run had {state['processes']} processes so far and has {self.ranks.count} now: it goes on "
                          "with other random numbers", stacklevel=2)
        for each in self.parameters:
            each.load(state["parameters"], self.step)
        for name, optimizer in self.optimizers.items():
            put_moments(optimizer, state["moments"].get(name, {}))
        if self.joint:
            self.joint.load(state["joint"])

    def expected(self, step: int) -> dict[str, Expected]:
        """What the tensors of a checkpoint are after so many steps, by name."""
        found = {}
        for each in self.parameters:
            moved = self.plan.moves(each, each.refined_at(step), step)
            for name, like in each.held_at(step).items():
                moments = expected_moments(self.optimizers[name], like) if name in self.optimizers else {}
                found[name] = Expected(like, moments, each.bounds_of_leaf, moved)
        return found

    def begin(self, step: int) -> list[RecoveredParameter]:
        """Gives all leaves the learning rates of a step, and returns what it moves, which alone has gradients."""
        moving = self.plan.moving(step)
        for each in self.parameters:
            for name, leaf in each.leaves.items():
                leaf.grad = None
                leaf.requires_grad_(each in moving)
                if name in self.optimizers:
                    self.optimizers[name].param_groups[0]["lr"] = self.plan.learning_rate(each, step)
        return moving

    def end(self, step: int) -> None:
        """Goes on to the next step: grids become as fine as they are after so many steps."""
        self.step = step + 1
        for each in self.parameters:
            each.refine_to(self.step, self.optimizers.get(each.name))

    def exposed(self, images: Tensor, views: list[int]) -> Tensor:
        """Renderings (B, 3, H, W) as the photographs of these targets show them, attached."""
        return images if self.exposure is None else self.exposure(images, torch.tensor(views, device=images.device))


def check_influence(parameters: list[RecoveredParameter], leaves: list[Tensor]) -> None:
    """Raises ValueError naming the first parameter that no rendering reads.

    Args:
        parameters: to be recovered.
        leaves: everything that a rendering reads and that is to be differentiated, attached.
    """
    raw = [each.raw for each in parameters]
    sums = [leaf.sum() for leaf in leaves]
    read = torch.autograd.grad(sums, raw, allow_unused=True) if sums else [None] * len(raw)
    for each, gradient in zip(parameters, read):
        if gradient is None:
            hint = "; texture coordinates are read where a material or an emitter has a bitmap" * ("texcoords" in each.name)
            raise ValueError(f"parameter {each.name!r} cannot be recovered: no sensor with a target sees what it changes"
                             f"{hint}")


def check_losses(objective: Objective, level: Level) -> None:
    """Raises ValueError if the losses cannot be computed on images of this size, which a window may exceed."""
    targets = level.images
    try:
        with torch.no_grad():
            objective((targets, targets), targets, level.masks)
    except (RuntimeError, ValueError) as error:
        names = ", ".join(spec.name for spec in objective.specs)
        raise ValueError(f"loss: {names} cannot be computed on targets of {targets.shape[3]} x {targets.shape[2]} pixels; "
                         f"take a smaller window, or larger images ({str(error).splitlines()[0]})") from None
