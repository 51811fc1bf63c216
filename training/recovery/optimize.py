"""The training loop of `radbp optimize`.

Seeds are functions of the recipe's seed and the step, the random numbers functions of the seed. With parameters,
optimiser and scheduler saved, a resumed run therefore computes bit for bit what the uninterrupted run would have
(on a CPU; on a GPU only under `torch.use_deterministic_algorithms`).
"""

import time
import warnings
from collections.abc import Callable

import torch
from torch import Tensor

import torch_radbp as rb
from torch_radbp.formats.files import opened_files
from torch_radbp.rendering.memory import parse_budget
from torch_radbp.tensors.differentiated import differentiable
from torch_radbp.training import recipe as schema
from torch_radbp.training.device import usable_device
from torch_radbp.training.interrupt import Interrupts
from torch_radbp.training.ranks import ALONE, Ranks, on_this_machine
from torch_radbp.training.recovery.checkpoint import save_checkpoint
from torch_radbp.training.recovery.continuation import recipe_fields
from torch_radbp.training.recovery.losses import Objective
from torch_radbp.training.recovery.parameters import RecoveredParameter, choose_parameters
from torch_radbp.training.recovery.run_folder import RunFolder
from torch_radbp.training.recovery.schedule import make_scheduler
from torch_radbp.training.recovery.sources import digests
from torch_radbp.training.recovery.targets import read_targets, sensor_films

# Steps in a row without a usable gradient after which a run gives up.
MAX_SKIPPED_IN_A_ROW = 10


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
        self.share = ranks.share(len(self.targets.images))
        self.renderer = make_renderer(self.scene, recipe.render)
        # The renderer checks parameters and caster when it first renders: make it do so now, before files are written.
        call = self.renderer.prepare(seed=0, sensors=self.targets.sensors, spp=1, seed_grad=None)
        check_influence(self.parameters, differentiable((call.scene, [view.camera for view in call.views])))
        self.objective = Objective(recipe.loss)
        check_losses(self.objective, self.targets.images)
        self.optimizer = make_optimizer(self.parameters, recipe.optimizer)
        self.scheduler = make_scheduler(self.optimizer, recipe.schedule, recipe.steps)
        self.step = 0
        self.skipped = 0
        self.seconds = 0.0

    def state_dict(self) -> dict:
        """Returns what the next step depends on beside the recipe, and what it was reached with."""
        moments = self.optimizer.state_dict()["state"]
        return {
            "step": self.step,
            "skipped": self.skipped,
            "seconds": self.seconds,
            "processes": self.ranks.count,
            "recipe": recipe_fields(self.recipe),
            "sources": self.sources,
            "parameters": {each.name: each.raw.detach() for each in self.parameters},
            "moments": {self.parameters[index].name: {key: value for key, value in held.items() if value is not None}
                        for index, held in moments.items()},
        }

    def load_state_dict(self, state: dict) -> None:
        """Continues from a state, on whatever device it was reached."""
        self.step, self.skipped, self.seconds = state["step"], state["skipped"], state["seconds"]
        if state["processes"] != self.ranks.count:
            warnings.warn(f"the run had {state['processes']} processes so far and has {self.ranks.count} now: it goes on "
                          "with other random numbers", stacklevel=2)
        with torch.no_grad():
            for each in self.parameters:
                each.raw.copy_(state["parameters"][each.name])
        moments = {index: state["moments"].get(each.name, {}) for index, each in enumerate(self.parameters)}
        self.optimizer.load_state_dict(self.optimizer.state_dict() | {"state": moments})
        self.scheduler = make_scheduler(self.optimizer, self.recipe.schedule, self.recipe.steps, self.step)


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


def check_losses(objective: Objective, targets: Tensor) -> None:
    """Raises ValueError if the losses cannot be computed on images of this size, which a window may exceed."""
    try:
        with torch.no_grad():
            objective((targets, targets), targets)
    except (RuntimeError, ValueError) as error:
        names = ", ".join(spec.name for spec in objective.specs)
        raise ValueError(f"loss: {names} cannot be computed on targets of {targets.shape[3]} x {targets.shape[2]} pixels; "
                         f"take a smaller window, or larger images ({str(error).splitlines()[0]})") from None


def make_renderer(scene, spec: schema.Render) -> rb.Renderer:
    """Returns the renderer that a recipe's `[render]` describes."""
    return rb.Renderer(
        scene,
        spp=spec.spp,
        max_depth=spec.max_depth,
        rr_depth=spec.rr_depth,
        adjoint=None if spec.adjoint is None else make_adjoint(spec.adjoint),
        sampling=spec.sampling,
        chunk=spec.chunk,
        memory_budget=own_budget(spec.memory_budget, scene.device),
        compile=spec.compile,
        caster=spec.caster,
        **({} if spec.terms is None else {"terms": spec.terms}),
        share_samples=True,  # two independent buffers take each other's part
    )


def own_budget(budget: int | str | None, device: torch.device) -> int | None:
    """The bytes of a recipe's `memory_budget`, which is that of a device, that are this process's own."""
    if budget is None:
        return None
    devices = torch.cuda.device_count() if device.type == "cuda" else 1
    return parse_budget(budget) // max(1, -(-on_this_machine() // devices))


def make_adjoint(spec: schema.Adjoint):
    """Returns the strategy of a recipe's `[render] adjoint`."""
    match spec.strategy:
        case "memoized":
            return rb.MemoizedAdjoint(stride=spec.stride, keep_hits=spec.keep_hits)
        case "replay":
            return rb.ReplayAdjoint()
        case "quadratic":
            return rb.QuadraticAdjoint()
        case "tape":
            return rb.TapeAdjoint()
    raise TypeError(f"no strategy for {spec!r}")


def make_optimizer(parameters: list[RecoveredParameter], spec: schema.AnyOptimizer) -> torch.optim.Optimizer:
    """Returns the torch optimiser of a recipe's `[optimizer]`, one group per parameter."""
    groups = [{"params": [each.raw], "lr": each.spec.learning_rate or spec.learning_rate} for each in parameters]
    options = spec.model_dump(exclude={"name", "learning_rate"})
    cls = {"adam": torch.optim.Adam, "sgd": torch.optim.SGD, "rmsprop": torch.optim.RMSprop}[spec.name]
    return cls(groups, lr=spec.learning_rate, **options)


def step_seed(seed: int, step: int, stream: int) -> int:
    """Returns the render seed of one of a step's two buffers, in [0, 2^31)."""
    return (seed * 0x9E3779B1 + 2 * step + stream) % 2**31


def render_buffers(recovery: Recovery, step: int) -> tuple[Tensor, Tensor]:
    """Returns the independent renderings of this process's share of a step, each (B, 3, H, W)."""
    spec, share = recovery.recipe.render, recovery.share
    turn = step * share.count + share.number
    sensors = [recovery.targets.sensors[view] for view in share.views]
    spp = recovery.objective.spp_of_buffer(spec.spp)
    one, other = (recovery.renderer(seed=step_seed(spec.seed, turn, buffer), sensors=sensors, spp=spp) for buffer in (0, 1))
    return one, other


def train(
    recovery: Recovery, folder: RunFolder, on_step: Callable[[dict[str, float]], None], interrupts: Interrupts
) -> None:
    """Runs the steps that are left.

    Args:
        recovery: the problem, at any step.
        folder: gets a metrics row per step and a checkpoint now and then.
        on_step: called after each step with its metrics row.
        interrupts: Ctrl-C and SIGTERM.

    Raises:
        KeyboardInterrupt: a signal came; `recovery` is then whole, at the last finished step.
        RuntimeError: too many steps in a row whose gradient is not finite.
    """
    with interrupts.left_to(recovery.ranks.count > 1):
        take_steps(recovery, folder, on_step, interrupts)


def take_steps(
    recovery: Recovery, folder: RunFolder, on_step: Callable[[dict[str, float]], None], interrupts: Interrupts
) -> None:
    """As `train`; of several processes, all stop after the step in which one has received a signal."""
    recipe, targets = recovery.recipe, recovery.targets.images[recovery.share.views]
    skipped_in_a_row = 0
    for step in range(recovery.step, recipe.steps):
        interrupts.check()
        started = time.perf_counter()
        recovery.optimizer.zero_grad()
        loss, terms, rendered, trouble = take_gradient(recovery, step, targets)
        loss, terms, trouble, stopped = together(recovery, loss, terms, trouble, interrupts.pending)
        finished = time.perf_counter()

        usable = trouble is None
        with interrupts.held():
            row = {"step": step, "loss": loss.item()} | {f"loss.{name}": term.item() for name, term in terms.items()}
            row["learning_rate_factor"] = recovery.scheduler.get_last_lr()[0] / recovery.scheduler.base_lrs[0]
            if usable:
                recovery.optimizer.step()
                for parameter in recovery.parameters:
                    parameter.project_()
            else:
                recovery.skipped += 1
            recovery.scheduler.step()
            recovery.step = step + 1
            recovery.seconds += time.perf_counter() - started
            row |= {"skipped": recovery.skipped, "forward_seconds": rendered - started}
            row |= {"backward_seconds": finished - rendered, "seconds": recovery.seconds}
            for parameter in recovery.parameters:
                row |= parameter.columns(parameter.value)
            if recovery.ranks.is_first:
                folder.log(row)
            if recovery.step % recipe.report.checkpoint_every == 0 and recovery.ranks.is_first:
                save_checkpoint(folder.checkpoint, recovery.state_dict())
        on_step(row)

        if stopped:
            raise KeyboardInterrupt
        skipped_in_a_row = 0 if usable else skipped_in_a_row + 1
        if not usable:
            warnings.warn(
                f"step {step}: {trouble}; the step is skipped ({recovery.skipped} so far)",
                stacklevel=2,
            )
        if skipped_in_a_row == MAX_SKIPPED_IN_A_ROW:
            raise RuntimeError(
                f"{skipped_in_a_row} steps in a row had a loss or gradient that is not finite, the last because {trouble}; "
                "give the parameters bounds that keep them off their extremes (roughness above 0.01, say), lower the "
                "learning rate, and see whether the tone mapping of the losses is defined for every image"
            )


def take_gradient(recovery: Recovery, step: int, targets: Tensor) -> tuple[Tensor, dict[str, Tensor], float, str | None]:
    """Renders, and leaves the gradient in the parameters.

    Returns:
        the loss and its terms, NaN where there is no image; when the image was there; what is not finite, or None.
    """
    try:
        buffers = render_buffers(recovery, step)
    except FloatingPointError as error:
        missing = targets.new_tensor(float("nan"))
        return missing, {spec.name: missing for spec in recovery.objective.specs}, time.perf_counter(), str(error)
    loss, terms = recovery.objective(buffers, targets)
    rendered = time.perf_counter()
    if not loss.isfinite():
        return loss, terms, rendered, "the loss is not finite"
    try:
        loss.backward()
    except FloatingPointError as error:
        return loss, terms, rendered, str(error)
    for each in recovery.parameters:
        if each.raw.grad is None:  # the optimiser would leave it out, and count its steps apart
            each.raw.grad = torch.zeros_like(each.raw)
    bad = [each.name for each in recovery.parameters if not each.raw.grad.isfinite().all()]
    return loss, terms, rendered, f"the gradient of {', '.join(bad)} is not finite" if bad else None


def together(recovery: Recovery, loss: Tensor, terms: dict[str, Tensor], trouble: str | None, pending: bool
             ) -> tuple[Tensor, dict[str, Tensor], str | None, bool]:
    """Puts the gradient of all processes into the parameters, from the own one.

    Args:
        recovery: with the gradient of its share.
        loss, terms, trouble: of it, as from `take_gradient`.
        pending: whether this process is asked to stop.

    Returns:
        the means of losses and terms over the processes; what is wrong with any of them; whether one is asked to stop.

    Raises:
        RankError: a process has ended.
    """
    ranks, weight = recovery.ranks, recovery.share.weight
    if ranks.count == 1:
        return loss, terms, trouble, False
    raws = [each.raw for each in recovery.parameters]
    own = [torch.zeros_like(raw) if trouble else raw.grad for raw in raws]
    flags = loss.detach().new_tensor([trouble is not None, pending])
    values = torch.stack([loss.detach(), *(term.detach() for term in terms.values())])
    gradients = [gradient.double() * weight for gradient in own]
    troubled, means, *sums = ranks.sums([flags, values.double() * weight, *gradients])
    for raw, total in zip(raws, sums):
        raw.grad = total.to(raw)
    if troubled[0] and trouble is None:
        trouble = f"in {int(troubled[0])} of {ranks.count} processes the gradient is not finite"
    return means[0], dict(zip(terms, means[1:])), trouble, bool(troubled[1])
