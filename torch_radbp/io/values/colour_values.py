"""The values of <rgb> and <spectrum> in a scene description."""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

from torch_radbp.io.values.attribute_values import convert
from torch_radbp.plugin import Texture, no_gradient
from torch_radbp.texture.observer import LINEAR_SRGB_OF_XYZ
from torch_radbp.texture.spectrum import Samples

COLOURS = ("rgb", "spectrum")

# A spectrum of constant power is not neutral in linear sRGB: Mitsuba 3.9 gives this colour to <spectrum value="1"/> of
# an emitter in its RGB modes, and to no other use of a constant spectrum.
EQUAL_ENERGY = tuple(map(sum, LINEAR_SRGB_OF_XYZ))


def is_colour(value: Any) -> bool:
    """True for <rgb> and <spectrum>, which are values rather than objects."""
    return isinstance(value, dict) and value.get("type") in COLOURS


def colour_value(name: str, node: dict[str, Any], of_emitter: bool) -> float | list[float] | Samples | nn.Parameter:
    """Converts {"type": "rgb" or "spectrum", "value": ...} to a number, three numbers or a spectrum.

    Raises:
        ValueError: on other entries, and on wavelengths that do not increase.
    """
    is_spectrum = node["type"] == "spectrum"
    if set(node) != {"type", "value"}:
        files = ", or type and filename" if is_spectrum else ""
        raise ValueError(f"{name}: a {node['type']} has the entries type and value{files}, got {', '.join(map(str, node))}")
    pairs = _pairs(node["value"]) if is_spectrum else None
    if pairs is not None:
        return Samples(*map(tuple, pairs.T.tolist())).check()
    value = convert(name, node["value"], Texture)
    if isinstance(value, nn.Parameter) and is_spectrum and of_emitter:
        raise no_gradient(name)
    if isinstance(value, (list, nn.Parameter)):
        return value
    if not is_spectrum:
        return [value] * 3
    return [value * weight for weight in EQUAL_ENERGY] if of_emitter else value


def _pairs(value: Any) -> Tensor | None:
    """(N, 2) wavelengths and values; None if these are something else."""
    try:
        array = convert("value", value, Tensor)
    except TypeError:
        return None
    return array if array.ndim == 2 and array.shape[1] == 2 else None
