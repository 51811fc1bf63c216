"""The sheet of jumps has a row of numbers and three panels for each kind, and says when a derivative is wrong."""

import pytest
import torch
from PIL import Image

from benchmarks import jumps
from benchmarks.sheet import MARGIN, PANEL
from tests.derivatives.in_expectation import Effort, Estimate

EFFORT = Effort(spp=16, batches=8, backward=False)


@pytest.mark.parametrize("doubled", [False, True])
def test_a_derivative_that_is_wrong_is_further_off_than_its_noise(doubled, monkeypatch):
    checks = Estimate.checks
    monkeypatch.setattr(jumps.Estimate, "checks", lambda self: checks(self, float(doubled)))
    panels, apart, noise = jumps.drawn(jumps.jumps()["hard shadow"], EFFORT, 1)
    assert [panel.size for panel in panels] == [(PANEL, PANEL)] * 3
    assert 0 < noise < 0.1
    assert apart == pytest.approx(1, abs=0.1) if doubled else apart < 0.1


@pytest.mark.parametrize("name", jumps.jumps())
def test_what_moves_is_in_every_scene(name):
    moving = jumps.jumps()[name]
    tangent = moving.tangent(moving.build())
    assert tangent.dtype == torch.float64 and tangent.abs().max() > 0


def test_kinds_are_chosen_by_parts_of_their_names(tmp_path, monkeypatch, capsys):
    arguments = ["--only", "soft,crease", "--spp", "1", "--batches", "8", "--rounds", "1", "--out", str(tmp_path)]
    monkeypatch.setattr("sys.argv", ["jumps", *arguments])
    jumps.main()
    rows = [line.split("|")[1].strip() for line in capsys.readouterr().out.splitlines()[2:]]
    assert rows == ["crease", "soft shadow"]
    for file, columns in {"jumps.png": jumps.COLUMNS, "jumps_in_short.png": jumps.COLUMNS, "jumps_in_rows.png": 1}.items():
        assert Image.open(tmp_path / file).width == columns * (3 * (PANEL + MARGIN) + MARGIN)
