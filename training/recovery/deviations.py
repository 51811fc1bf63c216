"""How far the values that a run has recovered are known: the part of its summary that `rb.covariance` computes."""

import math
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torch_radbp.optim.linearisation import Images
from torch_radbp.training.recovery.gains import RecoveredGains
from torch_radbp.training.recovery.optimize import step_seed
from torch_radbp.training.recovery.plain_values import plain_values
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.recovery.recovered import RecoveredParameter
from torch_radbp.training.recovery.run_folder import RunFolder
from torch_radbp.uncertainty.covariance import CovarianceOfParameters, covariance, diagonal_covariance
from torch_radbp.uncertainty.curvature import DENSE

REPEATS = 3  # Jacobians
ALWAYS = 48  # renderings in forward mode that no run is too short for
PROBES = 8  # of maps
NEVER = "report.deviations = \"none\" asks for none"
HOW_TO_ASK = "report.deviations = \"all\" computes them whatever it takes"


class EndedError(Exception):
    """Somebody does not want to wait any longer."""


def deviations_of(recovery: Recovery, folder: RunFolder, ended: Callable[[], bool]) -> dict[str, Any]:
    """What the summary says of deviations; a run whose recipe cannot be treated gets a sentence that says why.

    Args:
        recovery: with settled parameters.
        folder: gets a picture of deviations for each map.
        ended: asked before each rendering; True leaves deviations out.

    Returns:
        "computed", whether there are any; "why" there are none, or what they leave out; "seconds"; and, if there are:
        "noise", the standard deviation of a pixel; "names", "values", "deviations" and "correlations" of single numbers,
        None where nothing is known; "flat" and "weak", directions in words; "maps", names and largest deviations.
    """
    started = time.perf_counter()
    try:
        found = _computed(recovery, folder, ended)
    except EndedError:
        found = nothing("the run was interrupted before they were computed")
    except Exception as error:  # a finished run must not be lost for want of its deviations
        found = nothing(f"they cannot be computed: {str(error).splitlines()[0] if str(error) else type(error).__name__}")
    return found | {"seconds": time.perf_counter() - started}


def nothing(why: str) -> dict[str, Any]:
    """What a summary says where there are no deviations."""
    return {"computed": False, "why": why, "names": [], "flat": [], "weak": [], "maps": []}


def _computed(recovery: Recovery, folder: RunFolder, ended: Callable[[], bool]) -> dict[str, Any]:
    asked = recovery.recipe.report.deviations
    if asked == "none":
        return nothing(NEVER)
    chosen, left_out = choose(recovery, asked == "all")
    maps = [each for each in left_out if asked == "all" and prior_of(each) is not None]
    if not chosen and not maps:
        return nothing(f"{_listed(left_out)} would take many renderings; {HOW_TO_ASK}" if asked == "auto" else
                       f"{_listed(left_out)} has too many numbers for a covariance, and is no bitmap within bounds")
    spp = recovery.objective.spp_of_buffer(recovery.plan.spp(max(recovery.step - 1, 0)))
    seed = step_seed(recovery.recipe.render.seed, -2, 0)
    found = nothing("") | {"computed": True}
    with plain_values(recovery, [*chosen, *maps]) as plain:
        images = _until(ended, plain.images)
        noise = noise_of_residuals(recovery, images, spp, seed, sum(leaf.numel() for leaf in plain.leaves.values()))
        found["noise"] = _root_mean_square(noise)
        leaves = {name: leaf for each in chosen for name, leaf in plain.leaves_of(each.name).items()}
        if leaves:
            known = covariance(images, recovery.targets.images, leaves, noise=noise, spp=spp, repeats=REPEATS, seed=seed + 2)
            found |= described(known)
            for each in chosen:
                if is_map(each) and known.standard_deviations[each.name].isfinite().all():
                    found["maps"].append(_saved(folder, each, known.standard_deviations[each.name], None))
        for each in maps:
            probed = diagonal_covariance(images, {each.name: each.raw}, noise=noise, prior={each.name: prior_of(each)},
                                         spp=spp, probes=PROBES, seed=seed)
            found["maps"].append(_saved(folder, each, probed.standard_deviations[each.name], prior_of(each)))
    held = [each for each in left_out if each not in maps]
    notes = []
    if held:
        notes.append(f"They are as if {_listed(held)} were known exactly: {HOW_TO_ASK}" if asked == "auto" else
                     f"They are as if {_listed(held)} were known exactly")
    if maps and len(recovery.parameters) > 1:
        notes.append(f"Those of {_listed(maps)} are as if all else were known exactly")
    if recovery.recipe.priors:
        notes.append("The recipe's priors are left out")
    return found | {"why": ". ".join(notes)}


def choose(recovery: Recovery, everything: bool) -> tuple[list[RecoveredParameter], list[RecoveredParameter]]:
    """The parameters whose covariance is computed, and those that are too large for that.

    Smaller ones come first. Without being asked for everything a run spends no more renderings in forward mode than it has
    rendered images, which is about a quarter of its time.
    """
    views, steps = len(recovery.targets.names), max(recovery.step, 1)
    rendered = sum(len(recovery.plan.views(step)) for step in range(steps))
    most = DENSE if everything else min(DENSE, max(ALWAYS // REPEATS, rendered // (REPEATS * views)))
    chosen, numbers = set(), 0
    for each in sorted(recovery.parameters, key=numbers_of):
        if (numbers := numbers + numbers_of(each)) > most:
            break
        chosen.add(each.name)
    return ([each for each in recovery.parameters if each.name in chosen],
            [each for each in recovery.parameters if each.name not in chosen])


def numbers_of(parameter: RecoveredParameter) -> int:
    """How many numbers it has for a covariance: six of a pose."""
    return 6 if parameter.is_pose else parameter.before.numel()


def prior_of(parameter: RecoveredParameter) -> float | None:
    """The standard deviation of a uniform distribution between the bounds of a bitmap; None of anything else."""
    bounds = None if isinstance(parameter, RecoveredGains) else parameter.spec.bounds
    if bounds is None or not is_map(parameter) or parameter.spec.parametrisation == "network":
        return None
    return (bounds[1] - bounds[0]) / math.sqrt(12.0)


def is_map(parameter: RecoveredParameter) -> bool:
    """True for a bitmap, (H, W, 1 or 3), of more texels than are listed one by one."""
    return parameter.is_picture and parameter.before.dim() == 3


def noise_of_residuals(recovery: Recovery, images: Images, spp: int, seed: int, numbers: int) -> Tensor:
    """Standard deviations of pixels, of the shape of the images: one number, but for masks.

    It is the root mean square by which targets and the two buffers of a step differ, with the freedom of the parameters
    taken off; infinite where a mask is 0.
    """
    targets, masks = recovery.targets.images, recovery.targets.masks
    with torch.no_grad():
        rendered = (images(seed, spp) + images(seed + 1, spp)) / 2
    weight = torch.ones_like(targets) if masks is None else masks.expand_as(targets)
    square = float((weight * (rendered - targets).square()).double().sum())
    sigma = math.sqrt(square / max(float(weight.double().sum()) - numbers, 1.0))
    if not sigma > 0:
        raise ValueError("images and targets are equal, bit by bit, and say nothing of noise")
    return sigma / weight.double().sqrt()


def described(found: CovarianceOfParameters) -> dict[str, Any]:
    """A covariance as a summary holds it; `correlations` by rows."""
    deviations = found.matrix.diag().sqrt()
    return {"names": found.names, "values": found.values.tolist(), "deviations": _finite(deviations),
            "correlations": [_finite(row) for row in found.correlations],
            "flat": [direction.words for direction in found.flat], "weak": found.weak}


def _saved(folder: RunFolder, parameter: RecoveredParameter, deviations: Tensor, prior: float | None) -> dict[str, Any]:
    """What a summary says of a map, (H, W, 1 or 3), whose picture is written."""
    folder.save_deviations(parameter.name, deviations)
    return {"name": parameter.name, "largest": float(deviations.max()), "median": float(deviations.median()), "prior": prior}


def _until(ended: Callable[[], bool], images: Images) -> Images:
    def rendered(seed: int, spp: int | None):
        if ended():
            raise EndedError
        return images(seed, spp)

    return rendered


def _root_mean_square(noise: Tensor) -> float:
    return float(noise[noise.isfinite()].square().mean().sqrt())


def _finite(values: Tensor) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values.tolist()]


def _listed(parameters: list[RecoveredParameter]) -> str:
    names = [each.name for each in parameters]
    return ", ".join(names) if len(names) <= 4 else f"{', '.join(names[:3])} and {len(names) - 3} more"
