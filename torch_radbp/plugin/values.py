"""Checks and conversions of the plain values that constructors are given."""

from __future__ import annotations

import math
import operator
import warnings
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torch_radbp.plugin.errors import SceneWarning, level_of_the_caller
from torch_radbp.tensors.least_and_greatest import least_and_greatest

NARROW = 2.0  # degrees; few views and beams are narrower, and many angles in radians are less


def finite(name: str, value: Any, shape: tuple[int, ...] | None = None) -> Tensor:
    """`value` as a finite float tensor of the given shape: an `nn.Parameter` itself, else a copy.

    Raises:
        ValueError: if the shape differs, a value is complex or not finite, or the copy of a tensor would lose its gradient.
        TypeError: if it is no dense array of numbers.
    """
    if isinstance(value, Tensor) and value.requires_grad and not isinstance(value, nn.Parameter):
        raise no_gradient(name)
    if isinstance(value, nn.Parameter):
        tensor = value
    else:
        try:
            tensor = value.detach().clone() if isinstance(value, Tensor) else torch.as_tensor(value, device="cpu")
        except (TypeError, ValueError, RuntimeError):
            raise TypeError(f"{name} must be a tensor or an array of numbers, got {type(value).__name__}") from None
    if tensor.layout != torch.strided:
        raise TypeError(f"{name} must be a dense tensor, got {tensor.layout}: convert it with .to_dense()")
    if tensor.dtype == torch.bool:
        raise TypeError(f"{name} must be numbers, got {tensor.dtype}: convert it with .float()")
    if tensor.is_meta:
        raise ValueError(f"{name} is on the device meta, which holds no numbers: give it on the CPU")
    if tensor.is_complex():
        raise ValueError(f"{name} must be real numbers, got {tensor.dtype}; take its real part")
    if not tensor.is_floating_point():
        tensor = tensor.to(torch.get_default_dtype())
    if shape is not None and tuple(tensor.shape) != shape:
        raise ValueError(f"{name} must have shape {shape}, got {tuple(tensor.shape)}")
    if not bool(torch.isfinite(least_and_greatest(tensor).to(torch.get_default_dtype())).all()):
        bad = int((~torch.isfinite(tensor.to(torch.get_default_dtype()))).sum())
        raise ValueError(f"{name} must be finite, got {bad} of {tensor.numel()} values that are NaN or infinite in "
                         f"{str(torch.get_default_dtype()).removeprefix('torch.')}")
    return tensor


def no_gradient(name: str) -> ValueError:
    """The error about a tensor with a gradient that would be lost when it becomes a parameter."""
    return ValueError(f"{name} requires a gradient, which would not reach it: only an nn.Parameter, of the dtype, shape and "
                      f"space in which the scene keeps it, becomes the scene's own parameter. Give one; or load the scene "
                      f"first and hand the tensor over by torch.func.functional_call or torch.nn.utils.parametrize")


def integer(name: str, value: Any, least: int | None = None) -> int:
    """`value` as an int: numpy's integers and tensors of one integer are accepted, truth values are not.

    Raises:
        ValueError: if it is of another type, or less than `least`.
    """
    try:
        number = None if isinstance(value, (bool, np.bool_)) else operator.index(value)
    except TypeError:
        number = None
    if number is None or (least is not None and number < least):
        raise ValueError(f"{name} must be an integer{'' if least is None else f' of at least {least}'}, got {value!r}")
    return number


def boolean(name: str, value: Any) -> bool:
    """`value` as a bool.

    Raises:
        ValueError: if it is anything but a truth value; 0 and 1 are numbers.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def positive(name: str, value: float) -> float:
    """`value`, checked to be greater than zero and finite."""
    if not (value > 0 and value < float("inf")):
        raise ValueError(f"{name} must be greater than 0 and finite, got {value}")
    return float(value)


def warn_of_radians(name: str, degrees: float) -> None:
    """Warns of an angle in degrees that is so small that radians may have been meant."""
    if degrees < NARROW:
        warnings.warn(f"{name} is in degrees, got {degrees:g}, which is very narrow: if radians were meant, give "
                      f"{math.degrees(degrees):.4g}", SceneWarning, stacklevel=level_of_the_caller())
