"""A lamp with a straight edge, and what the columns of an image of it are."""

from __future__ import annotations

import math
from typing import Any

from torch import Tensor

import torch_radbp as rb
from tests.scenes import GLOW, load, rectangle, sensor

SIZE = 16  # pixels


def columns_at_an_edge(**film: Any) -> tuple[Tensor, float]:
    """The means of columns, of 4096 samples each, of a lamp that fills x < 0; and its edge, in pixels from the left."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, **film}
    lamp = rectangle((-10, 0, 0), (10.0, 20.0, 1.0), emitter=GLOW)
    scene = load(sensor=sensor(SIZE, (0.03, 0, 4), (0.03, 0, 0), 40, film=film), lamp=lamp)
    columns = rb.render(scene, spp=256, max_depth=1)[0, 0].mean(0)  # all rows show the same
    return columns, SIZE / 2 - 0.03 * SIZE / (2 * 4 * math.tan(math.radians(20)))
