"""Instances on GPUs: a tree for each group under a tree over the instances finds what one tree of copies does.

On Warp's CPU device, which runs the same kernels.
"""

import math
import pickle
from collections.abc import Sequence
from itertools import accumulate

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.gradients import unwarned_renderer
from tests.raycast.meshes import mesh, random_rays
from tests.scenes import diffuse
from torch_radbp import raycast
from torch_radbp.interface.instances import Instances, expanded
from torch_radbp.raycast import Ray, RayCaster, make_caster
from torch_radbp.raycast.expanded import ExpandedCaster
from torch_radbp.raycast.instance_tree import EMPTY, instance_tree
from torch_radbp.scene.tables.placement import boxes
from torch_radbp.tensors.vec import Vec3

pytest.importorskip("warp")
DTYPES = (torch.float32, torch.float64)
COUNTS = (1, 40, 3)  # instances of each group


def turned(count: int, generator: torch.Generator) -> Tensor:
    """(count, 3, 3) random rotations, every second with a reflection."""
    turn = torch.linalg.qr(torch.randn(count, 3, 3, generator=generator)).Q
    sign = torch.where(torch.arange(count) % 2 == 0, 1.0, -1.0)
    return turn * (sign * torch.linalg.det(turn))[:, None, None]


def scene_of(parts: Sequence[tuple[Tensor, Tensor]], poses: Sequence[Tensor], own: bool = True) -> tuple[Tensor, Tensor,
                                                                                                         Instances]:
    """Vertices, faces and instances of a scene: a mesh of its own, if it has one, then a group for each other mesh."""
    vertices, faces = [0], [0]
    for points, corners in parts:
        vertices.append(vertices[-1] + len(points))
        faces.append(faces[-1] + len(corners))
    joined = torch.cat([corners + first for (_, corners), first in zip(parts, vertices)])
    counts = tuple(accumulate(map(len, poses), initial=0))
    around = boxes([points for points, _ in parts[own:]], poses)
    return torch.cat([points for points, _ in parts]), joined, Instances(
        torch.cat(list(poses)), tuple(vertices[own:]), tuple(faces[own:]), counts, around)


def field(dtype: torch.dtype, own: bool = True) -> tuple[Tensor, Tensor, Instances]:
    """A box, or none, around instances of three groups: turned, stretched along their axes, and some of them mirrored."""
    generator = torch.Generator().manual_seed(2)
    poses = torch.cat([turned(sum(COUNTS), generator) * (0.1 + 0.4 * torch.rand(sum(COUNTS), 1, 3, generator=generator)),
                       3 * torch.rand(sum(COUNTS), 3, 1, generator=generator) - 1.5], 2)
    around, *groups = (mesh(name, dtype) for name in ("box", "soup", "sphere", "box"))
    parts = [(2 * around[0], around[1]), *groups]
    return scene_of(parts if own else groups, poses.to(dtype).split(COUNTS), own)


def casters(vertices: Tensor, faces: Tensor, instances: Instances, monkeypatch) -> tuple[RayCaster, RayCaster]:
    """One that keeps the triangles of groups once, and one that copies them."""
    copies = make_caster("warp", vertices, faces, None, instances)
    monkeypatch.setattr(raycast, "MOST_COPIED", 0)
    groups = make_caster("warp", vertices, faces, None, instances)
    assert isinstance(copies, ExpandedCaster) and groups.recorded_as[-1] == "closest_of_groups"
    return groups, copies


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("own", [True, False])
def test_hits_are_those_of_copies(own, dtype, monkeypatch):
    """Beside plain shapes and without: the triangle, the instance, the place on it, and which shadows fall."""
    groups, copies = casters(*field(dtype, own), monkeypatch)
    ray = random_rays(20_000, dtype, within=1.6)
    found, expected = groups.intersect(ray), copies.intersect(ray)
    assert set(expected.instance[expected.prim >= 0].tolist()) >= set(range(0 if own else 1, sum(COUNTS) + 1))
    same = (found.prim == expected.prim) & (found.instance == expected.instance)
    assert (~same).sum() < 5  # rays towards edges
    assert (found.t - expected.t)[~same].abs().max() < 1e-4 if not same.all() else True
    assert found.t.dtype == found.u.dtype == dtype and found.prim.dtype == found.instance.dtype == torch.int32
    # Rounding, the more the closer a triangle is to edge-on.
    torch.testing.assert_close(found.t[same], expected.t[same], rtol=0, atol=3e-5 if dtype == torch.float32 else 1e-12)
    for place, other in zip(found[1:3], expected[1:3]):
        assert (place - other)[same].abs().median() < 1e-6
        assert (place - other)[same].abs().max() < (3e-3 if dtype == torch.float32 else 1e-10)
    tmax = torch.rand(20_000, generator=torch.Generator().manual_seed(1)).to(dtype)
    hidden, wanted = groups.occluded(ray, tmax), copies.occluded(ray, tmax)
    assert 0.2 < wanted.double().mean() < 0.9 and (hidden != wanted).sum() < 5


def test_rays_that_are_none_miss(monkeypatch):
    groups, _ = casters(*field(torch.float32), monkeypatch)
    broken = [(0.0, 0.0, 0.0), (math.nan, 1.0, 0.0), (1.0, math.inf, 0.0), (1e-30, 0.0, 1e-30), (1e30, 0.0, -1e30)]
    ray = Ray(Vec3.of(torch.zeros(5, 3)), Vec3.of(torch.tensor(broken)))
    hit = groups.intersect(ray)
    assert (hit.prim[:3] == -1).all() and not hit.instance[:3].any() and not hit.t[:3].any()
    unit = groups.intersect(Ray(ray.o, Vec3.of(torch.tensor([(1.0, 0.0, 1.0), (1.0, 0.0, -1.0)]).repeat(3, 1)[1:])))
    assert hit.prim[3] == unit.prim[3] >= 0 and hit.prim[4] == unit.prim[4] >= 0
    torch.testing.assert_close(hit.t[3:] * torch.tensor([1e-30, 1e30]), unit.t[3:], rtol=1e-5, atol=0)
    assert not groups.occluded(ray, torch.tensor([1.0, 1.0, 1.0, 0.0, -1.0])).any()


@pytest.mark.parametrize("stretch", [(1.0, 1.0, 1.0), (1.0, 1e-3, 1e-3), (1.0, 1.0, 1e-3)])
@pytest.mark.parametrize("far", [0.0, 300.0])
def test_no_ray_passes_between_triangles_of_an_instance(far, stretch, monkeypatch):
    """Rays towards edges of a closed mesh from inside of it, and from far outside to where it faces them."""
    generator = torch.Generator().manual_seed(0)
    points, faces = mesh("sphere")
    linear, origin = turned(1, generator)[0] * torch.tensor(stretch), torch.tensor([1.0, 2.0, 3.0])
    pose = torch.cat([linear, origin[:, None]], 1)[None]
    groups, _ = casters(*scene_of([(points, faces)], [pose], own=False), monkeypatch)
    face = faces[torch.randint(len(faces), (50_000,), generator=generator)].long()
    share = torch.rand(len(face), 1, generator=generator).round(decimals=1)  # corners, too
    target = points[face[:, 0]] * share + points[face[:, 1]] * (1 - share)
    start = 0.8 * (torch.rand(len(face), 3, generator=generator) - 0.5)
    if far:
        start += far * torch.nn.functional.normalize(torch.randn(len(face), 3, generator=generator))
        facing = torch.nn.functional.cosine_similarity(start, points[face].sum(1)) > 0.5
        start, target = start[facing], target[facing]
    o, p = ((linear * each[:, None]).sum(2) + origin for each in (start, target))
    ray, past = Ray(Vec3.of(o), Vec3.of(p - o)), 1.0 + 0.2 / max(far, 1.0)  # in front of what is behind
    hit = groups.intersect(ray)
    assert len(o) > 10_000 and bool(((hit.prim >= 0) & (hit.t < past)).all())
    assert bool(groups.occluded(ray, torch.full_like(hit.t, past)).all())


def test_groups_are_taken_over_from_the_last_caster_and_instances_are_not(monkeypatch):
    monkeypatch.setattr(raycast, "MOST_COPIED", 0)
    vertices, faces, instances = field(torch.float32)
    first = make_caster("warp", vertices, faces, None, instances)
    ray = random_rays(2000)
    before = first.intersect(ray)
    to_world = instances.to_world + torch.tensor([0.0, 0.0, 0.0, 0.1])
    moved = instances._replace(to_world=to_world, boxes=instances.boxes + 0.1)
    second = make_caster("warp", vertices, faces, None, moved, first)
    assert [a.tree is b.tree for a, b in zip(first.groups, second.groups)] == [True, True, True, True]
    vertices[slice(*instances.first_vertex[1:3])] *= 0.5
    third = make_caster("warp", vertices, faces, None, moved, second)
    assert [a.tree is b.tree for a, b in zip(second.groups, third.groups)] == [True, False, True, True]
    fresh = make_caster("warp", vertices, faces, None, moved).intersect(ray)
    del second
    assert all(torch.equal(a, b) for a, b in zip(third.intersect(ray), fresh))
    assert all(torch.equal(a, b) for a, b in zip(pickle.loads(pickle.dumps(third)).intersect(ray), fresh))
    assert not torch.equal(before.t, fresh.t) and all(torch.equal(a, b) for a, b in zip(before, first.intersect(ray)))


def test_few_triangles_are_copied_and_many_are_not(monkeypatch):
    vertices, faces, instances = field(torch.float32)
    count = instances.shown_triangles()
    for most, kept in ((count, False), (count - 1, True)):
        monkeypatch.setattr(raycast, "MOST_COPIED", most)
        caster = make_caster("warp", vertices, faces, None, instances)
        assert isinstance(caster, ExpandedCaster) != kept
        if not kept:
            assert len(caster.caster.faces) == len(expanded(vertices, faces, instances).faces) == count + 12


@pytest.mark.parametrize("count", [1, 2, 3, 5, 64, 100])
def test_boxes_of_the_upper_tree_hold_those_below_them(count):
    generator = torch.Generator().manual_seed(count)
    low = torch.rand(count, 3, generator=generator)
    high = low + 0.1 * torch.rand(count, 3, generator=generator)
    nodes, order = instance_tree(low, high)
    leaves = len(order)
    assert leaves == 2 ** math.ceil(math.log2(count)) and nodes.shape == (2 * leaves, 2, 3)
    assert order[order >= 0].sort().values.tolist() == list(range(count))
    taken = (order >= 0)[:, None]
    assert torch.equal(nodes[leaves:, 0], torch.where(taken, low[order], EMPTY))
    assert torch.equal(nodes[leaves:, 1], torch.where(taken, high[order], -EMPTY))
    below = nodes[2:].unflatten(0, (-1, 2))  # of nodes 1, 2, ...
    assert torch.equal(nodes[1:leaves, 0], below[:, :, 0].amin(1))
    assert torch.equal(nodes[1:leaves, 1], below[:, :, 1].amax(1))
    assert leaves == 1 or bool((order.view(-1, 2) >= 0).any(1).all())


def test_the_halves_of_the_upper_tree_lie_apart():
    """Boxes in a row are found in order, whatever the axis and the order in which they are given."""
    place = torch.randperm(16, generator=torch.Generator().manual_seed(1))
    for axis in range(3):
        low = torch.zeros(16, 3)
        low[:, axis] = place.float()
        assert torch.equal(place[instance_tree(low, low + 1).order], torch.arange(16))


def test_an_image_and_its_gradients_are_those_by_embree(monkeypatch):
    """Of the poses of instances, too, one of which mirrors; and where these move nothing else gets a new tree."""
    monkeypatch.setattr(raycast, "MOST_COPIED", 0)
    mirrored = torch.diag(torch.tensor([-0.6, 0.6, 0.6, 1.0]))
    mirrored[:3, 3] = torch.tensor([0.7, 0.2, 0.1])
    scene = rb.load_dict({
        "type": "scene", "sky": {"type": "constant"},
        "sensor": {"type": "perspective", "fov": 50.0, "film": {"type": "hdrfilm", "width": 24, "height": 24},
                   "to_world": rb.look_at((0.3, 0.5, 5.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))},
        "group": {"type": "shapegroup", "cube": {"type": "cube", "bsdf": diffuse(0.1, 0.2, 0.3)}},
        "one": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}, "to_world": 0.5 * torch.eye(4)
                + torch.diag(torch.tensor([0.0, 0.0, 0.0, 0.5]))},
        "two": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}, "to_world": mirrored},
        "floor": {"type": "rectangle", "to_world": torch.diag(torch.tensor([9.0, 9.0, 1.0, 1.0]))}})
    names = "group.cube.bsdf.reflectance.value", "two.to_world"
    parameters = [scene.get_parameter(name).requires_grad_() for name in names]
    images, gradients = [], []
    for name in ("embree", "warp"):
        renderer = unwarned_renderer(scene, spp=16, max_depth=4, caster=name, terms=("interior",))
        images.append(renderer(seed=3))
        gradients.append(torch.autograd.grad(images[-1].square().sum(), parameters))
    assert images[0].detach().std() > 0.05 and all(each.abs().max() > 1.0 for each in gradients[0])
    assert ((images[0] - images[1]).abs().amax(1) > 1e-5).float().mean() < 0.01  # pixels with a path that meets an edge
    for one, other in zip(*gradients):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-3 * float(one.abs().max()))
    first = renderer.last_caster
    assert first.recorded_as[-1] == "closest_of_groups"
    with torch.no_grad():
        scene.two.to_world[2, 3] += 0.5
        renderer(seed=0)
    assert renderer.last_caster is not first and renderer.last_caster.groups[0].tree is first.groups[0].tree
