"""What a path takes on a GPU, in bytes: what it carries, and what is planned for it beside what it takes."""

import pytest

import torch_radbp as rb
from benchmarks.lane_bytes import HEADER, LaneBytes, lane_bytes
from benchmarks.scenes import SCENES
from tests.deep import deep_but
from torch_radbp.rendering.memory import RecordSizes

pytest.importorskip("warp")
SIZE = 32, 65  # pixels a side and samples, more than sequences with memory of their own have
MOVING = RecordSizes(52, 44, 22, 92)


@pytest.mark.parametrize("name", deep_but(["cornell-box"], SCENES))
def test_a_path_carries_few_bytes_and_memory_is_planned_closely(name):
    """A state is a ray, throughput, density, two random keys and a place; keys are not kept, origins only where something
    moves. Of a bounce stay hit, order and two flags."""
    found = lane_bytes(name, *SIZE)
    still = RecordSizes(6 * 4 + 3 * 4 + 4 + 2 * 4 + 4, 3 * 4 + 3 * 4 + 4 + 4, 4 * 4 + 4 + 2, 3 * 4)
    others = {"metal-mesh-vertices": MOVING, "material-room": still._replace(step=still.step + 1)}
    assert found.records == others.get(name, still) and 0.95 <= found.plan_over_peak <= 1.2


@pytest.mark.deep
@pytest.mark.parametrize("settings", [
    {"share_samples": True}, {"adjoint": rb.MemoizedAdjoint("log", keep_hits=False)}], ids=str)
def test_so_it_is_with_other_settings(settings):
    assert 0.95 <= lane_bytes("cornell-box", *SIZE, **settings).plan_over_peak <= 1.3


def test_a_row_has_a_cell_for_each_head():
    row = LaneBytes("box", RecordSizes(52, 32, 22, 12), 8, 300.0, 600.0, 660.0).row()
    assert row == "| box | 52 | 32 | 22 | 12 | 8 | 300 | 600 | 660 | 1.10 |"
    assert row.count("|") == HEADER.splitlines()[0].count("|")
