"""Lanes: how many, how laid out, broken ones among them, on how many threads."""

import pytest
import torch

from tests.raycast.casters import CASTERS, COMPILED
from tests.raycast.meshes import mesh, random_rays, take
from torch_radbp.raycast import Ray, make_caster
from torch_radbp.tensors.vec import Vec3


@pytest.fixture
def threads_restored():
    """Puts torch's number of threads back."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.mark.parametrize("lanes", [0, 1, 7, 8, 9, 1023, 1024, 1025, 3000])
@pytest.mark.parametrize("caster", CASTERS)
def test_every_lane_is_answered_whatever_their_number(caster, lanes):
    ray = random_rays(3000)
    tracer = make_caster(caster, *mesh("sphere in a box"))
    whole = tracer.intersect(ray)
    part = tracer.intersect(take(ray, slice(lanes)))
    assert [column.shape for column in part[:4]] == [(lanes,)] * 4
    assert all(torch.equal(a, b[:lanes]) for a, b in zip(part[:4], whole))
    assert torch.equal(
        tracer.occluded(take(ray, slice(lanes)), torch.full((lanes,), torch.inf)), whole.prim[:lanes] >= 0
    )


@pytest.mark.parametrize("caster", COMPILED)
def test_a_million_and_three_lanes(caster):
    """All hit the inside of a closed box, so no lane may be left over at the end of blocks and packets."""
    tracer = make_caster(caster, *mesh("box"))
    ray = random_rays(1_000_003)
    assert bool((tracer.intersect(ray).prim >= 0).all())
    assert bool(tracer.occluded(ray, torch.full((1_000_003,), torch.inf)).all())


@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("poison", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("component", range(6))
def test_a_lane_that_is_not_finite_misses_and_disturbs_no_other(caster, poison, component):
    tracer = make_caster(caster, *mesh("sphere in a box"))
    ray = random_rays(500)
    clean = tracer.intersect(ray)
    broken = torch.arange(500) % 7 == 3
    columns = [*ray.o, *ray.d]
    columns[component] = torch.where(broken, poison, columns[component])
    poisoned = Ray(Vec3(*columns[:3]), Vec3(*columns[3:]))
    hit = tracer.intersect(poisoned)
    assert bool((hit.prim[broken] == -1).all()) and bool((hit.u[broken] == 0).all())
    assert all(torch.equal(a[~broken], b[~broken]) for a, b in zip(hit[:4], clean))
    assert torch.equal(tracer.occluded(poisoned, torch.full((500,), torch.inf)), ~broken)


@pytest.mark.parametrize("caster", CASTERS)
def test_a_lane_without_direction_misses(caster):
    tracer = make_caster(caster, *mesh("box"))
    ray = random_rays(100)
    still = torch.arange(100) % 2 == 0
    ray = Ray(ray.o, ray.d.map(lambda lanes: torch.where(still, 0.0, lanes)))
    assert torch.equal(tracer.intersect(ray).prim == -1, still)
    assert torch.equal(tracer.occluded(ray, torch.full((100,), torch.inf)), ~still)


@pytest.mark.parametrize("caster", CASTERS)
def test_lanes_that_are_strided_expanded_or_attached_are_accepted(caster):
    tracer = make_caster(caster, *mesh("sphere in a box"))
    ray = random_rays(1000)
    stacked = torch.stack([*ray.o, *ray.d], 1).requires_grad_()
    strided = Ray(Vec3(*stacked.unbind(1)[:3]), Vec3(*stacked.unbind(1)[3:]))
    assert not strided.o.x.is_contiguous()
    hit = tracer.intersect(strided)
    assert torch.equal(hit.prim, tracer.intersect(ray).prim) and not hit.u.requires_grad
    centre = torch.zeros(()).expand(1000)
    assert bool((tracer.intersect(Ray(Vec3(centre, centre, centre), ray.d)).prim >= 0).all())


@pytest.mark.parametrize("caster", CASTERS)
def test_float64_attached_rays_give_detached_hits(caster):
    tracer = make_caster(caster, *mesh("box", torch.float64))
    ray = random_rays(100, torch.float64)
    hit = tracer.intersect(Ray(*(vector.map(lambda lanes: lanes.clone().requires_grad_()) for vector in ray)))
    assert hit.u.dtype == torch.float64 and not hit.u.requires_grad and not hit.v.requires_grad


@pytest.mark.parametrize("caster", CASTERS)
def test_answers_have_the_shape_of_the_rays(caster):
    tracer = make_caster(caster, *mesh("box"))
    ray = random_rays(24)
    image = Ray(*(vector.map(lambda lanes: lanes.view(4, 6)) for vector in ray))
    assert tracer.intersect(image).u.shape == (4, 6)
    assert torch.equal(tracer.intersect(image).prim.flatten(), tracer.intersect(ray).prim)
    assert tracer.occluded(image, torch.ones(4, 6)).shape == (4, 6)


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("caster", COMPILED)
def test_the_number_of_threads_changes_nothing(caster, threads, threads_restored):
    tracer = make_caster(caster, *mesh("sphere in a box"))
    ray, tmax = random_rays(50_001), torch.full((50_001,), 0.7)
    torch.set_num_threads(1)
    expected, hidden = tracer.intersect(ray), tracer.occluded(ray, tmax)
    assert 0.1 < hidden.float().mean() < 0.9
    torch.set_num_threads(threads)
    assert all(torch.equal(a, b) for a, b in zip(tracer.intersect(ray)[:4], expected))
    assert torch.equal(tracer.occluded(ray, tmax), hidden)


@pytest.mark.parametrize("caster", COMPILED)
def test_the_order_of_rays_changes_nothing(caster):
    """Embree follows neighbours that go the same way together, and others one by one; here many rays meet edges exactly."""
    tracer = make_caster(caster, *mesh("sphere in a box"))
    row, column = torch.meshgrid(torch.linspace(-1, 1, 301), torch.linspace(-1, 1, 301), indexing="ij")
    zero = torch.zeros(row.numel())
    ray = Ray(Vec3(zero, zero, zero + 1.4), Vec3(column.flatten(), row.flatten(), zero - 1))
    shuffled = torch.randperm(len(zero), generator=torch.Generator().manual_seed(1))
    hit, tmax = tracer.intersect(ray), torch.full_like(zero, 1.2)
    assert all(torch.equal(a[shuffled], b) for a, b in zip(hit[:4], tracer.intersect(take(ray, shuffled))))
    hidden = tracer.occluded(ray, tmax)
    assert 0.1 < hidden.float().mean() < 0.9
    assert torch.equal(hidden[shuffled], tracer.occluded(take(ray, shuffled), tmax))


def test_neighbours_that_go_the_same_way_leave_a_closed_sphere_nowhere():
    """Eight rays at a time aim at one stretch of an edge; corners are left out, where Embree is not watertight."""
    vertices, faces = mesh("fine sphere")
    generator = torch.Generator().manual_seed(4)
    groups = 20_000
    ends = vertices[faces[torch.randint(len(faces), (groups,), generator=generator)].long()][:, :2].repeat_interleave(8, 0)
    share = 0.1 + 0.7 * torch.rand(groups, generator=generator).repeat_interleave(8)
    share += 0.1 * torch.rand(8 * groups, generator=generator)
    o = (torch.rand(groups, 3, generator=generator) - 0.5).repeat_interleave(8, 0)
    target = ends[:, 0] * share[:, None] + ends[:, 1] * (1 - share[:, None])
    ray = Ray(Vec3.of(o), Vec3.of(target - o))
    tracer = make_caster("embree", vertices, faces)
    assert bool((tracer.intersect(ray).prim >= 0).all())
    assert bool(tracer.occluded(ray, torch.full((8 * groups,), torch.inf)).all())


def test_brute_force_is_right_across_its_chunks(monkeypatch):
    tracer = make_caster("brute", *mesh("sphere in a box"))
    ray, tmax = random_rays(1000), torch.rand(1000)
    expected, hidden = tracer.intersect(ray), tracer.occluded(ray, tmax)
    monkeypatch.setattr("torch_radbp.raycast.brute.TABLE_BYTES", 7 * 4 * len(tracer.faces))  # 7 lanes a chunk
    assert all(torch.equal(a, b) for a, b in zip(tracer.intersect(ray)[:4], expected))
    assert torch.equal(tracer.occluded(ray, tmax), hidden)
