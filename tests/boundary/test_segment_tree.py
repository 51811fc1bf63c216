"""The tree over segments along which surfaces cross: it finds each as often as its probability says."""

import pytest
import torch

from tests.boundary.random_places import eyes_around, of_each, triangles
from torch_radbp.boundary.curve.intersections import Bodies, intersections
from torch_radbp.boundary.eye.seen_edges import angle_of
from torch_radbp.boundary.eye.segment_tree import ends_of, segment_found, segment_tree
from torch_radbp.boundary.eye.ways_down import ways_down
from torch_radbp.jit.stages import compiled
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene.tables.scene_tensors import extent_of
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import rows

EACH = 64


@pytest.mark.parametrize("stages", [EAGER, compiled()], ids=["eager", "compiled"])
def test_what_is_found_adds_up_to_all_that_is_seen(stages):
    geometry, faces, sizes = triangles(120, 2)
    segments, _ = intersections(stages, geometry, Bodies(faces, sizes, torch.tensor([True, False])))
    eyes, extent = rows(eyes_around(), torch.arange(40)), extent_of(geometry)
    tree, count = segment_tree(stages, geometry, segments).tree, len(segments.triangle)
    ends = (end.map(lambda c: c.repeat(40)) for end in ends_of(geometry, segments))
    angle = angle_of(*ends, of_each(eyes, count), extent).view(40, count)
    sums = []
    for seed in range(32):
        key = SampleKey(torch.tensor(seed, dtype=torch.int32), torch.tensor(-1, dtype=torch.int32))
        ways = ways_down(stages, tree, eyes, key, EACH, extent)
        found = stages(segment_found)(geometry, segments, tree.slots, eyes, ways, extent)
        there = found.edge >= 0
        assert there.double().mean() > 0.5
        assert torch.allclose(found.angle[there], angle[ways.eye.long(), found.edge.long()][there])
        sums.append(torch.zeros(40, dtype=torch.float64).index_add(0, ways.eye.long(), found.times * found.angle) / EACH)
    sums = torch.stack(sums)
    error = sums.std(0) / len(sums) ** 0.5
    off = (sums.mean(0) - angle.sum(1)) / error.clamp_min(1e-9)
    assert count > 100 and (angle.sum(1) > 0).double().mean() > 0.8
    assert (error <= 0.1 * angle.sum(1)).all() and off.abs().max() < 4.5
