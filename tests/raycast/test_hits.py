"""Which triangle is hit, and where: the compiled casters against brute force, and all against closed forms."""

import pytest
import torch

from tests.raycast.casters import CASTERS, COMPILED, DTYPES, MESHES, crossing
from tests.raycast.meshes import mesh, random_rays, single_ray
from torch_radbp.raycast import Ray, make_caster
from torch_radbp.tensors.vec import Vec3, cross, dot


def point(vertices, faces, hit):
    p0, p1, p2 = (Vec3.of(vertices.to(hit.u.dtype)[faces[hit.prim.long()].long()][:, corner]) for corner in range(3))
    return p0 * (1 - hit.u - hit.v) + p1 * hit.u + p2 * hit.v


@pytest.mark.parametrize("caster", COMPILED)
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("dtype", DTYPES)
def test_brute_force_finds_the_same_triangles(caster, name, dtype):
    vertices, faces = mesh(name, dtype)
    ray = random_rays(5000, dtype)
    ours, reference = (make_caster(kind, vertices, faces).intersect(ray) for kind in (caster, "brute"))
    assert 0.3 < (reference.prim >= 0).float().mean(), "too few hits for a test"
    differ = ours.prim != reference.prim
    # On an edge, or where two triangles of a soup cross, either answer is right: then the distance must agree.
    assert differ.float().mean() < 2e-3
    both = differ & (ours.prim >= 0) & (reference.prim >= 0)
    assert torch.equal(both, differ), "one of the two missed what the other hit"
    t = [crossing(vertices, faces, ray, hit.prim)[both] for hit in (ours, reference)]
    torch.testing.assert_close(t[0], t[1], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("caster", COMPILED)
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-4), (torch.float64, 1e-9)])
def test_barycentrics_agree_with_those_of_brute_force(caster, name, dtype, tolerance):
    # Errors of u and v are those of the arithmetic divided by the cosine with the triangle, which is small at times.
    vertices, faces = mesh(name, dtype)
    ray = random_rays(5000, dtype)
    ours, reference = (make_caster(kind, vertices, faces).intersect(ray) for kind in (caster, "brute"))
    same = (ours.prim == reference.prim) & (ours.prim >= 0)
    for weight in ("u", "v"):
        error = (getattr(ours, weight) - getattr(reference, weight))[same].abs()
        assert error.quantile(0.99) < tolerance
        assert getattr(ours, weight).dtype == dtype


@pytest.mark.parametrize("caster", CASTERS)
def test_hit_point_lies_on_a_float64_ray(caster):
    vertices, faces = mesh("sphere", torch.float64)
    ray = random_rays(20_000, torch.float64, within=0.5)
    hit = make_caster(caster, vertices, faces).intersect(ray)
    assert bool((hit.prim >= 0).all())
    away = point(vertices, faces, hit) - ray.o
    off_the_ray = cross(away, ray.d)
    distance = torch.sqrt(dot(off_the_ray, off_the_ray) / dot(ray.d, ray.d))
    assert distance.max() < 1e-13  # of 1: some rounding errors of float64; float32 would give 1e-7
    assert bool((dot(away, ray.d) > 0).all())


@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_weights_belong_to_the_second_and_third_vertex(caster, dtype):
    vertices = torch.tensor([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 2.0, 0.0]], dtype=dtype)
    hit = make_caster(caster, vertices, torch.tensor([[0, 1, 2]])).intersect(
        single_ray((1.0, 0.25, 3.0), (0.0, 0.0, -2.0), dtype)
    )
    assert (hit.prim.item(), hit.u.item(), hit.v.item()) == pytest.approx((0, 0.25, 0.125), abs=1e-6)
    assert hit.prim.dtype == torch.int32


@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_both_sides_of_a_triangle_are_hit_and_the_closest_wins(caster, side):
    triangle = torch.tensor([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    behind = triangle - torch.tensor([0.0, 0.0, side])
    tracer = make_caster(caster, torch.cat([behind, triangle]), torch.arange(6).reshape(2, 3))
    assert tracer.intersect(single_ray((0.0, 0.0, side), (0.0, 0.0, -side))).prim.item() == 1
    assert tracer.intersect(single_ray((0.0, 0.0, side), (0.0, 0.0, side))).prim.item() == -1


@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_no_ray_leaves_a_closed_box_through_an_edge(caster, dtype):
    """Every ray aims at a point of an edge, where a test of the triangles one by one misses both."""
    vertices, faces = mesh("box", dtype)
    ray = random_rays(20_000, dtype)
    generator = torch.Generator().manual_seed(5)
    face = faces[torch.randint(len(faces), (20_000,), generator=generator)].long()
    share = torch.rand(20_000, 1, generator=generator).to(dtype)
    target = vertices[face[:, 0]] * share + vertices[face[:, 1]] * (1 - share)
    hit = make_caster(caster, vertices, faces).intersect(Ray(ray.o, Vec3.of(target) - ray.o))
    assert int((hit.prim < 0).sum()) == 0


@pytest.mark.parametrize("caster", CASTERS)
def test_a_miss_is_minus_one_with_weights_zero(caster):
    hit = make_caster(caster, *mesh("box")).intersect(single_ray((0.0, 0.0, 5.0), (0.0, 0.0, 1.0)))
    assert (hit.prim.item(), hit.u.item(), hit.v.item()) == (-1, 0.0, 0.0)


@pytest.mark.parametrize("caster", CASTERS)
def test_what_lies_behind_or_at_the_origin_is_not_hit(caster):
    vertices = torch.tensor([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    tracer = make_caster(caster, vertices, torch.tensor([[0, 1, 2]]))
    assert tracer.intersect(single_ray((0.0, 0.0, 1e-4), (0.0, 0.0, 1.0))).prim.item() == -1
    assert tracer.intersect(single_ray((0.0, 0.0, 1e-4), (0.0, 0.0, -1.0))).prim.item() == 0


@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("length", [1e-5, 1e5])
@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_neither_the_size_of_a_mesh_nor_the_length_of_directions_matters(caster, length, size):
    vertices, faces = mesh("sphere in a box")
    ray = random_rays(1000)
    expected = make_caster("brute", vertices, faces).intersect(ray)
    scaled = Ray(ray.o * size, ray.d * length)
    tracer = make_caster(caster, vertices * size, faces)
    hit, t = tracer.intersect(scaled), expected.t * (size / length)
    assert (hit.prim == expected.prim).float().mean() > 0.995  # the rest are edges
    same = (hit.prim == expected.prim) & torch.isfinite(t) & (t > 0)
    assert same.float().mean() > 0.9
    torch.testing.assert_close(hit.t[same], t[same], rtol=1e-4, atol=0)
    assert bool(tracer.occluded(scaled, 1.01 * t)[same].all()) and not bool(tracer.occluded(scaled, 0.99 * t)[same].any())


@pytest.mark.parametrize("caster", CASTERS)
def test_degenerate_triangles_are_skipped(caster):
    good = torch.tensor([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    point_like = torch.tensor([[0.0, 0.0, 0.5]]).expand(3, 3)
    line_like = torch.tensor([[-1.0, 0.0, 0.5], [0.0, 0.0, 0.5], [1.0, 0.0, 0.5]])
    tracer = make_caster(caster, torch.cat([point_like, line_like, good]), torch.arange(9).reshape(3, 3))
    ray = single_ray((0.0, 0.0, 2.0), (0.0, 0.0, -1.0))
    assert tracer.intersect(ray).prim.item() == 2
    assert not tracer.occluded(ray, torch.tensor([1.9])).item()
    assert tracer.occluded(ray, torch.tensor([2.1])).item()
