"""The room of lamps: both ways of picking lights render it."""

import numpy as np
import pytest

from benchmarks.lamps import KINDS, ours, room


@pytest.mark.parametrize("kind", KINDS)
def test_both_choices_render_the_room(kind):
    images = [ours(room(9, kind, 1), way)(1, 16) for way in ("uniform", "tree")]
    for image in images:
        assert image.shape == (64, 64, 3) and np.isfinite(image).all() and image.mean() > 0.01
    assert not np.array_equal(*images) and abs(np.log(images[0].mean() / images[1].mean())) < 0.2
