"""The values that recovered parameters begin with, and the true ones that reports compare with, from recipe and scene."""

from pathlib import Path

import torch
from torch import Tensor

from torch_radbp.formats.image import read_image
from torch_radbp.plugin.domain import Domain
from torch_radbp.training import recipe_parameter as recipe
from torch_radbp.training.recipe_values import Value
from torch_radbp.training.recovery.network import make_texels
from torch_radbp.training.recovery.rigid import moved


def initial_value(held: Tensor, spec: recipe.Parameter, name: str) -> Tensor:
    """Returns the value that a recipe starts from, detached.

    Args:
        held: the value in the scene.
        spec: the recipe's table.
        name: of the parameter, for messages.

    Raises:
        ValueError: another shape, a value out of bounds, or one that its parametrisation cannot have.
    """
    before = _given(held, spec, name)
    if spec.bounds is not None:
        lower, upper = spec.bounds
        outside = (before < lower) | (before > upper)
        if outside.any():
            raise ValueError(
                f"parameter {name!r}: initial values must be within bounds [{lower:g}, {upper:g}], "
                f"got {before[outside].flatten()[0].item():g}"
            )
    if spec.parametrisation == "log" and not (before > 0).all():
        raise ValueError(f'parameter {name!r}: parametrisation = "log" needs positive initial values')
    return before


def _given(held: Tensor, spec: recipe.Parameter, name: str) -> Tensor:
    if spec.parametrisation == "rigid" and held.shape != (4, 4):
        raise ValueError(f'parameter {name!r}: parametrisation = "rigid" is for matrices of shape (4, 4), this one has '
                         f"{tuple(held.shape)}; leave it out or name a to_world")
    if spec.parametrisation == "network":
        texels = make_texels(spec, held)
        return texels(texels.right_inverse(held))
    if spec.initial is None:
        return held.detach().clone()
    if isinstance(spec.initial, recipe.Offset):
        rotation, translation = torch.tensor([spec.initial.rotation, spec.initial.translation]).to(held)
        return moved(held.detach(), torch.deg2rad(rotation), translation)
    return tensor_like(held, spec.initial, name, "initial")


def true_value(held: Tensor, spec: recipe.Parameter, name: str) -> Tensor | None:
    """Returns the value that a recipe calls true, detached; None if it does not know one."""
    if spec.truth is None:
        return None
    return held.detach().clone() if spec.truth == "scene" else tensor_like(held, spec.truth, name, "truth")


def check_values(name: str, spec: recipe.Parameter, before: Tensor, truth: Tensor | None, domains: list[Domain]) -> None:
    """Raises ValueError unless both values are ones that the parameter can have."""
    if spec.parametrisation == "rigid":
        _check_poses(name, before, truth)
    for role, value in (("initial", before), ("truth", truth)):
        for domain in domains if value is not None else ():
            domain.check(f"parameter {name!r}: {role}", value)


def _check_poses(name: str, before: Tensor, truth: Tensor | None) -> None:
    """Raises ValueError unless the matrices are affine, and differ by a rigid motion."""
    for role, matrix in (("initial", before), ("truth", truth)):
        if matrix is not None and not torch.equal(matrix[3], matrix.new_tensor([0.0, 0.0, 0.0, 1.0])):
            raise ValueError(f"parameter {name!r}: the last row of {role} must be 0 0 0 1, got {matrix[3].tolist()}")
    if truth is None:
        return
    turn = (before[:3, :3].double() @ torch.linalg.inv(truth[:3, :3].double()))
    if (turn @ turn.T - torch.eye(3).to(turn)).abs().max() > 1e-4 or torch.linalg.det(turn) < 0:
        raise ValueError(f'parameter {name!r}: parametrisation = "rigid" rotates and moves, but initial and truth differ '
                         "in scale, shear or handedness too; use another parametrisation or a matching initial value")


def tensor_like(held: Tensor, value: Value, name: str, role: str) -> Tensor:
    """Returns a recipe's value as a tensor of a parameter's shape, dtype and device.

    Args:
        held: a tensor of that kind.
        value: one number for all entries, nested lists, or an image file.
        name, role: of the parameter and of the value, for messages.

    Raises:
        ValueError: another shape, or values that are not finite.
    """
    if isinstance(value, Path):
        tensor = read_image(value)
        source = f"the image {value} of shape"
    else:
        try:
            tensor = torch.tensor(value, dtype=held.dtype)
        except ValueError:
            raise ValueError(f"parameter {name!r}: {role} must be one number or have shape {tuple(held.shape)}; "
                             "the rows given differ in length") from None
        source = "shape"
    tensor = tensor.to(device=held.device, dtype=held.dtype)
    if tensor.dim() == 0:
        tensor = tensor.expand(held.shape)
    if tensor.shape != held.shape:
        raise ValueError(
            f"parameter {name!r}: {role} must be one number or have shape {tuple(held.shape)}, "
            f"got {source} {tuple(tensor.shape)}"
        )
    if not tensor.isfinite().all():
        raise ValueError(f"parameter {name!r}: {role} must be finite, got NaN or infinity")
    return tensor.clone()
