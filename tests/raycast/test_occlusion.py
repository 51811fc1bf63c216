"""Any-hit queries: they agree with closest hits, and mean 0 < t <= tmax."""

import pytest
import torch

from tests.raycast.casters import CASTERS, DTYPES, MESHES, crossing
from tests.raycast.meshes import mesh, random_rays, single_ray
from torch_radbp.raycast import make_caster


@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("dtype", DTYPES)
def test_occlusion_agrees_with_the_closest_hit(caster, name, dtype):
    vertices, faces = mesh(name, dtype)
    ray = random_rays(3000, dtype)
    tracer = make_caster(caster, vertices, faces)
    hit = tracer.intersect(ray)
    found = hit.prim >= 0
    t = torch.where(found, crossing(vertices, faces, ray, hit.prim.clamp(min=0)), 1.0).to(dtype)
    # Float32 distances, and grazing incidence, leave 1% on either side undecided.
    assert torch.equal(tracer.occluded(ray, 1.01 * t)[found], torch.ones_like(found)[found])
    assert not bool(tracer.occluded(ray, 0.99 * t)[found].any())
    assert torch.equal(tracer.occluded(ray, torch.full_like(t, torch.inf)), found)


@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("tmax", [0.0, -0.0, -1.0, -torch.inf, torch.nan])
def test_no_segment_is_no_query(caster, tmax):
    ray = random_rays(100)
    tracer = make_caster(caster, *mesh("box"))
    assert bool(tracer.occluded(ray, torch.full((100,), torch.inf)).all())
    assert not bool(tracer.occluded(ray, torch.full((100,), tmax)).any())


@pytest.mark.parametrize("caster", CASTERS)
def test_lanes_without_a_segment_do_not_disturb_others(caster):
    ray = random_rays(1000)
    tracer = make_caster(caster, *mesh("box"))
    tmax = torch.where(torch.arange(1000) % 3 == 1, torch.inf, -1.0)
    hidden = tracer.occluded(ray, tmax)
    assert hidden.dtype == torch.bool
    assert torch.equal(hidden, tmax > 0)


@pytest.mark.parametrize("caster", CASTERS)
def test_tmax_is_in_units_of_the_direction(caster):
    tracer = make_caster(caster, *mesh("box"))  # a wall at x = 1
    ray = single_ray((0.0, 0.0, 0.0), (0.5, 0.0, 0.0))
    assert not tracer.occluded(ray, torch.tensor([1.9])).item()
    assert tracer.occluded(ray, torch.tensor([2.1])).item()
