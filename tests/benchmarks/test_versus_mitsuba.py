"""The comparison runs from end to end where Mitsuba is installed, and compares the same images."""

import json
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.versus_mitsuba import HEADER, MITSUBA, row, z_score

ROUNDS = 8
PARAMETERS = {"white.reflectance.value", "green.reflectance.value", "red.reflectance.value", "light.emitter.radiance.value"}


def result(theirs: list[float], ours: list[float]) -> dict:
    """Figures of two rounds: seconds of the forward pass; the backward pass takes twice as long."""
    def passes(seconds: list[float]) -> list[dict]:
        return [{"forward": value, "backward": 2 * value, "cpu": 4 * value} for value in seconds]

    return {"scene": "box", "first": {MITSUBA: passes([1.0])[0], "compiled": passes([2.0])[0]},
            "passes": {MITSUBA: passes(theirs), "compiled": passes(ours)},
            "gradient_sums": {MITSUBA: [{"a": 1.0}, {"a": 2.0}], "compiled": [{"a": 3.0}, {"a": 4.0}]}}


def test_ratios_are_ours_over_theirs():
    cells = [cell.strip() for cell in row(result([2.0, 4.0], [1.0, 2.0])).strip("|").split("|")]
    assert cells == ["box", "compiled", "3.00 + 6.00", "0.50", "0.50", "0.50", "0.50", "6.0 (8.0)", "3.0 (4.0)",
                     "+2.8 of 1"]
    assert len(cells) == len(HEADER.splitlines()[0].strip("|").split("|"))


def test_z_score_counts_standard_errors():
    """Means 4 and 1 with variance 2 of two samples each: standard error sqrt(2/2 + 2/2)."""
    assert z_score([3.0, 5.0], [0.0, 2.0]) == pytest.approx(3 / 2**0.5)


def test_comparison_runs_on_a_small_scene(tmp_path):
    pytest.importorskip("mitsuba")
    figures = tmp_path / "figures.json"
    command = [sys.executable, "-m", "benchmarks.versus_mitsuba", "--quick", "--eager", "--rounds", str(ROUNDS), "--scene",
               "cornell-box", "--json", str(figures)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2])
    if "libLLVM" in done.stderr:
        pytest.skip("Mitsuba finds no LLVM")
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(figures.read_text())
    assert set(found["passes"]) == {MITSUBA, "eager"}
    for name in found["passes"]:
        assert len(found["passes"][name]) == ROUNDS
        assert set(found["gradient_sums"][name][0]) == PARAMETERS
    for parameter in PARAMETERS:
        ours, theirs = ([sums[parameter] for sums in found["gradient_sums"][name]] for name in ("eager", MITSUBA))
        assert statistics.stdev(theirs) < 0.5 * statistics.fmean(theirs)  # so that the next line tells
        assert abs(z_score(ours, theirs)) < 4.5, parameter
