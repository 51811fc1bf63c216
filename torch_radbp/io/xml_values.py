"""Parses the values in scene XML: numbers, vectors, colours and transforms, in all of Mitsuba's spellings."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch

from torch_radbp.io.values import transform
from torch_radbp.io.xml import Element, abridged
from torch_radbp.plugin import SceneError, SceneWarning, nearest
from torch_radbp.pose import look_at

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
UNIT = 1e-3  # how far the length of a rotation axis may be from 1 by rounding
INTEGER = re.compile(r"[+-]?\d{1,18}", re.ASCII)


def check_element(element: Element, required: Iterable[str] = (), optional: Iterable[str] = ()) -> None:
    """Raises SceneError unless the element has all `required` attributes and no others than those and `optional`."""
    required = list(required)
    allowed = [*required, *optional]
    for name in element.attributes:
        if name not in allowed:
            raise element.fail(f"unknown attribute {name!r}; {nearest(name, allowed)}")
    for name in required:
        if name not in element.attributes:
            raise element.fail(f"the attribute {name!r} is missing; expected {', '.join(allowed)}")


def _numbers(element: Element, attribute: str, counts: tuple[int, ...]) -> list[float]:
    """Parses the numbers in an attribute, separated by commas or blanks.

    Raises:
        SceneError: if one cannot be read, or there are not as many as one of `counts`.
    """
    text = element.attributes[attribute]
    tokens = text.replace(",", " ").split()
    for token in tokens:
        if not NUMBER.fullmatch(token) or not math.isfinite(float(token)):
            raise element.fail(f"{attribute} must be made of finite numbers, got {abridged(token)!r} in {abridged(text)!r}")
    if len(tokens) not in counts:
        wanted = " or ".join(map(str, counts))
        raise element.fail(f"{attribute} must have {wanted} numbers, got {len(tokens)} in {abridged(text)!r}")
    return [float(token) for token in tokens]


def vector(element: Element, default: float | None = None, extra: tuple[str, ...] = ()) -> list[float]:
    """Parses a vector from value="1, 2, 3", value="1" or x= y= z=; `default` stands for missing components."""
    check_element(element, extra, ("value", "x", "y", "z"))
    axes = [axis for axis in "xyz" if axis in element.attributes]
    if "value" in element.attributes:
        if axes:
            raise element.fail("give either value or x, y, z, not both")
        values = _numbers(element, "value", (1, 3))
        return values * 3 if len(values) == 1 else values
    if default is None and len(axes) < 3:
        raise element.fail("needs value=\"x, y, z\" or all of x, y and z")
    return [_numbers(element, axis, (1,))[0] if axis in axes else default for axis in "xyz"]


def _integer(element: Element) -> int:
    text = element.attributes["value"].strip()
    if not INTEGER.fullmatch(text):
        raise element.fail(f"value must be an integer, got {abridged(text)!r}")
    return int(text)


def _boolean(element: Element) -> bool:
    text = element.attributes["value"].strip().lower()
    if text not in ("true", "false"):
        raise element.fail(f"value must be true or false, got {abridged(text)!r}")
    return text == "true"


def _rgb(element: Element) -> dict[str, Any]:
    if element.attributes["value"].strip().startswith("#"):
        raise element.fail("hexadecimal colours are not part of Mitsuba 3; write three linear RGB numbers, "
                           "value=\"0.8, 0.2, 0.1\"")
    values = _numbers(element, "value", (1, 3))
    return {"type": "rgb", "value": values * 3 if len(values) == 1 else values}


def _spectrum(element: Element) -> dict[str, Any]:
    text = element.attributes["value"]
    if ":" not in text:
        values = _numbers(element, "value", (1, 3))
        return {"type": "spectrum", "value": values[0]} if len(values) == 1 else {"type": "rgb", "value": values}
    pairs = [pair.split(":") for pair in text.replace(",", " ").split()]
    wrong = next((pair for pair in pairs if len(pair) != 2 or not all(map(NUMBER.fullmatch, pair))), None)
    if wrong is not None:
        raise element.fail(f"value must be one number, or pairs of a wavelength and a value such as \"400:0.1, 700:0.2\", "
                           f"got {abridged(':'.join(wrong))!r} in {abridged(text)!r}")
    return {"type": "spectrum", "value": [(float(wavelength), float(value)) for wavelength, value in pairs]}


SCALARS: dict[str, Callable[[Element], Any]] = {
    "integer": _integer,
    "float": lambda element: _numbers(element, "value", (1,))[0],
    "boolean": _boolean,
    "string": lambda element: element.attributes["value"],
    "rgb": _rgb,
    "spectrum": _spectrum,
}
PROPERTIES = (*SCALARS, "point", "vector", "transform")


def property_value(element: Element) -> Any:
    """Parses a property element: int, float, bool, str, [x, y, z], {"type": "rgb", ...}, or a 4 x 4 array."""
    if element.tag == "transform":
        check_element(element, ("name",))
        return transform_value(element)
    if element.children:
        raise element.children[0].fail(f"cannot stand inside <{element.tag}>, which is a plain value")
    if element.tag in ("point", "vector"):
        return vector(element, extra=("name",))
    if element.tag == "spectrum" and "filename" in element.attributes:
        check_element(element, ("name", "filename"))
        return {"type": "spectrum", "filename": element.attributes["filename"]}
    check_element(element, ("name", "value"))
    return SCALARS[element.tag](element)


def _rotation(element: Element) -> np.ndarray:
    """Parses a rotation; warns of an axis that is not of length one, from which Mitsuba makes no rotation."""
    axis, angle = vector(element, 0.0, extra=("angle",)), _numbers(element, "angle", (1,))[0]
    length = math.hypot(*axis)
    if length == 0 or abs(length - 1.0) <= UNIT:
        return transform.rotate(axis, angle)
    warnings.warn(f"{element}: the axis has the length {length:.4g} and not 1, so that it scales and shears, as in Mitsuba "
                  f"3; for a rotation write value=\"{', '.join(f'{part / length:.6g}' for part in axis)}\"", SceneWarning,
                  stacklevel=2)
    return transform.rotate_unchecked(axis, angle)


def _look_at(element: Element) -> np.ndarray:
    check_element(element, ("origin", "target"), ("up",))
    points = (_numbers(element, name, (3,)) for name in ("origin", "target", "up") if name in element.attributes)
    return look_at(*(torch.tensor(point, dtype=torch.float64) for point in points)).numpy()


def _matrix(element: Element) -> np.ndarray:
    check_element(element, ("value",))
    return transform.affine_matrix(_numbers(element, "value", (9, 16)))


OPERATIONS: dict[str, Callable[[Element], np.ndarray]] = {
    "translate": lambda element: transform.translate(vector(element, 0.0)),
    "rotate": _rotation,
    "scale": lambda element: transform.scale(vector(element, 1.0)),
    "lookat": _look_at,
    "matrix": _matrix,
}


def transform_value(element: Element) -> np.ndarray:
    """Multiplies the operations inside <transform>; the first one listed is applied to the object first."""
    matrix = np.eye(4)
    for operation in element.children:
        if operation.tag not in OPERATIONS:
            raise operation.fail(f"not a transform operation; {nearest(operation.tag, OPERATIONS)}")
        if operation.children:
            raise operation.children[0].fail(f"cannot stand inside <{operation.tag}>")
        try:
            matrix = OPERATIONS[operation.tag](operation) @ matrix
        except SceneError:
            raise
        except ValueError as error:
            raise operation.fail(str(error)) from error
    return matrix
