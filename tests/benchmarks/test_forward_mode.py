"""What `benchmarks.forward_mode` measures, without Mitsuba."""

import pytest
import torch

from benchmarks import forward_mode
from benchmarks.forward_mode import CASES, direction, measure
from benchmarks.scenes import ALL, QUICK


def test_a_row_has_the_time_over_that_of_the_image(monkeypatch):
    monkeypatch.setattr(forward_mode, "ALL", {name: entry._replace(setting=QUICK) for name, entry in ALL.items()})
    name, of, took, ratio, beside = (cell.strip() for cell in measure("pose", 1, beside=False).strip("|").split("|"))
    assert (name, of, beside) == ("pose", "cornell-box, `sensor.to_world`", "")
    assert float(took) >= 0 and float(ratio) > 0


@pytest.mark.parametrize("name", CASES)
def test_every_direction_is_one_of_a_parameter(name, tmp_path):
    case = CASES[name]
    scene = ALL[case.scene].make(tmp_path, QUICK)
    value = scene.load().get_parameter(case.parameter)
    tangent = direction(value, case.parameter)
    assert tangent.shape == value.shape and tangent.abs().max() > 0 and torch.isfinite(tangent).all()
