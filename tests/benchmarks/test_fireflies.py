"""What `benchmarks.fireflies` measures."""

import torch

from benchmarks.fireflies import SCENES, largest_pixels, row


def test_large_pixels_are_counted_in_units_of_the_median():
    assert row("plate", torch.tensor([1.0, 2.0, 0.5, 30.0, 2.0])) == "| plate | 2 | 15 | 1 |"


def test_each_seed_has_its_largest_pixel():
    crossing, settings = SCENES["plate through a cube, point light"]
    found = largest_pixels(crossing, settings, spp=4, seeds=3)
    assert found.shape == (3,) and (found > 0).all() and len(found.unique()) == 3
    assert len(SCENES) == 10
