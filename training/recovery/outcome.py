"""The results of a run: the images at its beginning and its end, recovered values, the summary."""

import math
import platform
import statistics
import sys
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torch_radbp.formats.image import read_image
from torch_radbp.losses import masked_mean
from torch_radbp.training.false_colour import absolute_error, error_scale, false_colour
from torch_radbp.training.recovery.deviations import deviations_of
from torch_radbp.training.recovery.optimize import step_seed
from torch_radbp.training.recovery.passes import Estimate, render_in_passes
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.recovery.recovered import RecoveredParameter
from torch_radbp.training.recovery.run_folder import RunFolder
from torch_radbp.training.recovery.verdict import ImageErrors, ParameterCurve, judge_run

try:
    import resource
except ImportError:  # Windows
    resource = None

# Samples of a pass, and the noise below which more of them are not seen: 1.8 of the 255 levels of a screen.
PASS_SPP, INVISIBLE = 32, 0.007


def render_for_report(recovery: Recovery, ended: Callable[[], bool]) -> Estimate:
    """Renders the targets' sensors with the current parameters and gains, until no noise is seen or the report's spp are
    reached.

    Args:
        recovery: the problem at any step.
        ended: asked after each pass; True ends the rendering with the samples so far.
    """
    recipe, views = recovery.recipe, list(range(len(recovery.targets.names)))
    recovery.levels.place(1.0)
    return render_in_passes(
        lambda **call: recovery.exposed(recovery.renderer(**call), views), recovery.targets.sensors, recipe.report.spp,
        seed=step_seed(recipe.render.seed, -1, 0),  # those of step -1: samples that no step of the optimisation has used
        passes=min(recipe.report.spp, max(2, -(-recipe.report.spp // PASS_SPP))),
        go_on=lambda estimate: not ended() and (estimate.noise is None or estimate.visible_noise > INVISIBLE),
    )  # fmt: skip


def save_before(recovery: Recovery, folder: RunFolder) -> None:
    """Writes the target and before images and textures; call it with the parameters at their initial values."""
    rendered = render_for_report(recovery, lambda: False).image
    for name, target, before in zip(recovery.targets.names, recovery.targets.images, rendered):
        folder.save_image(name, "target", target)
        folder.save_image(name, "before", before)
    for parameter in recovery.parameters:
        if parameter.is_picture:
            folder.save_texture(parameter.name, "before", parameter.picture(parameter.before))
            if parameter.truth is not None:
                folder.save_texture(parameter.name, "true", parameter.picture(parameter.truth))


def finish(recovery: Recovery, folder: RunFolder, status: str, hurried: Callable[[], bool]) -> dict[str, Any]:
    """Writes images, recovered parameters, scene and summary of the state reached; returns the summary.

    Ends parametrisations: the recovery cannot be trained further.

    Args:
        recovery: the problem at the step reached.
        folder: its run folder, with the before images.
        status: "finished" or "interrupted".
        hurried: asked while the images are rendered; True ends that with the samples so far, and
            leaves out deviations.
    """
    after = render_for_report(recovery, hurried)
    images = [_save_after(recovery, folder, index, image) for index, image in enumerate(after.image)]
    for parameter in recovery.parameters:
        if parameter.is_picture:
            folder.save_texture(parameter.name, "recovered", parameter.picture(parameter.value))
    folder.save_parameters({each.name: each.value for each in recovery.parameters})
    summary = {
        "title": recovery.recipe.title or folder.path.name,
        "description": recovery.recipe.description,
        "status": status,
        "step": recovery.step,
        "steps": recovery.recipe.steps,
        "skipped": recovery.skipped,
        "verdict": _verdict(recovery, folder, images),
        "images": images,
        "image_spp": after.spp,
        "image_noise": after.noise,
        "parameters": [_parameter_summary(each) for each in recovery.parameters],
        "cost": _cost(recovery, folder),
        "machine": {
            "python": platform.python_version(),
            "torch": torch.__version__,
            "device": str(recovery.targets.images.device),
            "threads": torch.get_num_threads(),
        },
    }
    for parameter in recovery.parameters:
        parameter.settle(recovery.scene)
    folder.save_scene(recovery.scene)
    summary["deviations"] = deviations_of(recovery, folder, hurried)
    folder.save_summary(summary)
    return summary


def _verdict(recovery: Recovery, folder: RunFolder, images: list[dict[str, Any]]) -> dict[str, Any]:
    unbiased = all(spec.name == "two_buffer_l2" for spec in recovery.recipe.loss) and not recovery.recipe.priors
    before, after = (math.sqrt(statistics.fmean(each[key] ** 2 for each in images)) for key in ("rmse_before", "rmse"))
    rows = folder.metrics.rows()
    curves = [_parameter_curve(each, rows) for each in recovery.parameters]
    rates = [row.get("learning_rate_factor", 1.0) for row in rows]
    return judge_run([row["loss"] for row in rows], unbiased, ImageErrors(before, after), curves, rates)._asdict()


def _parameter_curve(parameter: RecoveredParameter, rows: list[dict[str, float]]) -> ParameterCurve:
    """What a parameter did, from its columns of metrics.csv."""
    before = parameter.columns(parameter.before)
    curves = {key: [value, *(row[key] for row in rows if key in row)] for key, value in before.items()}
    distances = curves.pop(parameter.distance_column, None)
    return ParameterCurve(parameter.name, [*curves.values()], distances, parameter.size)


def _save_after(recovery: Recovery, folder: RunFolder, index: int, after: Tensor) -> dict[str, Any]:
    name, target = recovery.targets.names[index], recovery.targets.images[index]
    mask = None if recovery.targets.masks is None else recovery.targets.masks[index]
    error = absolute_error(after, target)
    shown = error if mask is None else mask * error
    scale = error_scale(shown)
    folder.save_image(name, "after", after)
    folder.save_image(name, "error", shown, png=false_colour(shown, scale))
    before = read_image(folder.image_path(name, "before", ".exr")).permute(2, 0, 1).to(target)
    return {
        "sensor": name,
        "mean_error": _mean(error, mask).item(),
        "rmse_before": _mean((before - target).square(), mask).sqrt().item(),
        "rmse": _mean((after - target).square(), mask).sqrt().item(),
        "error_scale": scale,
    }


def _mean(values: Tensor, mask: Tensor | None) -> Tensor:
    """The mean of (C, H, W) values, of those that a mask counts."""
    return masked_mean(values[None], None if mask is None else mask[None])


def _parameter_summary(parameter: RecoveredParameter) -> dict[str, Any]:
    value = parameter.value
    summary = {"name": parameter.name, "shape": list(value.shape), "picture": parameter.is_picture}
    summary |= {"mean_before": parameter.before.mean().item(), "mean": value.mean().item()}
    if parameter.is_small:
        summary |= {"before": parameter.before.flatten().tolist(), "recovered": value.flatten().tolist()}
    if parameter.is_pose:
        summary["motion"] = parameter.motion(value)
    return summary | parameter.compared(value)


def _cost(recovery: Recovery, folder: RunFolder) -> dict[str, float | None]:
    """Seconds and bytes; medians, because the first step may compile."""
    rows = folder.metrics.rows()
    cost = {"seconds": recovery.seconds, "peak_memory_bytes": peak_memory()}
    for key in ("forward_seconds", "backward_seconds"):
        if rows and key in rows[0]:  # a joint step renders forwards and backwards in turns
            cost[f"median_{key}"] = statistics.median(row[key] for row in rows)
    return cost


def peak_memory() -> int | None:
    """Returns the most bytes this process has held: resident, or on the GPU where torch has used one; None: not known."""
    if torch.cuda.is_available() and torch.cuda.max_memory_allocated() > 0:
        return torch.cuda.max_memory_allocated()
    if resource is None:
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
