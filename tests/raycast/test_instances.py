"""Casters find triangles that instances show, and which instance."""

from itertools import pairwise

import pytest
import torch

from tests.raycast.meshes import mesh, random_rays
from torch_radbp.interface.instances import Instances, expanded
from torch_radbp.raycast import Hit, Ray, RayCaster, make_caster
from torch_radbp.scene.tables.placement import boxes

DTYPES = (torch.float32, torch.float64)


def things(dtype: torch.dtype = torch.float32, own: bool = True) -> tuple[torch.Tensor, torch.Tensor, Instances]:
    """A box, or none, around three instances of a sphere and four of a soup."""
    parts = [mesh("box", dtype), mesh("sphere", dtype), mesh("soup", dtype)][not own:]
    parts[0] = (3 * parts[0][0], parts[0][1]) if own else parts[0]
    first, corners, faces = 0, [0], []
    for points, own_faces in parts:
        faces.append(own_faces + first)
        first += len(points)
        corners.append(first)
    triangles = [0, *torch.tensor([len(each) for each in faces]).cumsum(0).tolist()]
    generator = torch.Generator().manual_seed(5)
    to_world = (0.4 * torch.randn(7, 3, 4, generator=generator)).to(dtype)
    around = boxes([points for points, _ in parts[-2:]], to_world.split([3, 4]))
    return torch.cat([points for points, _ in parts]), torch.cat(faces), Instances(
        to_world, tuple(corners[-3:]), tuple(triangles[-3:]), (0, 3, 7), around)


def both(own: bool, dtype: torch.dtype) -> tuple[RayCaster, RayCaster]:
    return tuple(make_caster(name, *things(dtype, own)[:2], None, things(dtype, own)[2]) for name in ("embree", "brute"))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("own", [True, False])
def test_hits_are_those_of_brute_force(own, dtype):
    ray = random_rays(5000, dtype)
    embree, brute = both(own, dtype)
    found, expected = embree.intersect(ray), brute.intersect(ray)
    assert len(expected.instance.unique()) == 8
    assert torch.equal(found.prim, expected.prim) and torch.equal(found.instance, expected.instance)
    assert ((expected.instance == 0) == ((expected.prim < 12 if own else expected.prim < 0) | (expected.prim < 0))).all()
    # Rounding, the more the closer a triangle is to edge-on; measured 9e-6 and 3e-14.
    torch.testing.assert_close(found.t, expected.t, rtol=0, atol=3e-5 if dtype == torch.float32 else 1e-12)


@pytest.mark.parametrize("dtype", DTYPES)
def test_occlusion_is_that_of_brute_force(dtype):
    ray, embree_and_brute = random_rays(5000, dtype), both(True, dtype)
    tmax = 2 * torch.rand(5000, generator=torch.Generator().manual_seed(1)).to(dtype)
    found, expected = (caster.occluded(ray, tmax) for caster in embree_and_brute)
    assert 0.2 < expected.double().mean() < 0.9
    assert torch.equal(found, expected)


@pytest.mark.parametrize("dtype", DTYPES)
def test_the_point_lies_on_the_triangle_and_on_the_ray(dtype):
    vertices, faces, instances = things(dtype)
    ray = random_rays(3000, dtype)
    hit = make_caster("embree", vertices, faces, None, instances).intersect(ray)
    met = hit.prim >= 0
    corners = vertices[faces[hit.prim.clamp_min(0)].long()]
    matrices = instances.by_hit(dtype)[hit.instance.long()]
    corners = (matrices[:, None, :, :3] * corners[:, :, None]).sum(-1) + matrices[:, None, :, 3]
    on_triangle = (corners * torch.stack([1 - hit.u - hit.v, hit.u, hit.v], 1)[..., None]).sum(1)
    apart = (on_triangle - (ray.o + ray.d * hit.t).stack()).norm(dim=1)[met]
    assert met.double().mean() > 0.5
    assert apart.max() < (2e-4 if dtype == torch.float32 else 1e-11)


def test_groups_are_taken_over_from_the_last_caster():
    vertices, faces, instances = things()
    first = make_caster("embree", vertices, faces, None, instances)
    moved = make_caster("embree", vertices, faces, None, instances._replace(to_world=instances.to_world + 0.1), first)
    assert [a.tree is b.tree for a, b in zip(first.groups, moved.groups)] == [True, True]
    vertices[instances.first_vertex[1]:] *= 1.5  # the second group
    other = make_caster("embree", vertices, faces, None, instances, first)
    assert [a.tree is b.tree for a, b in zip(first.groups, other.groups)] == [True, False]
    ray = random_rays(1000)
    fresh = make_caster("embree", vertices, faces, None, instances).intersect(ray)
    del first
    assert all(torch.equal(a, b) for a, b in zip(other.intersect(ray), fresh))


def test_expanded_triangles_are_few_if_only_some_are_wanted():
    vertices, faces, instances = things()
    whole, some = expanded(vertices, faces, instances), expanded(vertices, faces, instances, 500)
    ball, soup = (end - start for start, end in pairwise(instances.first_triangle))
    assert len(whole.faces) == instances.triangles() == 12 + 3 * ball + 4 * soup
    assert (ball, soup) == (320, 200)
    assert len(some.faces) == 12 + 2 * ball + 2 * soup and set(some.instance.tolist()) == {0, 1, 3, 4, 6}


def test_no_instances_no_answer_about_them():
    hit = make_caster("embree", *mesh("box")).intersect(random_rays(10))
    assert isinstance(hit, Hit) and hit.instance is None and isinstance(random_rays(1), Ray)
