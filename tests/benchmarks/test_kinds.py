"""Eight kinds beside one: the room is closed, so that paths end at no window, and the rays of a pass are counted."""

import torch

from benchmarks.kinds import Counted
from benchmarks.peers import Ours
from benchmarks.scenes import QUICK, material_room
from torch_radbp.raycast import Ray
from torch_radbp.tensors.vec import Vec3, normalize


def test_no_ray_leaves_the_room():
    renderer = material_room.one_kind_room("diffuse", QUICK).renderer(compiled=False)
    generator = torch.Generator().manual_seed(0)
    o = (2 * torch.rand(4000, 3, generator=generator) - 1) * torch.tensor([1.9, 1.2, 1.9])
    d = normalize(Vec3.of(torch.randn(4000, 3, generator=generator)))
    hit = renderer.prepare(0, None, 1, None).caster.intersect(Ray(Vec3.of(o), d))
    assert (hit.prim >= 0).all()


def test_rays_of_a_pass_are_counted():
    """Each path casts a ray and a shadow ray at each vertex but the last, which emits only; the derivative has its own."""
    room = Counted(Ours(material_room.one_kind_room("ggx metal", QUICK), compiled=False))
    room.run(0)
    paths = 2 * QUICK.resolution**2 * QUICK.spp
    assert paths < room.rays <= paths * (2 * QUICK.max_depth - 1)
    assert room.median > 0
