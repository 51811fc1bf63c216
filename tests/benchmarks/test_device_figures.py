"""The table of a device: its arithmetic, and that it runs from end to end, here on the CPU."""

import json

import pytest

from benchmarks.device_figures import HEADER, Figures, main
from benchmarks.scenes.description import Setting


def test_rates_and_ratios():
    found = Figures("box", "cuda", Setting(100, 4, 6), 2.5, 0.01, 0.03, 0.4, 8 << 20, 10 << 20)
    assert found.samples_per_second == pytest.approx(1e6)  # 40,000 paths in 0.04 s
    cells = [cell.strip() for cell in found.row().strip("|").split("|")]
    assert cells == ["box", "cuda", "100 x 100, 4", "2.50", "0.010 + 0.030", "1.000", "0.100", "8", "10", "1.25"]
    assert len(cells) == len(HEADER.splitlines()[0].strip("|").split("|"))


def test_a_scene_is_measured_on_the_cpu(tmp_path, capsys):
    figures = tmp_path / "figures.json"
    main(["--device", "cpu", "--scene", "cornell-box", "--quick", "--resolution", "64", "--spp", "4", "--rounds", "1",
          "--json", str(figures)])
    found, = json.loads(figures.read_text())
    assert found["setting"] == {"resolution": 64, "spp": 4, "max_depth": 4} and found["device"] == "cpu"
    assert all(found[name] > 0 for name in ("first", "forward", "backward", "on_cpu"))
    assert found["peak"] > 0 and found["predicted"] > 1 << 20
    assert "| cornell-box | cpu | 64 x 64, 4 |" in capsys.readouterr().out
