"""The tree over edges: it rules out no silhouette, and finds each as often as its probability says; so does trying edges."""

import pytest
import torch

import torch_radbp as rb
from tests.boundary.random_places import eyes_around, of_each
from tests.deep import deep
from tests.scenes import diffuse, load, sensor
from tests.scenes.meshes import wavy
from tests.scenes.shadows import CUBE, FLOOR
from torch_radbp.boundary.curve.edge_order import GROUP
from torch_radbp.boundary.curve.geometry import Geometry, in_world
from torch_radbp.boundary.eye.edge_tree import angle_of_node, rounded
from torch_radbp.boundary.eye.edges_tried import FEWEST, edges_tried, eyes_for_each
from torch_radbp.boundary.eye.eyes import Eyes
from torch_radbp.boundary.eye.seen_edges import Casting, angle_seen, edge_found, places_seen
from torch_radbp.boundary.eye.ways_down import ways_down
from torch_radbp.boundary.terms import hidden_light
from torch_radbp.jit.stages import compiled
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene.tables.scene_tensors import extent_of
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Vec3, dot, rows

GREY_FLOOR = FLOOR | {"bsdf": diffuse(0.5, 0.5, 0.5)}
TURNED = {"type": "mesh", "bsdf": diffuse(0.5, 0.6, 0.4),
          "faces": torch.tensor([[0, 1, 2], [1, 2, 3], [2, 3, 4], [0, 1, 4]]),
          "vertex_positions": torch.tensor([[0.0, 0, 0], [1, 0, 0.2], [0, 1, 0.1], [1, 1, 0.5], [0.3, 1.6, 0.2]]) - 0.5}

BODIES = {"floor and cube": {"floor": GREY_FLOOR, "cube": CUBE}, "waves": {"waves": wavy(), "floor": GREY_FLOOR},
          "turned triangles": {"mesh": TURNED, "cube": CUBE}}


@pytest.fixture(params=[(name, dtype) for name in BODIES for dtype in (torch.float64, torch.float32)], ids=str,
                scope="module")
def casting(request) -> tuple[Geometry, Casting]:
    """The geometry of a scene and its edges with their tree, as a rendering has them."""
    found, (name, dtype) = [], request.param

    def noted(stages, geometry, casting, *_):
        found.append((geometry, casting))

    sky = {"type": "constant", "radiance": 1.0}
    scene = load(sensor=sensor(4, (0, 0, 3)), sky=sky, **BODIES[name]).to(dtype)
    pose = torch.eye(4, dtype=dtype)[None, 0].expand(4, 4) * 0.1
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hidden_light, "places_seen", noted)
        rb.jvp(scene, {"sensor.to_world": pose}, spp=4, max_depth=2, compile=False)
    return found[0]


def angles(geometry: Geometry, casting: Casting, eyes: Eyes) -> torch.Tensor:
    """(M, S) under which each eye sees the edge in each slot."""
    slots = casting.tree.slots
    seen = angle_seen(geometry, casting.outline, slots.repeat(len(eyes.w)), of_each(eyes, len(slots)), extent_of(geometry))
    return seen.view(len(eyes.w), len(slots))


def test_every_edge_has_one_slot(casting):
    slots = casting[1].tree.slots
    assert slots[slots >= 0].sort().values.tolist() == list(range(len(casting[1].outline.crease)))


def test_no_silhouette_is_ruled_out(casting):
    geometry, (_, tree) = casting
    eyes = eyes_around()
    seen = angles(geometry, casting[1], eyes) > 0
    assert seen.any(1).float().mean() > 0.5
    below = seen.view(len(eyes.w), -1, GROUP).any(2)
    for nodes in reversed(tree.levels):
        count = len(nodes.bend)
        below = below.view(len(eyes.w), count, -1).any(2)
        own, extent = (rounded(part, nodes.bend.dtype) for part in (of_each(eyes, count), extent_of(geometry)))
        estimate = angle_of_node(rows(nodes, torch.arange(count).repeat(len(eyes.w))), own, extent)
        assert (estimate.view(-1, count)[below] > 0).all(), count


def test_slabs_hold_all_edges_below_and_are_no_thicker_than_boxes(casting):
    geometry, (outline, tree) = casting
    ends = in_world(geometry, rows((outline.edges.a, outline.edges.b), tree.slots.clamp_min(0)), outline.instance)
    exists = (tree.slots >= 0).view(1, -1)
    for node in tree.levels:
        first = len(node.bend)
        each = [part.view(first, 1).double() for part in (*node.axis, node.plane, node.thickness)]
        for p in ends:
            along = sum(axis * part.view(first, -1) for axis, part in zip(each, p))
            assert ((along - each[3]).abs() <= each[4] + 1e-5)[exists.view(first, -1)].all(), first
        filled = exists.view(first, -1).any(1)
        assert filled.any()
        most = dot(node.axis.map(torch.abs), (node.high - node.low) * 0.5)
        assert (node.thickness <= most + 1e-5)[filled].all(), first


@pytest.mark.parametrize("stages", [deep(EAGER), compiled()], ids=["eager", "compiled"])
def test_what_is_found_adds_up_to_all_that_is_seen(casting, stages):
    geometry, casting = casting
    eyes, slots, sums = rows(eyes_around(), torch.arange(40)), casting.tree.slots, []
    angle = angles(geometry, casting, eyes)
    slot = slots.argsort()[(slots < 0).sum():]  # of each edge
    for seed in range(64):  # of few, rare edges are not among those found
        key = SampleKey(torch.tensor(seed, dtype=torch.int32), torch.tensor(-1, dtype=torch.int32))
        found = places_seen(stages, geometry, casting, eyes, key, 64, 4096)
        seen = angle[found.eye.long(), slot[found.edge.long()]]
        assert (seen > 0).all()
        sums.append(torch.zeros(len(eyes.w), dtype=torch.float64).index_add(0, found.eye.long(), found.times * seen))
    sums = torch.stack(sums)
    error = sums.std(0) / len(sums) ** 0.5
    off = (sums.mean(0) - angle.sum(1)) / error.clamp_min(1e-9)
    assert angle.sum() > 1 and (error < 0.2 * angle.sum(1) + 1e-2).all() and off.abs().max() < 5


def test_places_are_no_more_than_ways_that_found_an_edge(casting):
    geometry, casting = casting
    key = SampleKey(torch.tensor(3, dtype=torch.int32), torch.tensor(-1, dtype=torch.int32))
    eyes = rows(eyes_around(), torch.arange(40))
    ways = ways_down(EAGER, casting.tree, eyes, key, 4, extent_of(geometry))
    found = EAGER(edge_found)(geometry, casting.outline.slots, eyes, ways, extent_of(geometry))
    most = int((found.edge >= 0).sum())
    assert 0 < most < 4 * len(eyes.w)
    assert [len(places_seen(EAGER, geometry, casting, eyes, key, 4, count).edge) for count in (most // 2, 4096)] == [
        most // 2, most]


@pytest.mark.parametrize("stages", [deep(EAGER), compiled()], ids=["eager", "compiled"])
def test_edges_that_are_tried_add_up_to_all_that_is_seen(casting, stages):
    geometry, casting = casting
    eyes, outline, sums = rows(eyes_around(), torch.arange(40)), casting.outline, []
    edges = len(outline.crease)
    slot = casting.tree.slots.argsort()[-edges:]  # of each edge
    angle = angles(geometry, casting, eyes)[:, slot]
    for seed, each in [(0, len(eyes.w)), *((seed, FEWEST) for seed in range(1, 64))]:
        key = SampleKey(torch.tensor(seed, dtype=torch.int32), torch.tensor(-1, dtype=torch.int32))
        found, eye = edges_tried(stages, geometry, outline, eyes, key, each, extent_of(geometry))
        assert len(eye) == len(found.edge) > 0
        assert torch.allclose(found.angle, angle[eye.long(), found.edge.long()], rtol=1e-6)
        sums.append(torch.zeros(edges, dtype=torch.float64).index_add(0, found.edge.long(), found.times * found.angle))
    whole, sums = angle.sum(0), torch.stack(sums)
    assert whole.sum() > 1 and torch.allclose(sums[0], whole, rtol=1e-6)  # each from every eye
    error = sums[1:].std(0) / len(sums[1:]) ** 0.5
    off = (sums[1:].mean(0) - whole) / error.clamp_min(1e-9)
    assert (error < 0.2 * whole + 1e-2).all() and off.abs().max() < 5


@pytest.mark.parametrize("casting", [("waves", torch.float64)], ids=str, indirect=True)
def test_of_small_lights_the_edges_that_they_see_as_silhouettes_are_tried_most(casting):
    geometry, (outline, _) = casting
    place = torch.randn(512, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    one = torch.ones(512, dtype=torch.float64)
    eyes = Eyes(Vec3.of(0.01 * place + torch.tensor([2.0, 1.5, 3.0])), one, Vec3(0 * one, 0 * one, 0 * one), one, 0 * one)
    key = SampleKey(torch.tensor(5, dtype=torch.int32), torch.tensor(-1, dtype=torch.int32))
    found, eye = edges_tried(EAGER, geometry, outline, eyes, key, 64, extent_of(geometry))
    assert (found.times < 512 / 64).double().mean() > 0.9  # each stands for fewer than if all were tried alike
    assert len(torch.stack([found.edge, eye]).unique(dim=1).T) == len(eye)  # none twice


def test_edges_are_tried_from_as_many_eyes_as_ways_would_look_at_edges(casting):
    eyes, outline, looks = eyes_around(1000), casting[1].outline, 4
    each = eyes_for_each(outline, eyes, looks)
    assert each == min(len(eyes.w), looks * GROUP * len(eyes.w) // len(outline.crease)) >= FEWEST
    few = rows(eyes, torch.arange(FEWEST))
    assert eyes_for_each(outline, few, looks) in (0, FEWEST)
    assert eyes_for_each(outline, few, 0) == 0
