"""Tessellated spheres that are cast without a tree: the same answers as from their triangles."""

from functools import lru_cache

import pytest
import torch

import torch_radbp as rb
from tests.raycast.casters import COMPILED, DTYPES, crossing
from tests.raycast.meshes import take
from torch_radbp.interface.balls import RINGS, SEGMENTS, TRIANGLES, Balls
from torch_radbp.raycast import FEW_BALLS, Hit, Ray, batches, make_caster
from torch_radbp.raycast.brute import Brute
from torch_radbp.raycast.direct import DirectCaster, code_of_batches, tensor_addresses
from torch_radbp.raycast.embree import Embree
from torch_radbp.raycast.refined import refined
from torch_radbp.scene.packing.pack import pack
from torch_radbp.scene.tables.triangle_corners import clearance
from torch_radbp.tensors.vec import Vec3, dot, normalize, unit_normal
from torch_radbp.threads.team import run_lanes

LANES = 20_000
FLOOR = {"type": "rectangle", "to_world": torch.diag(torch.tensor([3.0, 3.0, 3.0, 1.0]))}
AFFINE = torch.tensor([[0.5, 0.2, 0.0, 0.3], [-0.1, 0.7, 0.3, -0.2], [0.0, 0.1, 0.9, 0.4], [0.0, 0.0, 0.0, 1.0]])
MIRROR = torch.diag(torch.tensor([1.0, -1.0, 1.0, 1.0]))
AWAY = torch.tensor([[1.0, 0.0, 0.0, 1.8], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
THINGS = {
    "one": [{}],
    "floor": [{"radius": 0.7, "center": [0.2, -0.3, 0.5]}, FLOOR],
    "several": [{"radius": 0.4, "center": [0.3 * k, 0.5 * k - 1, 0.2]} for k in range(4)],
    "affine": [{"to_world": AFFINE}, {"to_world": AWAY @ AFFINE @ MIRROR}],
    "turned": [{"flip_normals": True},
               {"to_world": AWAY @ (MIRROR * torch.tensor([0.5, 0.5, 0.5, 1.0])), "flip_normals": True}],
    "small": [{"radius": 1e-3, "center": [0.01, 0.02, -0.01]}],
    "large": [{"radius": 2e4}],
}


def mesh_of(things: list[dict], dtype: torch.dtype = torch.float32) -> tuple[torch.Tensor, torch.Tensor, Balls]:
    """Vertices, faces and balls of spheres, and of shapes that give their type."""
    shapes = {f"thing_{k}": {"type": "sphere", **thing} for k, thing in enumerate(things)}
    scene = rb.load_dict({"type": "scene", "sensor": {"type": "perspective"}, "sky": {"type": "constant"}, **shapes})
    triangles = pack(scene.to(dtype)).triangles
    return triangles.vertices.p.stack(), torch.stack(triangles.corners, 1), triangles.balls


def rays_near(vertices: torch.Tensor, lanes: int = LANES, seed: int = 1) -> Ray:
    """Rays from inside, from near and from far, most of them towards the mesh."""
    generator = torch.Generator().manual_seed(seed)
    centre, size = vertices.mean(0), (vertices.amax(0) - vertices.amin(0)).amax()
    away = torch.randn(2, lanes, 3, generator=generator).to(vertices.dtype)
    distance = size * 10 ** (1.5 * torch.rand(lanes, 1, generator=generator) - 1).to(vertices.dtype)
    target = vertices[torch.randint(len(vertices), (lanes,), generator=generator)] + 0.05 * size * away[0]
    o = centre + distance * away[1]
    return Ray(Vec3.of(o), Vec3.of(target - o))


@lru_cache(maxsize=1)  # for one caster after the other
def from_triangles(things: str, dtype: torch.dtype):
    """A mesh of `THINGS`, rays near it, and the hits of its triangles: those that Embree names, in float64."""
    vertices, faces, balls = mesh_of(THINGS[things], dtype)
    ray = rays_near(vertices)
    hit = Embree(vertices, faces).intersect(ray)
    t = torch.where(hit.prim >= 0, crossing(vertices, faces, ray, hit.prim.clamp_min(0)), torch.inf)
    return vertices, faces, balls, ray, hit.prim, t


@pytest.mark.parametrize("name", COMPILED)
@pytest.mark.parametrize("things", THINGS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_balls_are_met_where_their_triangles_are(name, things, dtype):
    vertices, faces, balls, ray, prim, t = from_triangles(things, dtype)
    hit = make_caster(name, vertices, faces, balls).intersect(ray)
    met = prim >= 0
    assert 0.2 < met.float().mean() < 0.99
    differ = hit.prim != prim
    assert differ.float().mean() < 5e-4  # at edges; measured: at most 1e-4
    either = met & (hit.prim >= 0)
    assert int((met != (hit.prim >= 0)).sum()) <= 1  # at the outline
    rounding = 1e-5 if dtype == torch.float32 or name == "embree" else 1e-11
    error = ((hit.t - t) / t).abs()[either]
    assert error.median() < rounding and error.quantile(0.99) < 100 * rounding

    # The point on the triangle is on the ray.
    p0, p1, p2 = (Vec3.of(vertices[faces[hit.prim.clamp_min(0).long()].long()][:, corner]) for corner in range(3))
    apart = p0 + (p1 - p0) * hit.u + (p2 - p0) * hit.v - (ray.o + ray.d * hit.t)
    scale = torch.maximum(vertices.abs().amax(), ray.o.stack().abs().amax())
    assert (dot(apart, apart).sqrt()[either] / scale).quantile(0.99) < rounding
    assert float(torch.stack([hit.u, hit.v, 1 - hit.u - hit.v]).amin()) > (-1e-3 if dtype == torch.float32 else -1e-4)


@pytest.mark.parametrize("name", COMPILED)
@pytest.mark.parametrize("things", THINGS)
def test_occlusion_agrees_with_the_closest_hit(name, things):
    vertices, faces, balls, ray, _, _ = from_triangles(things, torch.float32)
    caster = make_caster(name, vertices, faces, balls)
    hit = caster.intersect(ray)
    found = hit.prim >= 0
    end = torch.where(found, hit.t, 1.0)
    assert bool(caster.occluded(ray, 1.01 * end)[found].all()) and not bool(caster.occluded(ray, 0.99 * end)[found].any())
    assert torch.equal(caster.occluded(ray, torch.full_like(end, torch.inf)), found)
    assert not bool(caster.occluded(ray, -end).any())


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("width", [2, 4, 8, 16])
def test_the_width_of_vectors_changes_nothing(width, dtype):
    vertices, faces, balls = mesh_of(THINGS["several"] + [FLOOR], dtype)
    ray, caster = take(rays_near(vertices), slice(0, 5003)), DirectCaster(vertices, faces, balls)
    hit = [torch.empty(5003, dtype=torch.int32), *(torch.empty(5003, dtype=dtype) for _ in range(3))]
    read = [*ray.o, *ray.d, *caster.tables(dtype, batches.closest_hit_of_batches)]
    code = code_of_batches(batches.closest_hit_of_batches, dtype, True, width)
    run_lanes(code.address, 5003, tensor_addresses(read), tensor_addresses(hit))
    found = Hit(*hit) if dtype == torch.float32 else refined(vertices, faces, ray, Hit(*hit))
    assert all(torch.equal(a, b) for a, b in zip(found[:4], caster.intersect(ray)))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("inside", [True, False], ids=["inside", "outside"])
def test_no_ray_slips_through_corners_and_edges(inside, dtype):
    """Towards vertices, the poles among them, and points on edges and diagonals."""
    vertices, faces, balls = mesh_of([{"to_world": AFFINE}], dtype)
    generator = torch.Generator().manual_seed(8)
    face = faces[torch.randint(len(faces), (100_000,), generator=generator)].long()
    share = (1.1 * torch.rand(len(face), 1, generator=generator)).clamp(max=1).to(dtype)
    target = vertices[face[:, 0]] * share + vertices[face[:, 1]] * (1 - share)
    target[:2000] = vertices[torch.arange(2000) % 2 * (len(vertices) - 1)]
    centre = vertices.mean(0)
    aside = 0.05 * torch.randn(target.shape, generator=generator).to(dtype)
    o = centre + (target - centre) * (-0.3 if inside else 4.0) + aside
    ray = Ray(Vec3.of(o), Vec3.of(target - o))
    caster = DirectCaster(vertices, faces, balls)
    hit = caster.intersect(ray)
    assert bool((hit.prim >= 0).all())
    torch.testing.assert_close(hit.t, torch.ones_like(hit.t), rtol=0, atol=1e-4)
    assert bool(caster.occluded(ray, torch.full_like(hit.t, 1.01)).all())


@pytest.mark.parametrize("name", COMPILED)
@pytest.mark.parametrize(("radius", "centre"), [(1e-4, 0.0), (1.0, 0.0), (1e5, 0.0), (1.0, 30.0), (1.0, 1000.0)])
def test_rays_that_leave_a_ball_get_away_and_rays_that_enter_it_meet_its_far_side(name, radius, centre):
    vertices, faces, balls = mesh_of([{"radius": radius, "center": [centre, -0.3 * centre, 0.5 * centre]}])
    generator = torch.Generator().manual_seed(5)
    lanes = 30_000
    rows = faces[torch.randint(len(faces), (lanes,), generator=generator)].long()
    corners = [Vec3.of(vertices[row]) for row in rows.unbind(1)]
    weights = torch.distributions.Dirichlet(torch.full((3,), 0.5)).sample((lanes,)).unbind(1)
    n = unit_normal(corners[1] - corners[0], corners[2] - corners[0])
    d = normalize(Vec3.of(torch.randn(lanes, 3, generator=generator)))
    d = d + n * (torch.rand(lanes, generator=generator) * 0.999 - dot(n, d)) * (torch.arange(lanes) % 4 == 0)  # any slant
    p = sum((corner * weight for corner, weight in zip(corners, weights)), start=Vec3.full(n.x, 0.0))
    slant = dot(n, d)
    o = p + n * torch.copysign(clearance(tuple(corners)), slant)
    caster = make_caster(name, vertices, faces, balls)
    hit = caster.intersect(Ray(o, d))
    out, into = slant > 0, slant < -0.02
    assert out.float().mean() > 0.4 and into.float().mean() > 0.2
    assert not bool((hit.prim[out] >= 0).any())
    assert bool((hit.prim[into] >= 0).all())
    # A chord is twice the radius long times the cosine, on a sphere.
    length = hit.t[into] / (-2 * radius * (slant / dot(d, d).sqrt())[into])
    assert length.quantile(0.01) > 0.6 and length.quantile(0.99) < 1.7 and 0.99 < length.median() < 1.01


def test_a_ball_that_moves_is_cast_where_it_is():
    scene = rb.load_dict({"type": "scene", "sky": {"type": "constant"},
                          "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}},
                          "ball": {"type": "sphere", "center": [0.0, 0.0, 5.0], "radius": 4.0}})
    renderer = rb.Renderer(scene, spp=4, max_depth=2)
    seen = renderer(seed=0).mean()
    first = renderer.last_caster
    assert isinstance(first, DirectCaster) and len(first.balls.first) == 1
    renderer(seed=1)
    assert renderer.last_caster is first
    with torch.no_grad():
        scene.ball.to_world[2, 3] += 100.0
    assert abs(float(renderer(seed=0).mean() - seen)) > 1e-2
    assert renderer.last_caster is not first
    assert float(renderer.last_caster.balls.placement[0, 2, 3]) == 105.0


def test_a_picture_by_balls_is_that_by_their_triangles(monkeypatch):
    """Glass, which looks from inside, beside a diffuse ball; per pixel, up to the few paths that meet an edge."""
    scene = rb.load_dict({
        "type": "scene", "sky": {"type": "constant"},
        "sensor": {"type": "perspective", "fov": 60.0, "film": {"type": "hdrfilm", "width": 24, "height": 24}},
        "glass": {"type": "sphere", "center": [0.7, 0.0, 4.2], "bsdf": {"type": "dielectric"}},
        "chalk": {"type": "sphere", "center": [-0.9, 0.4, 4.8], "radius": 0.7, "bsdf": {"type": "diffuse"}}}).double()
    images = [rb.Renderer(scene, spp=16, max_depth=5, caster=name)(seed=2).detach() for name in ("direct", "embree")]
    monkeypatch.setattr("torch_radbp.raycast.FEW_BALLS", 0)
    renderer = rb.Renderer(scene, spp=16, max_depth=5)
    reference = renderer(seed=2).detach()
    assert isinstance(renderer.last_caster, Embree) and renderer.last_caster.balls is None
    assert reference.std() > 0.05
    for image in images:
        assert ((image - reference).abs().amax(-1) > 1e-6).float().mean() < 0.02
        assert abs(float((image - reference).mean())) < 1e-3


def test_which_balls_are_cast_as_balls():
    vertices, faces, balls = mesh_of(THINGS["several"])
    assert make_caster(None, vertices, faces, balls).balls is balls
    assert isinstance(make_caster(None, vertices, faces), Embree)
    assert isinstance(make_caster("brute", vertices, faces, balls), Brute)
    many = Balls(*(rows[:1].expand(FEW_BALLS + 1, *rows.shape[1:]) for rows in balls))
    assert make_caster(None, vertices, faces, many).balls is None
    tiny = balls._replace(placement=balls.placement * torch.tensor([1e-13, 1e-13, 1e-13, 1.0]))
    assert make_caster(None, vertices, faces, tiny).balls is None


def test_a_ball_has_as_many_triangles_as_its_cells_need():
    _, faces, _ = mesh_of([{}])
    assert len(faces) == TRIANGLES == 2 * SEGMENTS * RINGS - 2 * SEGMENTS
