"""Rigid motions: `se3` from six numbers, smooth everywhere, and `look_at` from two points."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence

import torch
from torch import Tensor

from torch_radbp.tensors.differentiated import linear, moving_with
from torch_radbp.tensors.vec import Frame, Vec3

TERMS = 11  # of the series below: the first omitted term is 1e-22 of the sum at an angle of 1


def se3(rotation_vector: Tensor, translation: Tensor) -> Tensor:
    """The rigid motion that first rotates about the origin, then translates: p -> R p + translation.

    Unlike in the exponential of a twist, the rotation does not turn the translation. All derivatives are finite and correct
    everywhere, also at rotations of zero and of pi.

        start = scene.get_parameter("box.to_world").detach()
        pose = torch.zeros(2, 3, requires_grad=True)
        to_world = rb.se3(pose[0], pose[1]) @ start

    Args:
        rotation_vector: (..., 3) axis times angle in radians, right-handed; attached.
        translation: (..., 3), of the same dtype and device; leading axes are broadcast against those of the rotation.

    Returns:
        (..., 4, 4) matrices for column vectors, attached to both.

    Raises:
        TypeError: if an argument is not a tensor of floating point numbers, or the dtypes differ.
        ValueError: if the length of a last axis is not 3, or the leading axes cannot be broadcast.

    Reference: Rodrigues' formula; Murray, Li and Sastry 1994, "A Mathematical Introduction to Robotic Manipulation",
    equation 2.14.
    """
    _check(rotation_vector, translation)
    w = rotation_vector
    square = (w * w).sum(-1)
    sine, cosine = sine_and_cosine_terms(square)
    zero = torch.zeros_like(square)
    x, y, z = w.unbind(-1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*w.shape, 3)
    one, eye = moving_with(w, (torch.ones_like(square), torch.eye(3, dtype=w.dtype, device=w.device)))
    rotation = ((one - cosine * square)[..., None, None] * eye + sine[..., None, None] * cross
                + cosine[..., None, None] * w[..., :, None] * w[..., None, :])
    batch = torch.broadcast_shapes(w.shape[:-1], translation.shape[:-1])
    upper = torch.cat([rotation.expand(*batch, 3, 3), translation.expand(*batch, 3)[..., None]], -1)
    last = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=w.dtype, device=w.device).expand(*batch, 1, 4)
    return torch.cat([upper, last], -2)


def look_at(origin: Tensor | Sequence[float], target: Tensor | Sequence[float],
            up: Tensor | Sequence[float] | None = None) -> Tensor:
    """The pose of a camera or lamp at `origin` that looks at `target`, as Mitsuba's `ScalarTransform4f().look_at`.

    Its +z points at the target, its +y is as close to `up` as possible, and its +x points to the left.

        to_world = rb.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0])
        sensor = {"type": "perspective", "to_world": to_world}

    Args:
        origin: (3,) numbers or tensor; attached, as the others are.
        target: (3,) of a point other than `origin`.
        up: (3,) of any length, not parallel to the line of sight. Where it is None or zero some perpendicular direction
            is taken, the same as Mitsuba's.

    Returns:
        (4, 4) matrix for column vectors, in the dtype and on the device of the arguments that are floating point tensors,
        otherwise in torch's default dtype on the CPU.

    Raises:
        TypeError: if an argument is not made of real numbers.
        ValueError: if a shape is not (3,), a number is not finite, origin and target coincide, or `up` is parallel to the
            line between them, each as far as the dtype can tell.
    """
    given = [value for value in (origin, target, up) if isinstance(value, Tensor) and value.is_floating_point()]
    dtype = torch.get_default_dtype() if not given else given[0].dtype
    for value in given[1:]:
        dtype = torch.promote_types(dtype, value.dtype)
    device = next((value.device for value in given if value.device.type != "cpu"), None)
    origin, target = _point("origin", origin, dtype, device), _point("target", target, dtype, device)
    up = torch.zeros_like(origin) if up is None else _point("up", up, dtype, device)
    sight = target - origin
    rounding = 8 * torch.finfo(dtype).eps
    scale = torch.maximum(origin.detach().abs().max(), target.detach().abs().max())
    if sight.detach().abs().max() <= rounding * scale:
        raise ValueError(f"origin and target must differ, got {origin.tolist()} and {target.tolist()}")
    forward = _unit(sight)
    upward = _unit(up) if up.detach().any() else Frame.of(Vec3.of(forward)).s.stack()
    left = torch.linalg.cross(upward, forward)
    if left.detach().norm() <= rounding:
        raise ValueError(f"up must not be parallel to the line of sight, got {up.tolist()} for a line of sight along "
                         f"{sight.tolist()}")
    left = _unit(left)
    columns = torch.stack([left, torch.linalg.cross(forward, left), forward, origin], 1)
    return torch.cat([columns, columns.new_tensor([[0.0, 0.0, 0.0, 1.0]])])


def _point(name: str, value: Tensor | Sequence[float], dtype: torch.dtype, device: torch.device | None) -> Tensor:
    """`value` as a tensor of shape (3,), attached."""
    try:
        tensor = value if isinstance(value, Tensor) else torch.as_tensor(value, device="cpu")
        if tensor.dtype in (torch.bool, torch.complex64, torch.complex128):
            raise TypeError
    except (TypeError, ValueError, RuntimeError):
        raise TypeError(f"{name} must be three numbers, got {value!r}") from None
    if tensor.shape != (3,):
        raise ValueError(f"{name} must have shape (3,), got {tuple(tensor.shape)}")
    if not torch.isfinite(tensor).all():
        raise ValueError(f"{name} must be finite, got {tensor.tolist()}")
    return tensor.to(dtype=dtype, device=device)


def _unit(vector: Tensor) -> Tensor:
    """The unit vector along a nonzero vector of any length."""
    scaled = vector / vector.detach().abs().max()
    return scaled / scaled.norm()


def sine_and_cosine_terms(square: Tensor) -> tuple[Tensor, Tensor]:
    """sin(a) / a and (1 - cos(a)) / a^2 as functions of `square` = a^2, smooth at zero.

    Both are entire functions of a^2. Below 1 their series are used, above 1 the quotients. Where one form is not used it
    gets a harmless argument, since the derivative of an infinite quotient would be NaN even if it is not selected.
    """
    small = square < 1
    near, far = torch.where(small, square, 0.0), torch.where(small, 1.0, square)
    angle = far.sqrt()
    sine = torch.where(small, series(near, 1), torch.sin(angle) / angle)
    of_half = torch.sin(linear(operator.truediv, angle, 2))
    return sine, torch.where(small, series(near, 2), linear(operator.mul, of_half * of_half, 2) / far)


def series(square: Tensor, first: int) -> Tensor:
    """The series sum over k of (-square)^k / (2 k + first)!."""
    terms = [torch.full_like(square, 1 / math.factorial(2 * k + first)) for k in range(TERMS)]
    total, *others = moving_with(square, terms[::-1])
    for term in others:
        total = term - square * total
    return total


def _check(rotation_vector: Tensor, translation: Tensor) -> None:
    """Raises TypeError or ValueError unless the arguments are as `se3` says."""
    for name, value in (("rotation_vector", rotation_vector), ("translation", translation)):
        if not isinstance(value, Tensor) or not value.is_floating_point():
            got = value.dtype if isinstance(value, Tensor) else type(value).__name__
            raise TypeError(f"{name} must be a tensor of floating point numbers, got {got}")
        if value.ndim == 0 or value.shape[-1] != 3:
            raise ValueError(f"{name} must have shape (..., 3), got {tuple(value.shape)}")
    if rotation_vector.dtype != translation.dtype:
        raise TypeError(f"rotation_vector and translation must have one dtype, got {rotation_vector.dtype} and "
                        f"{translation.dtype}; convert one with .to()")
    try:
        torch.broadcast_shapes(rotation_vector.shape, translation.shape)
    except RuntimeError:
        raise ValueError(f"rotation_vector {tuple(rotation_vector.shape)} and translation {tuple(translation.shape)} must "
                         f"have leading axes that can be broadcast") from None
