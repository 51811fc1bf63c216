"""The caster that tests every triangle: vectors of any width, edges, and the range of numbers."""

import math
from functools import cache

import pytest
import torch

from tests.raycast.casters import DTYPES, crossing
from tests.raycast.meshes import mesh, random_rays, soup
from torch_radbp.raycast import Ray, batches, make_caster
from torch_radbp.raycast.direct import DirectCaster, code_of_batches, tensor_addresses
from torch_radbp.raycast.faces import faces_of
from torch_radbp.raycast.runs import CORNER, LOST, MOST, OF_RAYS, OF_SEGMENTS, PARALLELOGRAM, Costs, area, divisions
from torch_radbp.tensors.vec import Vec3
from torch_radbp.threads.team import run_lanes

LANES = 5003


def answers(width: int, dtype: torch.dtype, vertices, faces, ray: Ray, tmax) -> list[torch.Tensor]:
    """prim, u, v, t and whether hidden, by vectors of a width."""
    caster = DirectCaster(vertices, faces)
    hit = [torch.empty(LANES, dtype=torch.int32), *(torch.empty(LANES, dtype=dtype) for _ in range(3))]
    hidden = torch.empty(LANES, dtype=torch.bool)
    rays = [*ray.o, *ray.d]
    for loop, columns, results in ((batches.closest_hit_of_batches, rays, hit),
                                   (batches.any_hit_of_batches, [*rays, tmax], [hidden])):
        inputs, code = [*columns, *caster.tables(dtype, loop)], code_of_batches(loop, dtype, False, width)
        run_lanes(code.address, LANES, tensor_addresses(inputs), tensor_addresses(results))
    return [*hit, hidden]


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("width", [2, 4, 8, 16])
def test_the_width_of_vectors_changes_nothing(width, dtype):
    vertices, faces = mesh("sphere in a box", dtype)
    ray = random_rays(LANES, dtype)
    tmax = torch.where(torch.arange(LANES) % 5 < 2, 0.7, -1.0).to(dtype)
    caster = DirectCaster(vertices, faces)
    expected = [*caster.intersect(ray)[:4], caster.occluded(ray, tmax)]
    assert 0.02 < expected[-1].float().mean() < 0.4
    assert all(torch.equal(a, b) for a, b in zip(answers(width, dtype, vertices, faces, ray, tmax), expected))


def at_edges(vertices, faces, lanes: int, dtype: torch.dtype) -> Ray:
    """Rays from inside to points on edges, one in ten to a corner."""
    generator = torch.Generator().manual_seed(8)
    face = faces[torch.randint(len(faces), (lanes,), generator=generator)].long()
    share = (1.1 * torch.rand(lanes, 1, generator=generator)).clamp(max=1).to(dtype)
    o = random_rays(lanes, dtype, within=0.5).o
    return Ray(o, Vec3.of(vertices[face[:, 0]] * share + vertices[face[:, 1]] * (1 - share)) - o)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", ["box", "sphere"])
@pytest.mark.parametrize("separate", [False, True], ids=["corners shared", "corners repeated"])
def test_no_ray_slips_through_an_edge_or_a_corner(name, dtype, separate):
    """Closed meshes, also such as files give them, where each triangle has corners of its own."""
    vertices, faces = mesh(name, dtype)
    if separate:
        vertices, faces = vertices[faces.long()].reshape(-1, 3), torch.arange(3 * len(faces)).reshape(-1, 3)
    ray = at_edges(vertices, faces, 200_000, dtype)
    caster = DirectCaster(vertices, faces)
    assert int((caster.intersect(ray).prim < 0).sum()) == 0
    assert bool(caster.occluded(ray, torch.full((200_000,), torch.inf, dtype=dtype)).all())


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("shift", [0.0, 300.0], ids=["around the origin", "far from it"])
@pytest.mark.parametrize("distance", [0.0, 3.0, 1000.0, 1e6])
def test_how_triangles_are_divided_into_runs_changes_nothing(distance, shift, dtype):
    """Rays at edges and corners, which a box that is a rounding too small would lose: each face by itself, as rays cost
    least, and as many together as may be."""
    vertices, faces = mesh("sphere in a box", dtype)
    vertices = vertices + shift
    ray = at_edges(vertices - shift, faces, 50_000, dtype)
    o, d = ray.o.stack() + shift - distance * ray.d.stack(), ray.d.stack()
    ray, tmax = Ray(Vec3.of(o), Vec3.of(d)), torch.full((50_000,), distance + 0.9, dtype=dtype)
    caster = DirectCaster(vertices, faces)
    count, of_box = len(caster._faces.prims), caster._faces.parallelogram
    assert of_box.sum() == 6 and bool(of_box[-6:].all())
    many = torch.cat([torch.arange(0, count - 6, MOST), torch.tensor([count - 6])])
    found = []
    for runs in (None, torch.arange(count), many):
        divided = DirectCaster(vertices, faces)
        if runs is not None:
            divided._runs = dict.fromkeys(divided._runs, runs)
        found.append([*divided.intersect(ray)[:4], divided.occluded(ray, tmax)])
    assert all(2 < len(runs) < count for runs in caster._runs.values())
    assert 0.1 < (found[0][0] >= 0).float().mean()
    assert all(torch.equal(a, b) for others in found[1:] for a, b in zip(others, found[0]))


def test_runs_are_the_cheapest_division():
    """Against all divisions of ten triangles and a parallelogram, one by one, of which no part may have both."""
    square = torch.tensor([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=torch.float64)
    p = torch.cat([soup(10, torch.float64)[0].reshape(10, 3, 3), square])
    p[3, 1] = p[2, 0]  # a corner of two triangles
    faces = faces_of(p)
    assert faces.parallelogram.tolist() == [*[False] * 10, True]
    corners, count = faces.points[faces.corners], len(faces.corners)

    scene = area(corners.amax((0, 1)) - corners.amin((0, 1)))

    @cache
    def run(a: int, b: int, costs: Costs) -> float:
        tests = b - a if b < count else PARALLELOGRAM if a == count - 1 else math.inf
        met = area(corners[a:b].amax((0, 1)) - corners[a:b].amin((0, 1))) / scene + LOST
        return float(costs.box + met * (costs.visit + tests + CORNER * len(faces.corners[a:b].unique())))

    def cost(firsts: list[int], costs: Costs) -> float:
        return sum(run(a, b, costs) for a, b in zip(firsts, firsts[1:]))

    every = [[0, *(place for place in range(1, count) if bits >> place & 1), count] for bits in range(0, 1 << count, 2)]
    for costs, (firsts, least) in zip((OF_RAYS, OF_SEGMENTS), divisions(faces, (OF_RAYS, OF_SEGMENTS)), strict=True):
        assert least == pytest.approx(min(cost(each, costs) for each in every), rel=1e-12) == cost(firsts, costs)
        assert 2 < len(firsts) < count + 1


@pytest.mark.parametrize("turned", [False, True], ids=["along axes", "turned"])
def test_triangles_of_a_parallelogram_are_one_face(turned):
    """Six sides of a box; a square of which a corner is off, two triangles that share a shorter edge, and three at one edge
    are faces of their own."""
    vertices, faces = mesh("box")
    if turned:
        vertices = vertices @ torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(2))).Q
    found = faces_of(vertices[faces.long()])
    assert bool(found.parallelogram.all()) and len(found.prims) == 6
    assert sorted(found.prims.flatten().tolist()) == list(range(12))
    for corners, (first, second) in zip(found.points[found.corners], found.prims.tolist()):
        for prim, places in ((first, [0, 1, 2]), (second, [0, 2, 3])):
            assert {*map(tuple, corners[places].tolist())} == {*map(tuple, vertices[faces[prim].long()].tolist())}

    square = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    off = square + torch.tensor([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 1e-4]])
    halves = torch.tensor([[0, 1, 2], [0, 2, 3]])
    kite = torch.tensor([[0.0, 0, 0], [1, 3, 0], [0, 1, 0], [-1, -2, 0]])  # of which the diagonal is no longest edge
    for p in (off[halves], kite[halves], torch.cat([square[halves], square[torch.tensor([[0, 2, 1]])]])):
        alone = faces_of(p)
        assert not bool(alone.parallelogram.any()) and alone.prims.tolist() == [[k, k] for k in range(len(p))]


@pytest.mark.parametrize("axis", range(3))
def test_rays_along_axes_and_in_the_planes_of_triangles(axis):
    """Edge functions and slopes that are exactly zero: rays from the centre of a box along its axes and diagonals."""
    directions = torch.cartesian_prod(*[torch.tensor([-1.0, -0.0, 0.0, 1.0])] * 3)
    directions = directions[directions.abs().sum(1) > 0]
    zero = torch.zeros(len(directions))
    shift = [zero, zero, zero]
    shift[axis] = zero + 0.5
    hit = DirectCaster(*mesh("box")).intersect(Ray(Vec3(*shift), Vec3.of(directions)))
    assert bool((hit.prim >= 0).all())
    end = Vec3(*shift) + Vec3.of(directions) * hit.t
    assert torch.equal(torch.stack([*end]).abs().amax(0), torch.ones(len(directions)))


def test_a_million_rays_agree_with_embree_but_for_edges():
    vertices, faces = soup(60)
    ray = random_rays(1_000_000)
    ours, embree = (make_caster(name, vertices, faces).intersect(ray) for name in ("direct", "embree"))
    differ = ours.prim != embree.prim
    assert differ.float().mean() < 1e-5  # measured: none
    same = ~differ & (ours.prim >= 0)
    assert 0.5 < same.float().mean()
    exact = crossing(vertices, faces, ray, ours.prim.clamp(min=0))[same]
    errors = [((hit.t[same] - exact) / exact).abs().sort().values for hit in (ours, embree)]
    for quantile in (0.5, 0.9, 0.99, 0.999):
        rank = int(quantile * len(exact))
        assert errors[0][rank] < errors[1][rank]  # measured: 0.44 to 0.79 of Embree's


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6, 1e11])
def test_scale_changes_nothing(scale):
    """A power of two near each scale, so that nothing is rounded."""
    scale = 2.0 ** round(torch.tensor(scale).log2().item())
    vertices, faces = mesh("sphere in a box")
    ray = random_rays(LANES)
    hit = DirectCaster(vertices, faces).intersect(ray)
    scaled = DirectCaster(vertices * scale, faces)
    larger = scaled.intersect(Ray(ray.o * scale, ray.d * scale))
    assert all(torch.equal(a, b) for a, b in zip(larger[:4], hit))
    assert torch.equal(scaled.intersect(Ray(ray.o * scale, ray.d)).t, hit.t * scale)
    assert bool(scaled.occluded(Ray(ray.o * scale, ray.d), 1.001 * scale * hit.t).all())
    assert not bool(scaled.occluded(Ray(ray.o * scale, ray.d), 0.999 * scale * hit.t).any())


def beside_ordinary_ones(shape: str, size: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Forty triangles of a size, or slivers of a width, in random places, and one of ten units behind them."""
    generator = torch.Generator().manual_seed(5)
    centres = 2 * torch.rand(40, 1, 3, generator=generator, dtype=torch.float64) - 1
    corners = torch.randn(40, 3, 3, generator=generator, dtype=torch.float64)
    if shape == "sliver":
        corners[:, 2] = 0.7 * corners[:, 0] + 0.3 * corners[:, 1] + size * corners[:, 2]
    else:
        corners *= size
    large = torch.tensor([[-9.0, -9, -5], [9, -9, -5], [0, 9, -5]]).double()
    return torch.cat([(centres + corners).reshape(-1, 3), large]).float(), torch.arange(123).reshape(-1, 3)


@pytest.mark.parametrize("name", ["direct", "brute"])
@pytest.mark.parametrize("shape", ["triangle", "sliver"])
@pytest.mark.parametrize("size", [1e-12, 1e-9, 1e-8, 1e-7, 1e-6, 1e-3, 1e3, 1e6])
def test_triangles_of_any_size_are_hit_by_the_rays_that_hit_them_in_double_precision(size, shape, name):
    vertices, faces = beside_ordinary_ones(shape, size)
    expected = make_caster("brute", vertices.double(), faces).intersect(random_rays(2000, torch.float64)).prim
    assert 0.05 < (expected >= 0).float().mean()
    for dtype in DTYPES:
        caster, ray = make_caster(name, vertices, faces), random_rays(2000, dtype)
        assert torch.equal(caster.intersect(ray).prim, expected)
        assert torch.equal(caster.occluded(ray, torch.full((2000,), torch.inf, dtype=dtype)), expected >= 0)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("size", [1e-12, 1e-9, 1e-6, 1e-3, 1e3, 1e6])
def test_rays_from_nearby_hit_a_triangle_of_any_size_beside_an_ordinary_one(size, dtype):
    corners = torch.tensor([[1.0, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0.1]], dtype=dtype)
    vertices = torch.cat([size * corners, corners + torch.tensor([40.0, 0, 0])])
    generator = torch.Generator().manual_seed(1)
    share = 0.05 + torch.rand(500, 3, generator=generator).to(dtype)
    inside = share / share.sum(1, keepdim=True) @ corners
    o = Vec3.of(size * (2 * torch.rand(500, 3, generator=generator) + torch.tensor([0.0, 0, 1])).to(dtype))
    hit = DirectCaster(vertices, torch.arange(6).reshape(-1, 3)).intersect(Ray(o, Vec3.of(size * inside) - o))
    assert bool((hit.prim == 0).all())


def test_rays_of_both_dtypes_may_be_asked_of_one_caster():
    vertices, faces = mesh("sphere in a box", torch.float64)
    caster = DirectCaster(vertices, faces)
    single, double = (caster.intersect(random_rays(LANES, dtype)) for dtype in DTYPES)
    assert (single.prim != double.prim).float().mean() < 1e-3
    assert single.t.dtype == torch.float32 and double.t.dtype == torch.float64


def test_a_large_mesh_is_refused():
    with pytest.raises(ValueError, match="'direct' takes at most 1000 triangles, got 5120; use 'embree'"):
        DirectCaster(*mesh("fine sphere"))


def test_the_largest_mesh_is_right():
    """A thousand separate triangles: the most that a thread has to keep at a time."""
    vertices, faces = soup(1000)
    ray = random_rays(LANES)
    ours, embree = (make_caster(name, vertices, faces).intersect(ray) for name in ("direct", "embree"))
    assert (ours.prim != embree.prim).float().mean() < 1e-3
