"""What `benchmarks.primary` measures."""

import pytest

from benchmarks.primary import CASES, measure, measure_large
from benchmarks.scenes import QUICK


@pytest.mark.parametrize("name", ["ball", "instances"])
def test_a_row_has_the_term_over_the_interior(name):
    found, size, interior, both, ratio = (cell.strip() for cell in measure(name, QUICK, 1).strip("|").split("|"))
    assert (found, int(size)) == (name, QUICK.resolution)
    interior, both, rounded = float(interior), float(both), 0.05  # milliseconds with one digit
    assert interior > 0
    assert float(ratio) == pytest.approx(both / interior - 1.0, abs=rounded * (1 + both / interior) / interior + 0.006)


@pytest.mark.parametrize("name", CASES)
def test_what_moves_is_in_every_scene(name, tmp_path):
    case = CASES[name]
    scene = case.make(tmp_path, QUICK).load()
    assert case.parameters and all(scene.get_parameter(parameter).numel() for parameter in case.parameters)


def test_a_row_of_a_large_mesh_has_its_first_step():
    what, first, step, _ = (cell.strip() for cell in measure_large("both", 1, QUICK, 1).strip("|").split("|"))
    assert what == "both" and float(first) > 0 and float(step) > 0
