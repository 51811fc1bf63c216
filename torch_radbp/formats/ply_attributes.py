"""The attributes of vertices and faces in a PLY file, under the names that Mitsuba 3.9 gives them.

    r, g, b or red, green, blue             color
    NAME_r, NAME_g, NAME_b or NAME_r        NAME_color, of three channels or one
    NAME_x, NAME_y, NAME_z or NAME_x        NAME, likewise; and with 1, 2, 3, and with 0, 1, 2

Colours of a floating-point type are linear, as in Mitsuba. Those of an integer type are bytes (0 to 255), of ushort 0 to
65535, in sRGB, as MeshLab, CloudCompare, Open3D and COLMAP write them; Mitsuba takes the bytes as they are, with a warning.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch

from torch_radbp.formats.image import srgb_to_linear

COLOURS = (("r", "g", "b"), ("red", "green", "blue"))
POSTFIXES = {("r", "g", "b"): "_color", ("x", "y", "z"): "", ("1", "2", "3"): "", ("0", "1", "2"): ""}


def attributes_in(names: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Finds attributes among the properties of an element: for each the names of its one or three properties.

    Properties that stand for themselves, or for two or four channels, are none.
    """
    names = list(names)
    attributes: dict[str, tuple[str, ...]] = {}
    for channels in COLOURS:
        if all(name in names for name in channels):
            attributes.setdefault("color", channels)
    stems = dict.fromkeys(name[:-2] for name in names if len(name) > 2 and name[-2] == "_")
    for stem in stems:
        properties = [name for name in names if name[:-2] == stem and name[-2] == "_"]
        for postfixes, ending in POSTFIXES.items():
            channels = tuple(f"{stem}_{postfix}" for postfix in postfixes)
            if properties == [channels[0]] or properties == list(channels):
                attributes[stem + ending] = tuple(properties)
    return attributes


def property_names(name: str, count: int) -> tuple[str, ...]:
    """The names of one or three properties by which the attribute `name` is written."""
    if name == "color" and count == 3:
        return COLOURS[0]
    return tuple(f"{name}_{postfix}" for postfix in ("1", "2", "3"))[:count]


def linear_colours(values: np.ndarray, kinds: Sequence[str]) -> np.ndarray:
    """(N, C) colours of integer properties, decoded from sRGB, or of floating-point ones, as linear values."""
    if any(kind[0] == "f" for kind in kinds):
        return values
    most = np.array([65535.0 if kind == "u2" else 255.0 for kind in kinds])
    return srgb_to_linear(torch.from_numpy(values / most)).numpy()
