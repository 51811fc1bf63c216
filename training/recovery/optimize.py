"""The training loop of `radbp optimize`.

Seeds are functions of the recipe's seed and the step, the random numbers functions of the seed, and so is what a step
renders and moves (`plan`). With parameters and moments saved, a resumed run therefore computes bit for bit what the
uninterrupted run would have (on a CPU; on a GPU only under `torch.use_deterministic_algorithms`).
"""

import contextlib
import time
import warnings
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.training.interrupt import Interrupts
from torch_radbp.training.recovery.checkpoint import save_checkpoint
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.recovery.run_folder import RunFolder
from torch_radbp.training.recovery.schedule import learning_rate_factor

# Steps in a row without a usable gradient after which a run gives up.
MAX_SKIPPED_IN_A_ROW = 10


def step_seed(seed: int, step: int, stream: int) -> int:
    """Returns the render seed of one of a step's two buffers, in [0, 2^31)."""
    return (seed * 0x9E3779B1 + 2 * step + stream) % 2**31


class Shown(NamedTuple):
    """What one process renders in a step, and what it compares that with.

    Attributes:
        views: numbers of the targets.
        weight: of its gradient; those of all processes sum to 1.
        turn: the number of its random numbers.
        images: (B, 3, H, W), linear RGB.
        masks: (B, 1, H, W); None: all pixels count the same.
    """

    views: list[int]
    weight: float
    turn: int
    images: Tensor
    masks: Tensor | None


def shown_in(recovery: Recovery, step: int) -> Shown:
    """This process's share of a step; the scene has cameras of the step's size from then on."""
    views = recovery.plan.views(step)
    share, level = recovery.ranks.share(len(views)), recovery.levels.place(recovery.plan.scale(step))
    own = [views[each] for each in share.views]
    return Shown(own, share.weight, step * share.count + share.number, level.images[own],
                 None if level.masks is None else level.masks[own])


def render_buffers(recovery: Recovery, step: int) -> tuple[Tensor, Tensor]:
    """Returns the independent renderings of this process's share of a step, each (B, 3, H, W), exposed as photographs."""
    shown = shown_in(recovery, step)
    sensors = [recovery.targets.sensors[view] for view in shown.views]
    spp = recovery.objective.spp_of_buffer(recovery.plan.spp(step))
    seeds = (step_seed(recovery.recipe.render.seed, shown.turn, buffer) for buffer in (0, 1))
    one, other = (recovery.exposed(recovery.renderer(seed=seed, sensors=sensors, spp=spp), shown.views) for seed in seeds)
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
    recipe = recovery.recipe
    skipped_in_a_row = 0
    for step in range(recovery.step, recipe.steps):
        interrupts.check()
        started = time.perf_counter()
        moving = recovery.begin(step)
        # A joint step moves parameters while it renders: it looks after signals itself.
        with interrupts.held() if recovery.joint else contextlib.nullcontext():
            if recovery.joint:
                loss, terms, trouble = recovery.joint.take(lambda: interrupts.pending)
                stopped, times = False, recovery.joint.columns()
            else:
                loss, terms, rendered, trouble = take_gradient(recovery, step)
                loss, terms, trouble, stopped = together(recovery, step, loss, terms, trouble, interrupts.pending)
                times = {"forward_seconds": rendered - started, "backward_seconds": time.perf_counter() - rendered}

            usable = trouble is None
            with interrupts.held():
                row = {"step": step, "loss": loss.item()} | {f"loss.{name}": term.item() for name, term in terms.items()}
                row["learning_rate_factor"] = learning_rate_factor(recipe.schedule, step, recipe.steps)
                if usable:
                    for parameter in moving:
                        for name in parameter.leaves:
                            if name in recovery.optimizers:
                                recovery.optimizers[name].step()
                        parameter.project_()
                else:
                    recovery.skipped += 1
                recovery.end(step)
                recovery.seconds += time.perf_counter() - started
                row |= {"skipped": recovery.skipped, **times, "seconds": recovery.seconds}
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


def take_gradient(recovery: Recovery, step: int) -> tuple[Tensor, dict[str, Tensor], float, str | None]:
    """Renders, and leaves the gradient in the parameters that the step moves.

    Returns:
        the loss and its terms, NaN where there is no image; when the image was there; what is not finite, or None.
    """
    shown = shown_in(recovery, step)
    try:
        buffers = render_buffers(recovery, step)
    except FloatingPointError as error:
        missing = shown.images.new_tensor(float("nan"))
        terms = dict.fromkeys([*recovery.objective.names, *recovery.priors.names], missing)
        return missing, terms, time.perf_counter(), str(error)
    loss, terms = recovery.objective(buffers, shown.images, shown.masks)
    likely, prior_terms = recovery.priors()
    loss, terms = loss + likely, terms | prior_terms
    rendered = time.perf_counter()
    if not loss.isfinite():
        return loss, terms, rendered, "the loss is not finite"
    try:
        loss.backward()
    except FloatingPointError as error:
        return loss, terms, rendered, str(error)
    leaves = moving_leaves(recovery, step)
    for leaf in leaves.values():
        if leaf.grad is None:  # the optimiser would leave it out, and count its steps apart
            leaf.grad = torch.zeros_like(leaf)
    bad = [name for name, leaf in leaves.items() if not leaf.grad.isfinite().all()]
    return loss, terms, rendered, f"the gradient of {', '.join(bad)} is not finite" if bad else None


def moving_leaves(recovery: Recovery, step: int) -> dict[str, Tensor]:
    """The leaves that a step moves, by name."""
    return {name: leaf for each in recovery.plan.moving(step) for name, leaf in each.leaves.items()}


def together(recovery: Recovery, step: int, loss: Tensor, terms: dict[str, Tensor], trouble: str | None, pending: bool
             ) -> tuple[Tensor, dict[str, Tensor], str | None, bool]:
    """Puts the gradient of all processes into the parameters, from the own one.

    Args:
        recovery: with the gradient of its share.
        step: the step.
        loss, terms, trouble: of it, as from `take_gradient`.
        pending: whether this process is asked to stop.

    Returns:
        the means of losses and terms over the processes; what is wrong with any of them; whether one is asked to stop.

    Raises:
        RankError: a process has ended.
    """
    ranks = recovery.ranks
    if ranks.count == 1:
        return loss, terms, trouble, False
    weight, raws = shown_in(recovery, step).weight, list(moving_leaves(recovery, step).values())
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
