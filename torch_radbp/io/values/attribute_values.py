"""Checks the plain values of a scene description against the annotations of a plugin's constructor."""

from __future__ import annotations

import os
import typing
from collections.abc import Callable
from numbers import Integral, Real
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torch_radbp.formats.trimesh_arrays import is_trimesh
from torch_radbp.plugin import (
    Filename,
    Matrix4,
    Point3,
    Texture,
    TriangleMesh,
    no_gradient,
    options,
    plugin_categories,
    with_article,
)
from torch_radbp.texture.spectrum import Samples

DENSE = torch.strided
LARGEST_INTEGER = 2**31 - 1


def is_list(annotation: Any) -> bool:
    """True if an attribute takes several plugins, list[BSDF]."""
    return any(typing.get_origin(option) is list for option in options(annotation))


def is_named(annotation: Any) -> bool:
    """True if an attribute takes several plugins by their names, dict[str, Shape]."""
    return any(typing.get_origin(option) is dict for option in options(annotation))


def convert(name: str, value: Any, annotation: Any) -> Any:
    """`value` as one of the plain types that `annotation` allows.

    Returns:
        An int, bool, str or float; a list of three floats for Point3 and colours; a (4, 4) float64 tensor for Matrix4; an
        `nn.Parameter` as it is, for all that becomes a parameter.

    Raises:
        TypeError: if it is of another type or shape.
        ValueError: if a number is not finite, or a matrix is not affine and invertible.
    """
    members = options(annotation)
    if isinstance(value, Tensor) and (value.requires_grad or isinstance(value, nn.Parameter)):
        return live(name, value, members)
    if value is None and type(None) in members:
        return None
    if Texture in members:  # which takes plain numbers, too
        members = (Texture,)
    rules = [RULES[member] for member in members if member in RULES]
    for _, rule in rules:
        try:
            return rule(name, value)
        except TypeError:
            continue
    plugins = [f"{with_article(category)}, a dict with a \"type\"" for category in plugin_categories(annotation)
               if category != "texture"]
    expected = " or ".join(dict.fromkeys([*(expected for expected, _ in rules), *plugins]))
    raise TypeError(f"{name} must be {expected}, got {value_text(value)}")


def live(name: str, value: Tensor, members: tuple[Any, ...]) -> nn.Parameter:
    """Checks that a tensor in a scene description may become a parameter of the scene itself, and returns it.

    Raises:
        ValueError: if the attribute takes plain numbers, or `value` is no `nn.Parameter`.
    """
    if not isinstance(value, nn.Parameter) or not any(member in members for member in (Tensor, Texture, Matrix4, Point3)):
        raise no_gradient(name)
    return value


def value_text(value: Any) -> str:
    """A value as text for messages, shortened if long."""
    if hasattr(value, "shape") and len(value.shape) > 0:
        dtype = str(getattr(value, "dtype", ""))
        kind = f" of {value.dtype}" if "complex" in dtype or "bool" in dtype else ""
        kind += " on the device meta, which holds no numbers" if getattr(value, "is_meta", False) else ""
        kind += f" of {value.layout}, which .to_dense() makes dense" if getattr(value, "layout", DENSE) != DENSE else ""
        return f"{type(value).__name__} of shape {tuple(value.shape)}{kind}"
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python prints
        return f"an {type(value).__name__} of very many digits"
    return text if len(text) < 80 else f"{type(value).__name__} {text[:60]}..."


def _array(value: Any) -> np.ndarray:
    """A float64 array from a list, a numpy array, a torch tensor or a Mitsuba type; of real numbers only."""
    if isinstance(value, (str, bytes, dict)) or value is None:
        raise TypeError
    try:
        if isinstance(value, Tensor):
            value = value.detach().cpu()
            value = value.double() if value.is_floating_point() else value  # numpy has no bfloat16
        array = np.asarray(value)
        if array.dtype.kind not in "iufO":  # not of truth values, text or complex numbers
            raise TypeError
        return array.astype(np.float64)
    except (ValueError, RuntimeError, OverflowError) as error:
        raise TypeError from error


def _finite(name: str, array: np.ndarray) -> np.ndarray:
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name} must be finite, got {array.tolist()}")
    return array


def _scalar(value: Any) -> Any:
    return value.item() if getattr(value, "shape", None) == () else value


def _integer(name: str, value: Any) -> int:
    value = _scalar(value)
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError
    if abs(value) > LARGEST_INTEGER:
        raise ValueError(f"{name} must be between -{LARGEST_INTEGER} and {LARGEST_INTEGER}, got {value_text(value)}")
    return int(value)


def _number(name: str, value: Any) -> float:
    value = _scalar(value)
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError
    try:
        return float(_finite(name, np.float64(value)))
    except OverflowError as error:
        raise ValueError(f"{name} must be finite, got an integer beyond the range of float64") from error


def _boolean(name: str, value: Any) -> bool:
    value = _scalar(value)
    if not isinstance(value, bool):
        raise TypeError
    return value


def _string(name: str, value: Any) -> str:
    if not isinstance(value, (str, os.PathLike)):
        raise TypeError
    return os.fspath(value)


def _triple(name: str, value: Any) -> list[float]:
    array = _array(value)
    if array.shape != (3,):
        raise TypeError
    return _finite(name, array).tolist()


def _colour(name: str, value: Any) -> float | list[float]:
    array = _array(value)
    if array.shape not in ((), (1,), (3,)):
        raise TypeError
    return _finite(name, array.squeeze()).tolist()


def _colour_or_spectrum(name: str, value: Any) -> float | list[float] | Samples:
    return value if isinstance(value, Samples) else _colour(name, value)


def _samples(name: str, value: Any) -> Samples:
    if not isinstance(value, Samples):
        raise TypeError
    return value


def _matrix(name: str, value: Any) -> Tensor:
    array = _array(getattr(value, "matrix", value))
    if array.shape == (3, 3):  # of the plane, as Mitsuba's to_uv
        plane, array = array, np.eye(4)
        array[np.ix_((0, 1, 3), (0, 1, 3))] = plane
    if array.shape != (4, 4):
        raise TypeError
    _finite(name, array)
    if not np.allclose(array[3], (0, 0, 0, 1)):
        raise ValueError(f"{name} must be affine, its last row 0, 0, 0, 1, got {array[3].tolist()}")
    return torch.from_numpy(array)


def _tensor(name: str, value: Any) -> Tensor:
    if isinstance(value, Tensor) and value.dtype != torch.bool and not value.is_complex():
        return value
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:  # pixels as they are coded
        return torch.tensor(value)
    return torch.from_numpy(_array(value))


def _triangle_mesh(name: str, value: Any) -> Any:
    if not is_trimesh(value):
        raise TypeError
    return value


RULES: dict[Any, tuple[str, Callable[[str, Any], Any]]] = {
    int: ("an integer", _integer),
    bool: ("true or false", _boolean),
    float: ("a number", _number),
    str: ("a string", _string),
    Filename: ("a file name", _string),
    Point3: ("three numbers", _triple),
    Matrix4: ("a 4 x 4 matrix", _matrix),
    Texture: ("a number, three numbers, a spectrum or a texture", _colour_or_spectrum),
    Samples: ("a spectrum of wavelengths and values", _samples),
    Tensor: ("an array of numbers", _tensor),
    TriangleMesh: ("a trimesh.Trimesh or a trimesh.Scene", _triangle_mesh),
}
