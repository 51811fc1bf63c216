"""The pictures of a report: before, after and target under one slider, the error with its colour bar, textures."""

import base64
import html
from pathlib import Path
from typing import Any

import torch

from torch_radbp.training.false_colour import false_colour
from torch_radbp.training.recovery.run_folder import RunFolder
from torch_radbp.training.report.curve_colours import srgb_levels

SLIDER_ROLES = ("before", "after", "target")
TEXTURE_ROLES = ("before", "recovered", "true")
BAR_STOPS = 17
OF_VOLUMES = ("Above: slices through the middle, seen along x, y and z. Below: sums along x, y and z. White is the largest "
              "value of the true volume; where that is not known, of each volume itself.")


def pictures_section(folder: RunFolder, summary: dict[str, Any]) -> str:
    """Returns the section of renderings, two large pictures for each sensor."""
    parts = []
    for each in summary["images"]:
        name = f"<h3>{html.escape(each['sensor'])}</h3>" if len(summary["images"]) > 1 else ""
        left = _slider([(role, folder.image_path(each["sensor"], role)) for role in SLIDER_ROLES])
        right = _figure(folder.image_path(each["sensor"], "error"), "error", _error_bar(each["error_scale"]))
        parts.append(f'{name}<div class="pictures">{left}{right}</div>')
    return f"<section><h2>Images</h2>{''.join(parts)}<p class=note>{html.escape(_quality(summary))}</p></section>"


def _quality(summary: dict[str, Any]) -> str:
    """Returns a sentence on how much of the error map is noise of the rendering."""
    text = f"“after” is rendered with {summary['image_spp']} samples per pixel"
    if summary["image_noise"] is None:
        return text + "; its noise is not known, since it was rendered in one pass."
    rmse = (sum(each["rmse"] ** 2 for each in summary["images"]) / len(summary["images"])) ** 0.5
    noise = summary["image_noise"]
    text += f". The root mean square of after − target is {rmse:.2g}, of which {noise:.2g} is noise of the rendering"
    if noise > 0.7 * rmse:
        text += ", and so is most of what the error map shows"
    return text + ". The mean of |after − target|, above, is smaller, since large errors of few pixels count less in it."


def textures_section(folder: RunFolder, summary: dict[str, Any]) -> str:
    """Returns the section of the parameters that are pictures, empty if there is none."""
    parts = []
    for each in summary["parameters"]:
        if each["picture"]:
            figures = "".join(_figure(folder.texture_path(each["name"], role), role) for role in TEXTURE_ROLES)
            note = f"<p class=note>{OF_VOLUMES}</p>" if len(each["shape"]) == 4 else ""
            parts.append(f'<h3>{html.escape(each["name"])}</h3><div class="pictures textures">{figures}</div>{note}')
    return f"<section><h2>Textures and volumes</h2>{''.join(parts)}</section>" if parts else ""


def deviation_figure(path: Path, largest: float) -> str:
    """Returns the picture of a map's standard deviations with the bar of its colours."""
    return _figure(path, "standard deviation", _colour_bar(largest))


def _slider(pictures: list[tuple[str, Path]]) -> str:
    """Returns pictures on top of each other, each wiped over the one before by a slider; the second is shown at first."""
    names = "".join(f"<span>{role}</span>" for role, _ in pictures)
    stack = "".join(_image(path, role) for role, path in pictures)
    move = "this.parentNode.style.setProperty('--at', this.value)"
    return (f'<figure class="compare" style="--at:100"><div class="stack">{stack}</div>'
            f'<input type="range" min="0" max="200" value="100" aria-label="before, after, target" oninput="{move}">'
            f'<div class="ends">{names}</div></figure>')


def _error_bar(scale: float) -> str:
    """Returns the colours of the error map as a bar with numbers."""
    return _colour_bar(scale) + "<small>|after − target| of the channel that differs most, linear radiance</small>"


def _colour_bar(scale: float) -> str:
    """Returns the false colours from 0 to a number, below a picture."""
    colours = false_colour(torch.linspace(0, 1, BAR_STOPS).expand(3, 1, BAR_STOPS), 1.0)[:, 0].T
    stops = ",".join(f"rgb({','.join(map(str, srgb_levels(colour.tolist())))})" for colour in colours)
    return (f'<div class="bar" style="background:linear-gradient(to right,{stops})"></div><div class="ends"><span>0</span>'
            f"<span>{scale / 2:.2g}</span><span>{scale:.2g}</span></div>")


def _figure(path: Path, role: str, below: str = "") -> str:
    if not path.exists():
        return ""
    return f"<figure>{_image(path, role)}{below}<figcaption>{role}</figcaption></figure>"


def _image(path: Path, role: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img alt="{role}" src="data:image/png;base64,{data}">'
