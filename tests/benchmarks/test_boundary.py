"""What `benchmarks.boundary` measures, without Mitsuba."""

import math

import numpy as np
import pytest

from benchmarks.boundary import cost
from benchmarks.boundary.__main__ import rows
from benchmarks.boundary.error import Mean, judged, while_due
from benchmarks.boundary.projected import TERMS, projected
from benchmarks.boundary.scenes import SCENES, VERTICES
from benchmarks.peers import Ours
from benchmarks.scenes.description import Setting


@pytest.mark.parametrize("name", SCENES)
def test_all_vertices_move_in_every_direction(name, tmp_path):
    make, depth = SCENES[name]
    scene, directions, step = make(tmp_path, Setting(8, 1, depth))
    vertices = scene.load().get_parameter(VERTICES)
    assert directions.shape == (6, *vertices.shape) and step > 0
    assert (np.abs(directions).max((1, 2)) > 0.1).all() and np.abs(directions).max() < 2.0


def test_gradients_are_taken_along_the_directions(tmp_path):
    make, depth = SCENES["shadow art"]
    moving = make(tmp_path, Setting(8, 4, depth))
    peer = Ours(moving.scene, compiled=True, terms=TERMS)
    found = projected(peer, moving)(2).gradient
    gradient = peer.gradients_found()[VERTICES]
    expected = [float((direction * gradient).sum()) for direction in moving.directions]
    assert np.abs(found).max() > 0 and found == pytest.approx(expected, rel=1e-4, abs=1e-6 * np.abs(found).max())


def test_the_error_is_variance_and_bias_over_the_size_of_the_reference():
    random = np.random.default_rng(2)
    reference = Mean(np.array([3.0, 4.0]), np.zeros(2))
    gradients = list(random.normal([3.5, 4.0], 0.1, (400, 2)))
    found = judged(gradients, [0.5, 0.7, 0.6], Mean.of(gradients), reference)
    assert found["seconds"] == 0.6
    assert found["passes"] == 400 and found["spread"] == pytest.approx(found["variance"] / 400**0.5, rel=0.2)
    assert found["variance"] == pytest.approx(0.02 / 25, rel=0.2) and found["bias"] == pytest.approx(0.25 / 25, rel=0.1)


def test_rows_name_the_best_split_and_what_ours_is_over_it():
    def one(variance: float) -> dict:
        return {"passes": 12, "seconds": 0.1, "variance": variance, "spread": 0.1 * variance, "bias": 0.0}

    found = {"scene": "room", "references": {"theirs beside ours": {"off": 0.01, "by_chance": 0.02, "z": 1.0}},
             "renderers": {"ours": one(1.0), "Mitsuba, defaults": one(2.0), "Mitsuba, equal": one(8.0),
                           "Mitsuba, guided, many": one(4.0)}}
    lines = rows(found)
    assert lines[2] == "| room | theirs beside ours | 0.0100 | 0.0200 | 1.0 |"
    assert [line.endswith("(best split) |") for line in lines] == [False] * (len(lines) - 1) + [True]
    assert "| 0.250 +- 0.035 (best split) |" in lines[-1] and "| 0.500 +- 0.071 |" in lines[-3]


def test_passes_end_when_it_is_late_but_not_before_the_fewest():
    assert list(while_due(range(-1, 9), 4, -math.inf)) == [-1, 0, 1, 2]
    assert list(while_due(range(3), 1, math.inf)) == [0, 1, 2]


def test_costs_are_over_the_interior():
    assert cost.row({"scene": "room", "interior": 100.0, "primary": 120.0, "all": 190.0}) == (
        "| room | 100.0 | 190.0 | 0.90 | 0.20 | 0.70 |")
