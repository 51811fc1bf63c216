"""Compiled gradients of what moves, in double precision: those of the eager functions.

Compilation takes a minute or two where the compiler's cache is empty.
"""

import pytest
import torch

import torch_radbp as rb
from tests.gradients import assert_informative, image_and_gradients, relative_error
from tests.scenes import diffuse, load, rectangle, rgb, sensor

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
NAMES = ("plate.to_world", "floor.bsdf.reflectance.value", "lamp.position", "sensor.x_fov")
SETTINGS = {"spp": 16, "max_depth": 3, "rr_depth": 100}


def scene(dtype: torch.dtype) -> rb.Scene:
    """A plate above a floor, under a point of light."""
    return load(dtype, sensor=sensor(8, (0.3, 0.4, 3.5)),
                plate=rectangle((0.1, 0, 0), 1.2, (1, 0.3, 0.2), -40, bsdf=diffuse(0.8, 0.4, 0.2)),
                floor=rectangle((0, -1, 0), 4.0, (1, 0.2, 0.1), -80, bsdf=diffuse(0.5, 0.6, 0.7)),
                lamp={"type": "point", "position": [0.7, 1.4, 1.9], "intensity": rgb(9, 8, 7)})


@pytest.mark.parametrize("sampling", ["hybrid", "attached"])
def test_compiled_gradients_are_the_eager_ones(sampling):
    expected, gradients = image_and_gradients(scene(torch.float64), NAMES, sampling=sampling, **SETTINGS)
    image, found = image_and_gradients(scene(torch.float64), NAMES, sampling=sampling, compile=True, **SETTINGS)
    assert_informative(expected, list(gradients))
    assert relative_error(image, expected) < 1e-12
    for name, gradient, wanted in zip(NAMES, found, gradients):
        assert relative_error(gradient, wanted) < 1e-9, name
