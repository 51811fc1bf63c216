"""Ray cones: the footprint of a pixel's sample on surfaces, by which textures choose how finely they are read.

A cone has a width at the origin of its ray, and a spread, by which the width grows per unit of distance. It begins as wide
as the pixel. Scattering adds the width of the solid angle that the sample stands for: the share 1 / SHARING of 1 / density,

    spread' = spread + 2 sqrt(1 / (SHARING pi (density + 1 / (4 pi))))

nothing where a direction is not left to chance (ideal mirrors, straight through), 0.45 rad after diffuse reflection along
the normal. The term 1 / (4 pi), the density of an isotropic scatterer, bounds it. So textures are blurred behind rough
reflection as if seen through frosted glass that is much clearer than the material.

What is seen of a surface is an ellipse; its long axis counts, width / |cos|, as is usual for isotropic filters. Curved
mirrors and refraction leave the spread as it is. All is attached.

Reference: Akenine-Moeller, Nilsson, Andersson, Barre-Brisebois, Toth and Karras 2019, "Texture Level of Detail Strategies
for Real-Time Ray Tracing", Ray Tracing Gems, section 20.3; Akenine-Moeller, Crassin, Boksansky, Belcour, Panteleev and
Wright 2021, "Improved Shader and Texture Level of Detail Using Ray Cones".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, cross, dot

SHARING = 16.0  # samples among which the directions that a surface scatters to are divided
ISOTROPIC = 1.0 / (4.0 * math.pi)  # density of directions
SMALLEST = 1e-36  # of what a logarithm is taken; its reciprocal is finite in float32


class Cone(NamedTuple):
    """The ray cone of each lane, (N,): the footprint of a pixel along its ray; attached."""

    width: Tensor  # at the origin, world units
    spread: Tensor  # of the width, per unit of distance


def camera_cone(camera: Camera, ray: Ray, position: Vec2, aperture: Vec2 | None) -> Cone:
    """Camera ray cones, one pixel wide at their start, by the rays one pixel to the right and below; 0 for pixels without
    area.

    Args:
        camera: of the rays.
        ray, position, aperture: of `CameraKind.sample_ray`.
    """
    if not camera.kind.has_area:
        nothing = torch.zeros_like(ray.d.x)
        return Cone(nothing, nothing)
    film = camera.film
    places = Vec2(position.x + 1.0 / film.size_x, position.y), Vec2(position.x, position.y + 1.0 / film.size_y)
    beside = [camera.kind.sample_ray(camera.lens, place, aperture)[0] for place in places]
    return Cone(*(torch.sqrt((0.5 * sum(dot(apart, apart) for apart in steps)).clamp_min(TINY))
                  for steps in ([other.o - ray.o for other in beside], [other.d - ray.d for other in beside])))


def cone_beyond(cone: Cone, t: Tensor, density: Tensor) -> Cone:
    """The cone of a scattered ray: wider by the distance that the ray has come, and spread more the wider the BSDF scatters.

    Args:
        cone: of the ray that arrives.
        t: (N,) distance that this ray has come; finite.
        density: (N,) solid-angle density of the scattered direction; infinite if it is not random.
    """
    added = 2.0 / math.sqrt(SHARING * math.pi) * torch.rsqrt(density + ISOTROPIC)
    return Cone(cone.width + cone.spread * t, cone.spread + added)


def footprint(cone: Cone, t: Tensor, cosine: Tensor, edges: tuple[Vec3, Vec3], edges_uv: tuple[Vec2, Vec2]) -> Tensor:
    """The natural logarithm of the width of a ray cone's footprint on a triangle, in texture coordinates (u, v); attached.

    Args:
        cone, t: as for `cone_beyond`.
        cosine: (N,) between ray and triangle.
        edges, edges_uv: of the triangle, in the world and in texture coordinates.
    """
    world, (first, second) = cross(*edges), edges_uv
    area_uv = (first.x * second.y - first.y * second.x).abs()

    def log(value: Tensor) -> Tensor:
        return torch.log(value.clamp_min(SMALLEST))

    return log(cone.width + cone.spread * t) - log(cosine.abs()) + 0.5 * log(area_uv) - 0.25 * log(dot(world, world))
