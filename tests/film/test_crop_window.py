"""The crop window of a film whose size is assigned."""

import pytest

import torch_radbp as rb
from tests.scenes.sunlit import wall_under_sun
from torch_radbp.film.hdrfilm import HDRFilm


def test_a_window_that_was_not_given_follows_the_size():
    scene = wall_under_sun()
    film = scene.sensors[0].film
    film.width, film.height = 6, 5
    assert (film.crop_width, film.crop_height) == (6, 5)
    assert rb.Renderer(scene, spp=1, max_depth=2)().shape == (1, 3, 5, 6)


def test_a_window_that_was_given_stays_and_must_lie_in_the_image():
    film = HDRFilm(width=12, height=10, crop_offset_x=3, crop_width=5)
    film.width = 9
    assert (film.crop_width, film.crop_height, film.window().columns.size) == (5, 10, 5)
    film.width = 7
    with pytest.raises(ValueError, match=r"the crop window 5 x 10 at \(3, 0\) must lie inside the image of 7 x 10"):
        film.window()
