"""What `benchmarks.noise` counts, without Mitsuba."""

import numpy as np
import pytest

from benchmarks.noise import Spread, row
from benchmarks.scenes import ALL, QUICK
from benchmarks.scenes.description import with_filter, without_samplers


def test_the_spread_of_arrays_is_their_variance():
    values, spread = np.random.default_rng(3).normal(5.0, 2.0, (9, 4, 3)), Spread()
    for value in values:
        spread.add(value)
    assert spread.variance == pytest.approx(values.var(0, ddof=1).mean(), rel=1e-12)


def test_the_doubt_of_a_variance_is_how_much_variances_differ():
    numbers = np.random.default_rng(4)
    found = []
    for _ in range(400):
        spread = Spread()
        for value in numbers.normal(5.0, 2.0, (50, 3)):
            spread.add(value)
        found.append((spread.variance, spread.doubt))
    variances, doubts = np.array(found).T
    assert doubts.mean() == pytest.approx(variances.std(ddof=1) / variances.mean(), rel=0.1)


@pytest.mark.parametrize("name", ["cornell-box", "metal-mesh", "relief"])
def test_a_scene_gets_another_filter_and_nothing_else(name, tmp_path):
    scene = ALL[name].make(tmp_path, QUICK)
    assert scene.load().sensors[0].film.rfilter.type == "box"
    changed = with_filter(scene, "mitchell", tmp_path).load()
    assert changed.sensors[0].film.rfilter.type == "mitchell"
    assert [name for name, _ in changed.named_parameters()] == [name for name, _ in scene.load().named_parameters()]


@pytest.mark.parametrize("name", ["cornell-box", "metal-mesh"])
def test_a_scene_that_names_no_sampler_gets_the_default(name, tmp_path):
    scene = ALL[name].make(tmp_path, QUICK)
    assert scene.load().sensors[0].sampler.type == "independent"
    assert without_samplers(scene, tmp_path).load().sensors[0].sampler.type == "ldsampler"


def test_a_row_names_the_noisiest_gradient():
    found = {"variances": {"image": 0.5, "red": 0.8, "green": 1.2, "blue": 0.9}, "time": 0.5,
             "doubts": {"image": 0.1, "red": 0.2, "green": 0.25, "blue": 0.3}}
    assert row("box", 64, 4, found) == (
        "| box | 64 x 64, 4 | 0.50 | 0.90 | 1.20 +- 0.30 `green` | 0.50 | 0.25 | 0.60 +- 0.15 |")
