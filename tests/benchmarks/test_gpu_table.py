"""The table of a card: its arithmetic, and that it runs from end to end, here on the CPU."""

import json
from types import SimpleNamespace

import pytest

from benchmarks import gpu_table
from benchmarks.gpu_table import HEADER, MITSUBA, OURS, bounds_of, covered, graphs_share, main, row, summary
from torch_radbp.jit.nvidia.driver import Driver
from torch_radbp.jit.nvidia.gpu import Gpu


def size(resolution: int, spp: int, ours: float, theirs: float, first: bool = False) -> dict:
    """Figures of five passes, of which the backward one takes three times as long."""
    passes = {name: [{"forward": each * seconds, "backward": 3 * each * seconds, "cpu": 1.0} for each in (1, 9, 2, 1, 2)]
              for name, seconds in ((OURS, ours), (MITSUBA, theirs))}
    return {"setting": {"resolution": resolution, "spp": spp, "max_depth": 4}, "passes": passes,
            "first": {name: own[0] for name, own in passes.items()} if first else None, "kernels": 0.9, "graphs": 0.5,
            "peak": 100 << 20, "planned": 130 << 20,
            "gradient_sums": {OURS: [{"a": 3.0}, {"a": 5.0}], MITSUBA: [{"a": 0.0}, {"a": 2.0}]}}


def noise(image: float, *gradients: float) -> dict:
    """Variances, those of Mitsuba all 2."""
    ours = {"image": image} | {f"gradient {number}": value for number, value in enumerate(gradients)}
    found = {OURS: ours, MITSUBA: dict.fromkeys(ours, 2.0)}
    return {"setting": {"resolution": 128, "spp": 4, "max_depth": 4}, "noise": found}


def test_figures_stand_beside_their_bounds():
    figures = [size(512, 64, 0.1, 0.2, first=True), size(128, 4, 0.3, 0.5), noise(1.0, 1.0, 0.2, 4.0)]
    found = {bound.name: bound for bound in bounds_of(figures) if bound.name != "forward"}
    assert {name: bound.figure for name, bound in found.items()} == pytest.approx({
        "both": 0.5, "both, small": 0.6, "first call": 0.5, "kernels": 0.9, "plan / peak": 1.3, "noise of the image": 0.3,
        "noise of gradients": 0.3})  # half of the variance in 0.6 of the time
    assert {name for name, bound in found.items() if bound.is_met} == {"first call", "kernels", "noise of the image",
                                                                     "noise of gradients"}
    said = summary({"box": figures})
    assert "| forward | 0.8 | 2 of 2 | 0.60 box |" in said and "| plan / peak | 1.2 | 0 of 1 | 1.30 box |" in said


def test_a_row_has_a_cell_for_each_head():
    cells = [cell.strip() for cell in row("box", size(512, 64, 0.1, 0.2, first=True)).strip("|").split("|")]
    assert cells == ["box", "512 x 512, 64", "0.4000 + 1.2000", "0.2000 + 0.6000", "0.50", "0.50", "0.50", "0.8, 0.4",
                     "90 %", "50 %", "100", "1.30", "+2.1"]
    assert len(cells) == len(HEADER.splitlines()[0].strip("|").split("|"))


def test_kernels_beside_each_other_count_once():
    assert covered([(5.0, 6.0), (0.0, 2.0), (1.0, 4.0), (1.5, 3.0)]) == 5.0 and covered([]) == 0.0


def test_graphs_are_counted_among_sequences(monkeypatch):
    monkeypatch.setattr(Gpu, "launch_all", lambda *given: None)
    monkeypatch.setattr(Driver, "play", lambda *given: None)
    peer = SimpleNamespace(run=lambda seed: [Gpu.launch_all(None) for _ in range(4)] + [Driver.play(None, None)])
    assert graphs_share(peer, 0) == 0.25 and graphs_share(SimpleNamespace(run=lambda seed: None), 0) == 0.0


def test_it_runs_from_end_to_end_and_saves_what_it_finds(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    figures = tmp_path / "table.json"
    assert main(["--device", "cpu", "--quick", "--rounds", "2", "--scene", "cornell-box", "--json", str(figures)]) == 0
    found, = json.loads(figures.read_text())
    *sizes, last = found["figures"]
    assert found["scene"] == "cornell-box" and [each["setting"]["resolution"] for each in sizes] == [32, 16]
    assert all(len(own) == 2 for each in sizes for own in each["passes"].values()) and last["noise"][OURS]["image"] > 0
    assert capsys.readouterr().out.count("| cornell-box | ") == 2


def test_what_takes_too_long_is_cut_off_and_said(capsys, monkeypatch):
    monkeypatch.setattr(gpu_table, "in_own_process", lambda name, arguments, seconds: iter([size(512, 64, 0.1, 0.2)]))
    assert main(["--scene", "principled-interior", "cornell-box"]) == 1
    said = capsys.readouterr().out
    assert "not measured to the end: cornell-box, principled-interior" in said  # the longest comes last
    assert "| forward | 0.8 | 2 of 2 |" in said
