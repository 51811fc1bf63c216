"""The benchmark of ray casting: it finds the rays of paths."""

import time

import pytest

from benchmarks.rays import SCENES, SPP, lines, recorded
from torch_radbp.raycast.direct import DirectCaster
from torch_radbp.raycast.embree import Embree


@pytest.mark.parametrize(("name", "kind"), [("cornell", DirectCaster), ("room", Embree)])
def test_rays_of_every_depth_are_recorded(name, kind):
    recorder = recorded(SCENES[name](8), 8)
    assert isinstance(recorder.caster, kind)
    assert recorder.closest[0].count == 8 * 8 * SPP
    assert len(recorder.closest) == 5 and len(recorder.shadow) == 4
    assert all(0 < query.count <= 8 * 8 * SPP for query in recorder.closest + recorder.shadow)


def test_a_row_for_each_kind_and_depth():
    rows = lines("cornell", ["default", "embree"], resolution=8, rounds=1, clock=time.perf_counter)
    assert [row.split()[2:4] for row in rows] == [[kind, depth] for kind in ("closest", "shadow") for depth in "013"]
