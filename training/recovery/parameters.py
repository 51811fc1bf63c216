"""The scene parameters that a recipe recovers, found by name and set to their initial values."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import torch
from torch import Tensor, nn

from torch_radbp.plugin import nearest
from torch_radbp.plugin.domain import Domain
from torch_radbp.scene.modules.parameters import held_values
from torch_radbp.training import recipe_parameter as recipe
from torch_radbp.training.recovery.initial_values import check_values, initial_value, true_value
from torch_radbp.training.recovery.recovered import RecoveredParameter
from torch_radbp.training.recovery.shapes import RecoveredShape, read_surface
from torch_radbp.training.recovery.variables import check_fit, follow_positions, is_shape, put_variables


def matching(parameters: Sequence[RecoveredParameter], pattern: str, place: str) -> list[RecoveredParameter]:
    """Recovered parameters whose names are, or match, a recipe's word.

    Args:
        parameters: all of them.
        pattern: a name or a glob.
        place: where in the recipe it stands, for messages.

    Raises:
        ValueError: there is none; the message lists those that there are.
    """
    found = [each for each in parameters if fnmatchcase(each.name, pattern)]
    if not found:
        names = [each.name for each in parameters]
        raise ValueError(f"{place}: {pattern!r} is none of the parameters that are recovered; {nearest(pattern, names)}")
    return found


def choose_parameters(scene: nn.Module, specs: list[recipe.Parameter]) -> list[RecoveredParameter]:
    """Finds the recipe's parameters in the scene and sets them to their initial values.

    Nothing is changed unless everything is right.

    Raises:
        ValueError: a name that does not exist (with the nearest), a wrong shape, a value that is not finite, out of
            bounds, or none that the parameter can have, such as a pose that is no affine transform.
    """
    known, held = dict(scene.named_parameters()), held_values(scene)
    chosen: dict[str, RecoveredParameter] = {}
    for spec in specs:
        names = [name for name in known if fnmatchcase(name, spec.name)]
        if not names:
            raise ValueError(f"parameter {spec.name!r} does not exist in the scene; {nearest(spec.name, known)}")
        for name in names:
            if name in chosen:
                raise ValueError(f"parameter {name!r} is named twice, by {chosen[name].spec.name!r} and {spec.name!r}")
            chosen[name] = _choose(scene, name, known[name], spec, held[name].domains)
    for name, parameter in chosen.items():
        _start(scene, parameter)
        if is_shape(parameter.module, parameter.attribute) and f"{name.rpartition('.')[0]}.vertex_normals" not in chosen:
            follow_positions(parameter.module)
    return list(chosen.values())


def _choose(scene: nn.Module, name: str, held: Tensor, spec: recipe.Parameter, domains: list[Domain]) -> RecoveredParameter:
    path, _, attribute = name.rpartition(".")
    module = scene.get_submodule(path)
    check_fit(module, attribute, spec, name)
    before = initial_value(held, spec, name)
    if is_shape(module, attribute) and isinstance(spec.truth, Path):
        check_values(name, spec, before, None, domains)
        return RecoveredShape(name, module, attribute, spec, before, None,
                               surface=read_surface(spec.truth, module.loaded_to_world))
    truth = true_value(held, spec, name)
    check_values(name, spec, before, truth, domains)
    return RecoveredParameter(name, module, attribute, spec, before, truth)


def _start(scene: nn.Module, parameter: RecoveredParameter) -> None:
    with torch.no_grad():
        parameter.raw.copy_(parameter.before)
    parameter.raw.requires_grad_()
    parameter.stand_in = put_variables(scene, parameter.module, parameter.attribute, parameter.spec)
