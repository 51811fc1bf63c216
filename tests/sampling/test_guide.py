"""Directions that are guided to mirrors, and to where these show lamps."""

import math

import pytest
import torch

from torch_radbp.sampling.guide import SHARE, GuideSpheres, guide_at, image_cone
from torch_radbp.sampling.spheres import BoundingSphere
from torch_radbp.tensors.vec import Vec3, cross, dot, normalize

LANES = 1 << 16
BALLS = BoundingSphere(Vec3.of(torch.tensor([[0.0, 0, 1], [2, 0, 1]], dtype=torch.float64)),
                       torch.tensor([0.5, 0.3], dtype=torch.float64))
LAMPS = BoundingSphere(Vec3.of(torch.tensor([[0.5, 0.5, 4], [-1, 2, 3], [1, 0, 5]], dtype=torch.float64)),
                       torch.tensor([0.3, 0.1, 0.2], dtype=torch.float64))
SPHERES = GuideSpheres(BALLS, LAMPS, torch.tensor(6, dtype=torch.int32), torch.tensor(3, dtype=torch.int32))


def numbers(seed: int, count: int = 4) -> list[torch.Tensor]:
    return list(torch.rand(count, LANES, generator=torch.Generator().manual_seed(seed), dtype=torch.float64))


def sphere_direction(u: torch.Tensor, v: torch.Tensor) -> Vec3:
    z, phi = 1 - 2 * u, 2 * math.pi * v
    r = (1 - z * z).clamp_min(0).sqrt()
    return Vec3(r * phi.cos(), r * phi.sin(), z)


@pytest.mark.parametrize("at", [(0.6, -0.4, 0.0), (1.2, 0.3, 0.2), (-2.0, 0.0, 3.0)])
def test_the_density_is_that_of_the_directions(at):
    """1 / density of what is drawn has the mean 4 pi, and over a cap its solid angle."""
    p = Vec3.of(torch.tensor(at, dtype=torch.float64).expand(LANES, 3))
    which, guided, u, v = numbers(1)
    guide = guide_at(SPHERES, p, which)
    takes, even = guided < guide.share, sphere_direction(u, v)
    d = guide.direction((guided / SHARE).clamp_max(1.0), u, v)
    d = Vec3(*(torch.where(takes, own, other) for own, other in zip(d, even)))
    assert (dot(d, d) - 1).abs().max() < 1e-9
    worth = 1.0 / guide.density(d, torch.full_like(u, 0.25 / math.pi))
    for found, expected in ((worth, 4 * math.pi), (worth * (d.z > 0.9), 2 * math.pi * 0.1)):
        assert abs(found.mean() - expected) < 4 * found.std() / LANES**0.5
        assert found.std() < 4 * expected


def test_the_image_lies_where_the_ball_reflects():
    """The ray along the axis is reflected to the middle of the lamp."""
    which, x, y, z = numbers(2)
    p = Vec3(6 * x - 3, 6 * y - 3, 6 * z - 3)
    ball = BoundingSphere(BALLS.middle.map(lambda c: c[0].expand(LANES)), BALLS.radius[0].expand(LANES))
    lamp = BoundingSphere(LAMPS.middle.map(lambda c: c[0].expand(LANES)), LAMPS.radius[0].expand(LANES))
    cone, shown = image_cone(ball, lamp, p)
    assert 0.2 < shown.double().mean() < 0.9
    away, d = p - ball.middle, cone.axis
    along = -dot(away, d)
    t = along - (along * along - dot(away, away) + 0.25).clamp_min(0).sqrt()
    n = (away + d * t) * 2.0
    reflected = d - n * (2 * dot(d, n))
    towards = normalize(lamp.middle - (p + d * t))
    angle = torch.asin((dot(cross(reflected, towards), cross(reflected, towards))).clamp(0, 1).sqrt())
    assert angle[shown].max() < 0.05 and angle[shown].median() < 1e-3


def test_the_cone_holds_the_image_of_the_whole_lamp():
    """Rays to points of the ball that reflect points of the lamp lie in the cone, of nearly all points."""
    which, x, y, z = numbers(3)
    u, v, _, _ = numbers(4)
    p = Vec3(4 * x - 2, 4 * y - 2, torch.zeros_like(z))
    ball = BoundingSphere(BALLS.middle.map(lambda c: c[0].expand(LANES)), BALLS.radius[0].expand(LANES))
    lamp = BoundingSphere(LAMPS.middle.map(lambda c: c[0].expand(LANES)), LAMPS.radius[0].expand(LANES))
    cone, shown = image_cone(ball, lamp, p)
    point = BoundingSphere(lamp.middle + sphere_direction(u, v) * lamp.radius, torch.zeros_like(lamp.radius))
    seen, also = image_cone(ball, point, p)
    both = shown & also
    assert both.sum() > LANES // 10
    assert cone.holds(seen.axis)[both].mean() > 0.995
    solid = cone.cap[both] * 2 * math.pi
    assert solid.median() < 0.05  # of the 4 pi in which it would be looked for by chance


def test_nothing_is_guided_from_inside_of_a_ball():
    p = Vec3.of(torch.tensor([0.0, 0.2, 1.1], dtype=torch.float64).expand(LANES, 3))
    which, *_ = numbers(5)
    guide = guide_at(SPHERES, p, which)
    assert set(guide.share.unique().tolist()) == {0.0, SHARE}  # 0: the ball that holds the point was picked
    assert all(bool(torch.isfinite(part).all()) for part in (guide.share, *guide.image.axis, guide.image.cap))
