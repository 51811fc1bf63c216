"""Colours of curves: a parameter that is a colour has its own, so that no green line stands for a red wall."""

import colorsys
from typing import Any

import torch

from torch_radbp.formats.image import linear_to_srgb

CHANNELS = ("#c8383a", "#2e8b4f", "#2f6fb5")  # red, green, blue; also x, y, z
PALETTE = ("#3b4a6b", "#b86b1d", "#7a4a9c", "#1f8a8a", "#c23d5f", "#5f6b1f", "#2b8fe0", "#3fae49", "#111111")  # of the rest
GREY = "#8a8f99"
CLOSE = 70.0  # distance of two colours, in levels of 255, below which lines are mixed up
LIGHTNESS = (0.32, 0.5)  # within which a line is seen on white
LEAST_CHROMA = 0.25  # span of the channels, below which a colour is called white, grey or black


def srgb_levels(linear: list[float]) -> list[int]:
    """Returns the 255 levels of a linear RGB colour, cut to [0, 1]."""
    return [round(255 * value) for value in linear_to_srgb(torch.tensor(linear).clamp(0, 1)).tolist()]


def curve_colours(parameters: list[dict[str, Any]]) -> dict[str, str]:
    """Returns a CSS colour for each parameter of a summary, by name; different ones unless there are very many.

    A colour, true or else recovered, is drawn in its own hue; what is no colour, or too close to one that is taken, in the
    next of the palette that is close to none.
    """
    own = {each["name"]: each.get("truth", each["recovered"]) for each in parameters if len(each.get("recovered", [])) == 3}
    chosen: dict[str, str] = {}
    for name in sorted(own, key=lambda name: -_chroma(own[name])):  # of two that are alike, the stronger keeps its hue
        if _is_free(_readable(own[name]), chosen):
            chosen[name] = _readable(own[name])
    for index, name in enumerate(each["name"] for each in parameters if each["name"] not in chosen):
        free = (colour for colour in (*PALETTE, GREY) if _is_free(colour, chosen))
        chosen[name] = next(free, PALETTE[index % len(PALETTE)])
    return {each["name"]: chosen[each["name"]] for each in parameters}


def _chroma(linear: list[float]) -> float:
    levels = srgb_levels(linear)
    return (max(levels) - min(levels)) / 255


def _readable(linear: list[float]) -> str:
    """Returns the hue of a linear RGB colour at a lightness that is seen on white; grey if it has none."""
    if _chroma(linear) < LEAST_CHROMA:
        return GREY
    hue, lightness, saturation = colorsys.rgb_to_hls(*(level / 255 for level in srgb_levels(linear)))
    lightness = min(max(lightness, LIGHTNESS[0]), LIGHTNESS[1])
    return "#" + "".join(f"{round(255 * value):02x}" for value in colorsys.hls_to_rgb(hue, lightness, max(saturation, 0.4)))


def _is_free(colour: str, chosen: dict[str, str]) -> bool:
    return all(_distance(colour, other) >= CLOSE for other in chosen.values())


def _distance(one: str, other: str) -> float:
    return sum((int(one[at:at + 2], 16) - int(other[at:at + 2], 16)) ** 2 for at in (1, 3, 5)) ** 0.5
