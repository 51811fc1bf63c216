"""Draws the picture that README and the pages begin with: ``python -m benchmarks.front_page``.

Three of the recipes are run, into runs/front_page, where they are not there yet. What they begin with, what is true and what
they recovered is rendered anew, larger than the images that they recovered it from; the fourth column is a derivative of the
true image, by forward mode.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from safetensors.torch import load_file
from torch import Tensor

import torch_radbp as rb
from torch_radbp.check.statistics import BRIGHTEST, quantile
from torch_radbp.formats.image import linear_to_srgb
from torch_radbp.training.cli import app
from torch_radbp.training.commands.bundled import recipe_path
from torch_radbp.training.false_colour import signed_colour
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.problem import Recovery

SIZE, MARGIN, LABEL = 240, 8, 30  # pixels
SAMPLES, SAMPLES_OF_DERIVATIVE = 400, 1024
PICTURE, RUNS = Path("assets/pictures/front_page.webp"), Path("runs/front_page")


class Task(NamedTuple):
    """A recipe, and the parameter with a tangent whose derivative is drawn."""

    recipe: str
    title: str
    view: str | None
    parameter: str
    tangent: Callable[[Tensor], Tensor]
    derivative: str


def upwards(to_world: Tensor) -> Tensor:
    """The tangent of a pose that moves up."""
    tangent = torch.zeros_like(to_world)
    tangent[2, 3] = 1.0
    return tangent


def brightest(texels: Tensor) -> Tensor:
    """The tangent that adds to the brightest texels of an environment map what they have."""
    return torch.where(texels > 0.5 * texels.max(), texels, 0.0)


TASKS = (
    Task("cornell_reflectance", "materials", None, "green.reflectance.value", torch.ones_like, "by the green wall's colour"),
    Task("figurine_pose", "a pose, with its shadow", None, "figurine.to_world", upwards, "by its height"),
    Task("sky", "an environment", "front", "sky.data", brightest, "by the sun's radiance"),
)


def recovered(recipe: str) -> dict[str, Tensor]:
    """The parameters that a run of a recipe recovered, by name."""
    folder = RUNS / recipe
    if not (folder / "parameters.safetensors").exists():
        app(["optimize", recipe, "--out", str(folder)], standalone_mode=False)
    return load_file(folder / "parameters.safetensors")


def row_of(task: Task) -> list[Tensor]:
    """(3, SIZE, SIZE) sRGB of what a recipe begins with, what is true, what it recovered, and a derivative."""
    recipe = read_recipe(recipe_path(Path(task.recipe)), [], False)
    initial = {parameter.name: parameter.before for parameter in Recovery(recipe).parameters}
    images = []
    for values in (initial, {}, recovered(task.recipe)):
        scene = rb.load(recipe.scene, resolution=SIZE)
        for name, value in values.items():
            scene.get_parameter(name).data.copy_(value)
        images.append(linear_to_srgb(rb.render(scene, spp=SAMPLES, sensors=task.view)[0].detach()))
    scene = rb.load(recipe.scene, resolution=SIZE)
    tangent = task.tangent(scene.get_parameter(task.parameter).detach())
    derivative = rb.jvp(scene, {task.parameter: tangent}, spp=SAMPLES_OF_DERIVATIVE, sensors=task.view)[0].sum(0)
    return [*images, linear_to_srgb(signed_colour(derivative, float(quantile(derivative.abs(), BRIGHTEST))))]


def draw(rows: list[tuple[Task, list[Tensor]]]) -> Image.Image:
    """The rows below each other, each image with its title."""
    size = (4 * (SIZE + MARGIN) + MARGIN, len(rows) * (SIZE + LABEL + MARGIN) + MARGIN)
    sheet = Image.new("RGB", size, "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    for number, (task, images) in enumerate(rows):
        top = MARGIN + number * (SIZE + LABEL + MARGIN)
        titles = f"{task.title}: before", "true", "recovered", task.derivative
        for column, (title, image) in enumerate(zip(titles, images)):
            left = MARGIN + column * (SIZE + MARGIN)
            pen.text((left, top + 6), title, "black", font)
            pixels = (image.clamp(0, 1) * 255).round().permute(1, 2, 0).cpu().numpy().astype(np.uint8)
            sheet.paste(Image.fromarray(pixels), (left, top + LABEL))
    return sheet


if __name__ == "__main__":
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    draw([(task, row_of(task)) for task in TASKS]).save(PICTURE, quality=90)
    print(f"wrote {PICTURE}")
