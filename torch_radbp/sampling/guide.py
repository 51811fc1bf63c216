"""Directions in which mirrors are, and in which they show lamps, for paths that would find these by chance.

A surface near a mirror is lit by the lamps that it sees there, from a small part of all directions. So some directions are
drawn from two cones: one around a ball that holds a mirror or glass, and one around the image of a lamp that such a ball
would show if it were a mirror. Where surfaces are no balls the image lies elsewhere, and the first cone is what helps. Which
ball and which lamp is a matter of chance, and the density is that of the drawing for these two: estimates have no bias
whatever their sizes, since all other directions are drawn as before.

Reference: Veach 1997, "Robust Monte Carlo Methods for Light Transport Simulation", section 9.2 (the balance heuristic); West,
Georgiev, Gruson and Hachisuka 2020, "Continuous Multiple Importance Sampling" (densities given what was drawn before).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sampling.spheres import BoundingSphere
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Frame, Vec3, cross, dot, normalize, where

SHARE = 0.3  # of directions that are guided, where there is something to guide to,
OF_IMAGES = 0.7  # and of these the share of images
WIDER, LEAST_HALF_ANGLE, GREATEST_HALF_ANGLE = 1.5, 0.01, 1.0  # of the cone of an image
HALVINGS = 12  # of the arc on which the point lies where a ball mirrors


class GuideSpheres(NamedTuple):
    """Balls around mirrors and glass, (K,), and around lamps, (J,); detached."""

    mirrors: BoundingSphere
    lamps: BoundingSphere
    pairs: Tensor  # () int32, K J
    each: Tensor  # () int32, J


class GuideCone(NamedTuple):
    """A cone of directions, (N,)."""

    axis: Vec3
    cap: Tensor  # 1 - cos of its half angle

    def holds(self, d: Vec3) -> Tensor:
        """1 where the cone holds unit directions, else 0."""
        return ((1.0 - dot(d, self.axis)) <= self.cap).to(self.cap.dtype)


class Guide(NamedTuple):
    """Where guided directions go from some points, (N,); detached."""

    share: Tensor  # of all directions; 0: there is nothing to guide to
    image: GuideCone
    mirror: GuideCone

    def direction(self, number: Tensor, u: Tensor, v: Tensor) -> Vec3:
        """Unit directions, by uniform numbers."""
        of_image = number < OF_IMAGES
        cap, axis = torch.where(of_image, self.image.cap, self.mirror.cap), where(of_image, self.image.axis, self.mirror.axis)
        down, phi = cap * u, 2.0 * math.pi * v
        r = torch.sqrt((down * (2.0 - down)).clamp_min(0.0))
        return Frame.of(axis).to_world(Vec3(r * torch.cos(phi), r * torch.sin(phi), 1.0 - down))

    def density(self, d: Vec3, others: Tensor) -> Tensor:
        """The density of unit directions over solid angle, if those that are not guided have the density `others`."""
        image, mirror = (cone.holds(d) / (2.0 * math.pi * cone.cap) for cone in (self.image, self.mirror))
        return self.share * (OF_IMAGES * image + (1.0 - OF_IMAGES) * mirror) + (1.0 - self.share) * others


def guide_at(spheres: GuideSpheres, p: Vec3, number: Tensor) -> Guide:
    """Where guided directions go from points.

    Args:
        spheres: of the scene.
        p: (N,) the points, detached.
        number: (N,) uniform in [0, 1), which chooses a mirror and a lamp.
    """
    pair = torch.minimum((number * spheres.pairs).to(torch.int32), spheres.pairs - 1)
    of_mirror = torch.div(pair, spheres.each, rounding_mode="floor")
    ball, lamp = lookup(spheres.mirrors, of_mirror), lookup(spheres.lamps, pair - of_mirror * spheres.each)

    way = ball.middle - p
    squared = dot(way, way).clamp_min(TINY)
    outside = squared > ball.radius * ball.radius
    sine2 = torch.where(outside, ball.radius * ball.radius / squared, 0.5)
    mirror = GuideCone(way * torch.rsqrt(squared), sine2 / (1.0 + torch.sqrt((1.0 - sine2).clamp_min(0.0))))
    image, shown = image_cone(ball, lamp, p)
    axis, cap = where(shown, image.axis, mirror.axis), torch.where(shown, torch.minimum(image.cap, mirror.cap), mirror.cap)
    return Guide(torch.where(outside, SHARE, 0.0), GuideCone(axis, cap), mirror)


def image_cone(ball: BoundingSphere, lamp: BoundingSphere, p: Vec3) -> tuple[GuideCone, Tensor]:
    """The cone around the image of a lamp in a mirroring ball, and whether there is one, (N,) bool.

    The image lies where the normal halves the angle between both ways, in the plane of both and the middle: along the arc
    between them one angle grows and the other falls. How large it is follows from how fast.
    """
    from_p, from_lamp = p - ball.middle, lamp.middle - ball.middle
    X, Y = (torch.sqrt(dot(far, far).clamp_min(TINY)) for far in (from_p, from_lamp))
    a, b, r = from_p * (1.0 / X), from_lamp * (1.0 / Y), ball.radius

    def along(t: Tensor) -> Vec3:
        return normalize(a + (b - a) * t)

    low, high = torch.zeros_like(X), torch.ones_like(X)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        n = along(middle)
        to_p, to_lamp = (normalize(far - n * r) for far in (from_p, from_lamp))
        too_far = dot(to_p, n) < dot(to_lamp, n)
        low, high = torch.where(too_far, low, middle), torch.where(too_far, middle, high)
    n = along(0.5 * (low + high))
    cos_p, cos_lamp = dot(n, a), dot(n, b)
    squared, of_lamp = (far * far + r * r - 2.0 * far * r * cos for far, cos in ((X, cos_p), (Y, cos_lamp)))
    squared, of_lamp = squared.clamp_min(TINY), of_lamp.clamp_min(TINY)
    shown = (X * cos_p > r) & (Y * cos_lamp > r) & (Y > r + lamp.radius)

    # Turns of the normal, and of the way to it, by a turn of the lamp about the middle: in the plane, and out of it.
    grows, falls = X * (X - r * cos_p) / squared, Y * (Y - r * cos_lamp) / of_lamp
    turn = falls / (grows + falls).clamp_min(TINY)
    sine_n, sine_lamp = (torch.sqrt(dot(c, c).clamp_min(TINY)) for c in (cross(a, n), cross(a, b)))
    inside = turn * r * (X * cos_p - r) / squared
    out_of_it = r * sine_n / (torch.sqrt(squared) * sine_lamp.clamp_min(1e-3))
    apart = lamp.radius / torch.sqrt((Y * Y - lamp.radius * lamp.radius).clamp_min(TINY))
    half = (WIDER * apart * torch.maximum(inside, out_of_it) + LEAST_HALF_ANGLE).clamp(0.0, GREATEST_HALF_ANGLE)
    sine = torch.sin(0.5 * half)
    return GuideCone(normalize(n * r - from_p), 2.0 * sine * sine), shown
