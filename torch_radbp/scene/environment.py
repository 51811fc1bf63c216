"""Light from far away as a function of direction: looking up the environment map, and picking directions from it.

A direction d has local coordinates l = W d / |W d|, W the inverse of the linear part of `to_world`, and texture coordinates

    u = atan2(l_x, -l_z) / (2 pi),   v = atan2(sqrt(l_x^2 + l_z^2), l_y) / pi

of which u is periodic. A density q over local solid angle is q |det W| / |W d|^3 over world solid angle, so that a pose that
is not rigid (an optimiser's, on the way) still has the right density.

The density with which directions are picked jumps from cell to cell. Weights of multiple importance sampling must not: where
directions of BSDF samples carry derivatives, each jump would be an edge that moves over the samples, of which a derivative
knows nothing (measured: 7% of the derivative of a plane that turns under a bright block). Any weights that add up to 1 are
right, so they are made of a continuous density, `environment_weighing`.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_radbp.lookup import lookup
from torch_radbp.scene.tensors import EnvironmentMap, SceneTensors
from torch_radbp.vec import TINY, Frame, Vec2, Vec3, cross, dot

LEAST_WEIGHING = 1e-7  # per steradian; keeps quotients of densities finite
NEAR_POLE = 1e-12  # squared distance from the axis below which the longitude is undefined


def environment_radiance(scene: SceneTensors, d: Vec3) -> Vec3:
    """Radiance that arrives from directions, bilinearly interpolated.

    Args:
        scene: attached; gives the pose and the texels.
        d: (N,) unit directions away from the scene, attached.
    """
    environment = scene.lights.environment
    local, _ = local_direction(environment, d)
    uv = latitude_longitude(local)
    corner, fx, fy = texels_around(environment, uv)
    first = lookup(scene.radiance.offset, scene.lights.surround.expand(d.x.shape))
    upper, lower = (lookup(scene.radiance.texels, left + first) * (1.0 - fx)
                    + lookup(scene.radiance.texels, right + first) * fx for left, right in (corner[:2], corner[2:]))
    return upper * (1.0 - fy) + lower * fy


def environment_pdf(scene: SceneTensors, proposal: SceneTensors, d: Vec3) -> Tensor:
    """Density over solid angle of `sample_environment`, (N,): the pose is of `scene`, the probabilities of `proposal`."""
    local, jacobian = local_direction(scene.lights.environment, d)
    uv = latitude_longitude(local.detach())
    environment = proposal.lights.environment
    columns = environment.columns
    column = torch.remainder(torch.floor(uv.x * columns - 0.5).to(torch.int32), columns)
    cells = (environment.rows - 1).clamp_min(1)  # from pole to pole
    row = torch.minimum((uv.y * cells).to(torch.int32), cells - 1).clamp_min(0)
    return lookup(environment.density, row * columns + column) * jacobian


def environment_weighing(proposal: SceneTensors, d: Vec3) -> Tensor:
    """A continuous substitute for `environment_pdf` in the weights of multiple importance sampling, (N,).

    It is proportional to the interpolated image, and almost zero wherever directions are never picked. It is attached to
    `d`, but not to the pose.
    """
    environment = proposal.lights.environment
    local, jacobian = local_direction(environment, d)
    uv = latitude_longitude(local)
    corner, fx, fy = texels_around(environment, uv)
    upper, lower = (lookup(environment.weighing, left) * (1.0 - fx) + lookup(environment.weighing, right) * fx
                    for left, right in (corner[:2], corner[2:]))
    return ((upper * (1.0 - fy) + lower * fy) * jacobian).clamp_min(LEAST_WEIGHING)


def texels_around(environment: EnvironmentMap, uv: Vec2) -> tuple[tuple[Tensor, Tensor, Tensor, Tensor], Tensor, Tensor]:
    """The texels above left, above right, below left and below right of a point, and how far it is from the first.

    Returns:
        The indices, int32, and the distances across and down, in [0, 1], attached.
    """
    x = uv.x * environment.columns - 0.5
    y = uv.y * (environment.rows - 1)
    left, top = torch.floor(x.detach()), torch.floor(y.detach())
    column, row = left.to(torch.int32), top.to(torch.int32)
    x0, x1 = torch.remainder(column, environment.columns), torch.remainder(column + 1, environment.columns)
    # Row and column of what is NaN are arbitrary integers, and must not lead out of the image.
    row, last = row.clamp_min(0), environment.rows - 1
    y0, y1 = torch.minimum(row, last) * environment.columns, torch.minimum(row + 1, last) * environment.columns
    return (y0 + x0, y0 + x1, y1 + x0, y1 + x1), x - left, y - top


def sample_environment(proposal: SceneTensors, u: Tensor, v: Tensor) -> tuple[Vec3, Tensor]:
    """Unit directions towards bright parts of the environment, and their density over solid angle; detached.

    Args:
        proposal: detached.
        u, v: (N,) uniform numbers, float64 with 32 random bits: an image has more texels than 24 bits tell apart.
    """
    environment = proposal.lights.environment
    cell = environment.pick.sample(u, v)
    dtype, columns = environment.density.dtype, environment.columns
    # Uniform over solid angle: uniform in sin^2(theta / 2), and in longitude from the centre of a column to the next.
    upper = lookup(environment.edges, cell.row)
    h = upper + (lookup(environment.edges, cell.row + 1) - upper) * cell.down.to(dtype)
    phi = (cell.across + cell.column + 0.5).to(dtype) * (2.0 * math.pi) / columns
    across = 2.0 * torch.sqrt((h * (1.0 - h)).clamp_min(0.0))
    local = Vec3(across * torch.sin(phi), 1.0 - 2.0 * h, -across * torch.cos(phi))
    d = environment.to_world.to_local(local)
    squared = dot(d, d).clamp_min(TINY)
    density = lookup(environment.density, cell.row * columns + cell.column)
    return d * torch.rsqrt(squared), density * environment.volume * squared * torch.sqrt(squared)


def local_direction(environment: EnvironmentMap, d: Vec3) -> tuple[Vec3, Tensor]:
    """The unit directions in which the map is read, and their solid angle per solid angle in the world."""
    only = torch.zeros_like(d.x, dtype=torch.int32)
    to_local = Frame(*(lookup(row, only) for row in environment.to_local))
    local = to_local.to_local(d)
    shrink = torch.rsqrt(dot(local, local).clamp_min(TINY))
    return local * shrink, determinant(to_local) * shrink * shrink * shrink


def determinant(rows: Frame) -> Tensor:
    """The absolute value of the determinant of the matrix with these rows."""
    return dot(rows.s, cross(rows.t, rows.n)).abs()


def latitude_longitude(local: Vec3) -> Vec2:
    """Texture coordinates of unit directions: u in [0, 1), periodic; v in [0, 1], 0 at +y. Finite at the poles."""
    squared = local.x * local.x + local.z * local.z
    away = squared.detach() > NEAR_POLE
    x, z = torch.where(away, local.x, 0.0), torch.where(away, local.z, -1.0)
    u = torch.atan2(x, -z) * (0.5 / math.pi)
    v = torch.atan2(torch.sqrt(squared.clamp_min(NEAR_POLE)), local.y) * (1.0 / math.pi)
    return Vec2(u - torch.floor(u.detach()), v)
