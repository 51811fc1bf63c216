"""The bars of the page on speed are those of its table of evidence."""

import pytest

pytest.importorskip("matplotlib", reason="the packages of the documentation are not installed")


def test_bars_have_the_ratios_that_the_table_states():
    from docs.speed_picture import TABLE, soonest

    stated = [float(line.split("**")[1]) for line in TABLE.read_text(encoding="utf-8").splitlines() if line.endswith("** |")]
    found = [of_task["torch_radbp"] / of_task["Mitsuba 3.9.1"] for of_task in soonest().values()]
    assert len(found) == 5 and found == pytest.approx(stated, abs=0.006)
