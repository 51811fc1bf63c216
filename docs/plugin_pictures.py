"""The pictures of plugins: the scene of each category with the example of a plugin.

    python -m docs.plugin_pictures bsdf diffuse out.png      # one of them
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch

import torch_radbp as rb
from docs.plugin_code import python
from docs.plugin_examples import EXAMPLES
from docs.plugin_scenes import surroundings

WIDTH = 256  # at least; images of fewer pixels are enlarged, so that these are seen


def scene_of(category: str, name: str) -> rb.Scene:
    """The scene in which the example of a plugin is drawn, made of the source that its page shows."""
    described = {"type": "scene"} | EXAMPLES[category][name].objects | surroundings(category)
    names: dict[str, Any] = {"rb": rb, "np": np, "torch": torch}
    return rb.load_dict(eval(python(described), names))


def draw(category: str, name: str, picture: Path) -> None:
    """Renders the example of a plugin into a PNG."""
    scene, example = scene_of(category, name), EXAMPLES[category][name]
    if example.output:
        values = rb.Renderer(scene).aovs([example.output], spp=example.samples)[example.output]
        images = (values - values.min()) / (values.max() - values.min())
    else:
        images = rb.render(scene, spp=None if category == "sampler" else example.samples)
    image = torch.cat(list(images), -1)
    factor = -(-WIDTH // image.shape[-1])
    rb.save_image(picture, image.repeat_interleave(factor, -1).repeat_interleave(factor, -2))


if __name__ == "__main__":
    draw(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
