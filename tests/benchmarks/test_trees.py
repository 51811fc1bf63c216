"""The counts of what rays are tested against are of searches that find what casters find."""

import numpy as np
import pytest
import torch

pytest.importorskip("warp")
from benchmarks.instances import field_of
from benchmarks.lbvh import tree_of
from benchmarks.rays import SCENES, recorded
from benchmarks.tree_counts import TwoLevels, counted, given
from benchmarks.trees import TREES, header, queries_of, row, rows_of_field
from torch_radbp.raycast.warp_tree import in_units


@pytest.fixture(scope="module")
def room():
    return recorded(SCENES["room"](12), 12)


@pytest.mark.parametrize("constructor, leaf_size", TREES)
def test_every_tree_has_all_triangles_once_and_finds_the_nearest(constructor, leaf_size, room):
    unit, queries = 0.125, queries_of(room)
    corners = in_units(room.vertices.float()[room.faces.long()], unit)
    tree = tree_of(constructor, leaf_size, corners)
    assert np.array_equal(np.sort(tree.prims), np.arange(len(corners)))
    leaves = tree.links[tree.links[:, 2] == 1]
    assert constructor == "cubql" or (leaves[:, 1] - leaves[:, 0]).max() <= leaf_size
    assert tree.nodes <= 2 * len(corners) - 1
    flat = given(tree, corners)
    counts, t = counted(flat, tree.roots[0], queries["bounced"], unit)
    torch.testing.assert_close(t, room.caster.intersect(queries["bounced"].ray).t, rtol=1e-3, atol=1e-4)
    assert 10 < counts.boxes < 200 and 1 < counts.triangles < 200 and counts.instances == 0
    assert counts.boxes <= counts.boxes_together and counts.triangles <= counts.triangles_together
    counts, t = counted(flat, tree.roots[0], queries["shadow"], unit)
    hidden = room.caster.occluded(*queries["shadow"])
    assert torch.equal(t < queries["shadow"].tmax, hidden) and 0.1 < hidden.float().mean() < 0.9


def test_two_levels_find_the_nearest_and_a_table_has_a_line_for_each_tree():
    scene = field_of(40, 200, 12)
    recorder = recorded(scene, 12)
    query = queries_of(recorder)["camera"]
    levels = TwoLevels.of(recorder.vertices, recorder.faces, recorder.caster.instances, "lbvh", 1)
    counts, t = levels.counted(query)
    hit = recorder.caster.intersect(query.ray)
    met = hit.prim >= 0
    torch.testing.assert_close(t[met], hit.t[met], rtol=1e-4, atol=0)
    assert met.float().mean() > 0.5 and bool((t[~met] > 1e30).all()) and (hit.instance > 0).float().mean() > 0.1
    assert counts.instances >= (hit.instance > 0).float().mean()
    lines = rows_of_field(scene, 12, [("lbvh", 4)])
    assert [line.split("|")[1].strip() for line in lines] == ["tree, triangles in a leaf", "lbvh, 4", "two levels: lbvh, 4"]
    assert lines[0] == header(["camera", "bounced", "shadow"], True) and row("sah, 1", 5, [counts], True).count("|") == 4
