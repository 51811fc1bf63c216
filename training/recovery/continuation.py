"""Whether a state from a file is one of a run: every field of it is compared before anything is changed.

What follows from the recipe, learning rates for instance, is not in the state but computed again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from torch import Tensor

from torch_radbp.training.recipe import Recipe
from torch_radbp.training.recovery.checkpoint import START_ANEW, CheckpointError, State

if TYPE_CHECKING:
    from torch_radbp.training.recovery.problem import Recovery

COUNTS = ("step", "skipped", "processes")
# Means of squares, of Adam and of RMSprop.
SQUARES = ("exp_avg_sq", "square_avg")
STEPS_TAKEN = "step"  # Adam's counter
MAY_CHANGE = ("steps", "render.device")
SHOWN = 200  # characters of a value in a message
MOST_CHANGES = 4  # that a message lists


def recipe_fields(recipe: Recipe) -> dict[str, Any]:
    """Every key of a recipe that a resumed run may not change, dotted; paths are relative to the scene's folder."""
    context = {"base_dir": recipe.scene.parent}
    fields = _flat(recipe.model_dump(mode="json", exclude_none=True, context=context), "")
    return {key: value for key, value in fields.items() if key not in MAY_CHANGE}


def _flat(value: Any, place: str) -> dict[str, Any]:
    if isinstance(value, dict):
        pairs = [(f"{place}.{key}" if place else key, each) for key, each in value.items()]
    elif isinstance(value, list) and any(isinstance(each, dict) for each in value):
        pairs = [(f"{place}[{index}]", each) for index, each in enumerate(value)]
    else:
        return {place: value}
    return {key: leaf for name, each in pairs for key, leaf in _flat(each, name).items()}


def recipe_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What the first keys that differ between two recipes were, and what they are."""
    keys = [key for key in dict.fromkeys([*before, *now]) if before.get(key) != now.get(key)]
    changes = [f"{key} was {_shown(before, key)} and is {_shown(now, key)}" for key in keys[:MOST_CHANGES]]
    return changes + [f"and {len(keys) - MOST_CHANGES} more"] * (len(keys) > MOST_CHANGES)


def _shown(fields: Mapping[str, Any], key: str) -> str:
    text = repr(fields[key]) if key in fields else "not set"
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


class Expected(NamedTuple):
    """What a checkpoint of a run has of one leaf, or of another tensor.

    Attributes:
        like: a tensor of its shape and dtype, on the device `meta`.
        moments: what the optimiser keeps of a leaf once it has moved, likewise; of other tensors nothing.
        bounds: between what it is kept; None: it is free.
        moved: how many of the steps so far, after which the moments were last forgotten, moved it.
    """

    like: Tensor
    moments: dict[str, Tensor]
    bounds: tuple[float, float] | None
    moved: int


def state_bytes(recovery: Recovery) -> int:
    """The bytes of the tensors of a run's state at most: at its end, when grids are finest."""
    tensors = [value for each in recovery.expected(recovery.recipe.steps).values()
               for value in (each.like, *each.moments.values())]
    return sum(value.numel() * value.element_size() for value in tensors)


def check_state(path: Path, state: State, recovery: Recovery) -> None:
    """Checks that a loaded state is one of a run.

    Args:
        path: where it was read, for messages.
        state: what was read.
        recovery: the run, before its first step.

    Raises:
        CheckpointError: another recipe or other files, other names, shapes or dtypes, or numbers that make no sense; the
            message names the first of them, what was and what is.
    """
    fresh = recovery.state_dict()
    try:
        _check_fields(state, fresh)
        _check_counts(state, recovery.recipe.steps)
        _check_recipe(state["recipe"], fresh["recipe"])
        _check_sources(state["sources"], fresh["sources"])
        expected = recovery.expected(state["step"])
        _check_parameters(state["parameters"], expected)
        _check_moments(state, expected)
        _check_joint("joint", state["joint"], fresh["joint"])
        if recovery.joint and state["joint"]["kept_at"] is not None:
            _check_place(state["joint"]["kept_at"], sum(leaf.numel() for leaf in recovery.joint.leaves.values()))
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from None


def _refuse(problem: str) -> CheckpointError:
    return CheckpointError(f"{problem}; the checkpoint is not one of this recipe; {START_ANEW}")


def _check_fields(state: State, fresh: State) -> None:
    for key in fresh:
        if key not in state:
            raise _refuse(f"{key} is missing")
    for key in state:
        if key not in fresh:
            raise _refuse(f"{str(key)[:SHOWN]!r} is no field of a checkpoint; its fields are {', '.join(fresh)}")


def _check_counts(state: State, steps: int) -> None:
    for key in COUNTS:
        if type(state[key]) is not int or state[key] < (key == "processes"):
            raise _refuse(f"{key} is {_shown(state, key)} instead of a whole number, at least {int(key == 'processes')}")
    if state["skipped"] > state["step"]:
        raise _refuse(f"skipped is {state['skipped']}, more than the {state['step']} steps so far")
    seconds = state["seconds"]
    if type(seconds) not in (int, float) or not 0 <= seconds < math.inf:
        raise _refuse(f"seconds is {_shown(state, 'seconds')} instead of a number, at least 0")
    if state["step"] > steps:
        raise CheckpointError(f"the run is at step {state['step']} already, beyond steps = {steps}")


def _check_recipe(before: Any, now: dict[str, Any]) -> None:
    if not isinstance(before, dict):
        raise _refuse("recipe is no table")
    changes = recipe_changes(before, now)
    if changes:
        raise CheckpointError(f"the checkpoint was made with another recipe: {'; '.join(changes)}; a resumed run may only "
                              f"change {' and '.join(MAY_CHANGE)}: set the others back, or {START_ANEW}")


def _check_sources(before: Any, now: dict[str, str]) -> None:
    if not isinstance(before, dict):
        raise _refuse("sources is no table")
    changed = [name for name in now if name in before and before[name] != now[name]]
    if changed:
        name = changed[0]
        raise CheckpointError(f"the file {name} has changed since the run began: its SHA-256 was {str(before[name])[:12]} "
                              f"and is {now[name][:12]}; put the former file back, or {START_ANEW}")
    if before.keys() != now.keys():
        name = min(before.keys() ^ now.keys())
        was, is_now = ("read", "not read") if name in before else ("not read", "read")
        raise CheckpointError(f"the file {name[:SHOWN]} was {was} when the run began and is {is_now} now; put the former "
                              f"scene back, or {START_ANEW}")


def _check_parameters(values: dict[str, Tensor], expected: dict[str, Expected]) -> None:
    _check_names("parameters", values, list(expected))
    for name, each in expected.items():
        place, value = f"parameters.{name}", values[name]
        _check_tensor(place, value, each.like)
        if each.bounds is None:
            continue
        lower, upper = each.bounds
        outside = (value < lower) | (value > upper)
        if outside.any():
            raise _refuse(f"{place} is {value[outside].flatten()[0].item():g}, out of the bounds [{lower:g}, {upper:g}]")


def _check_moments(state: State, expected: dict[str, Expected]) -> None:
    """Of each leaf that has moved; which of the steps were skipped is not known, only how many."""
    skipped, taken = state["skipped"], state["step"] - state["skipped"]
    leaves = {name: each for name, each in expected.items() if each.moments}
    least = {name: max(each.moved - skipped, 0) for name, each in leaves.items()}
    most = {name: min(each.moved, taken) for name, each in leaves.items()}
    _check_names("moments", state["moments"],
                 [name for name in leaves if least[name] or most[name] and name in state["moments"]])
    for name, found in state["moments"].items():
        _check_names(f"moments.{name}", found, list(expected[name].moments))
        for moment, like in expected[name].moments.items():
            place, value = f"moments.{name}.{moment}", found[moment]
            _check_tensor(place, value, like)
            if moment in SQUARES and (value < 0).any():
                raise _refuse(f"{place} is {value.min().item():g}, and a mean of squares is at least 0")
            if moment == STEPS_TAKEN and not least[name] <= value.item() <= most[name]:
                count = f"{most[name]}" if least[name] == most[name] else f"{least[name]} to {most[name]}"
                raise _refuse(f"{place} is {value.item():g} after {count} steps that were not skipped")


def _check_joint(place: str, found: Any, fresh: Any) -> None:
    """Of Gauss-Newton: numbers of the kinds that a new one has, at least 0 but for what is gained by a step."""
    if isinstance(fresh, dict):
        if not isinstance(found, dict):
            raise _refuse(f"{place} is no table")
        _check_names(place, found, list(fresh))
        for key, value in fresh.items():
            if key != "kept_at":
                _check_joint(f"{place}.{key}", found[key], value)
    elif fresh is None:
        if found is not None:
            raise _refuse(f"{place} is {_shown({place: found}, place)}, and the recipe's optimizer is not gauss-newton")
    elif type(found) is not type(fresh) or not math.isfinite(found) or found < 0 and not place.endswith(".gain"):
        raise _refuse(f"{place} is {_shown({place: found}, place)} instead of a number such as {fresh!r}")


def _check_place(found: Any, size: int) -> None:
    """Of Gauss-Newton: where its Jacobian was computed."""
    is_one = isinstance(found, dict) and found.keys() == {"position", "seed", "spp"}
    if not is_one or type(found["spp"]) is not int or found["spp"] < 1:
        raise _refuse("joint.kept_at is no table of position, seed and spp")
    seed, position = found["seed"], found["position"]
    if type(seed) is not int or seed < 0:
        raise _refuse(f"joint.kept_at.seed is {_shown(found, 'seed')} instead of a seed")
    if not isinstance(position, list) or len(position) != size or any(
            type(each) is not float or not math.isfinite(each) for each in position):
        raise _refuse(f"joint.kept_at.position is {_shown(found, 'position')} instead of {size} finite numbers")


def _check_names(place: str, found: dict[str, Any], expected: list[str]) -> None:
    for name in expected:
        if name not in found:
            raise _refuse(f"{place}.{name} is missing")
    for name in found:
        if name not in expected:
            raise _refuse(f"{place}.{name[:SHOWN]} is there, but {place} has {', '.join(expected) or 'nothing'}")


def _check_tensor(place: str, value: Tensor, like: Tensor) -> None:
    if (value.shape, value.dtype) != (like.shape, like.dtype):
        raise _refuse(f"{place} is {_kind(value)} instead of {_kind(like)}")
    if not value.isfinite().all():
        raise _refuse(f"{place} is not finite")


def _kind(value: Tensor) -> str:
    return f"{tuple(value.shape)} {str(value.dtype).removeprefix('torch.')}"
