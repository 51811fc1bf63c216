"""The tables of tessellated spheres ("balls", see `interface.balls`) that the compiled ray casting loops read."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.balls import RINGS, SEGMENTS, TRIANGLES, Balls

LARGEST_STRETCH = 1e12  # of the map to the unit sphere, and its inverse; beyond, squares of lengths may overflow


class BallTables(NamedTuple):
    """The tessellated spheres of a mesh, as the ray casting loops read them; all floats have one dtype."""

    placements: Tensor  # (B, 12) centre, and by rows the map from there to the unit sphere
    triangles: Tensor  # (B, 2) int32, as `Ball.first` and `Ball.turned`
    count: Tensor  # () int64, B
    sectors: Tensor  # (SEGMENTS, 2) cosine and sine of the azimuth in the middle of a segment
    rings: Tensor  # (RINGS, 7) see `ring_table`


def ball_tables(balls: Balls, dtype: torch.dtype) -> BallTables:
    """Builds the tables of tessellated spheres that ray casting loops for rays of a dtype read."""
    placement = balls.placement.double()
    to_unit = torch.linalg.inv(placement[:, :3, :3])
    middle = (torch.arange(SEGMENTS, dtype=torch.float64) + 0.5) * (2 * math.pi / SEGMENTS)
    return BallTables(torch.cat([placement[:, :3, 3], to_unit.flatten(1)], 1).to(dtype).contiguous(),
                      torch.stack([balls.first, balls.turned.to(torch.int32)], 1).contiguous(),
                      torch.tensor(len(balls.first)), torch.stack([middle.cos(), middle.sin()], 1).to(dtype).contiguous(),
                      ring_table().to(dtype).contiguous())


def ring_table() -> Tensor:
    """The facets of each row of cells, (RINGS, 7) float64, in a frame where the facet's middle is at azimuth 0.

    With r the coordinate along the middle's azimuth, a facet is in the plane a r + b z = 1, and at height
    s = c r + d z + e in [0, 1] between its two edges of constant polar angle, which are 2 w0 and 2 w1 wide; the columns
    are a, b, c, d, e, w0, w1.
    """
    polar = torch.linspace(0, math.pi, RINGS + 1, dtype=torch.float64)
    half = math.pi / SEGMENTS
    r, z, wide = polar.sin() * math.cos(half), polar.cos(), polar.sin() * math.sin(half)
    wide[0] = wide[-1] = r[0] = r[-1] = 0.0  # the poles, but for rounding
    dr, dz = r.diff(), z.diff()
    along = dr**2 + dz**2
    off = r[:-1] * z[1:] - z[:-1] * r[1:]
    return torch.stack([dz / off, -dr / off, dr / along, dz / along, -(r[:-1] * dr + z[:-1] * dz) / along,
                        wide[:-1], wide[1:]], 1)


def castable(balls: Balls) -> Tensor:
    """(B,) bool: balls whose size neither overflows nor underflows in a ray caster."""
    values = torch.linalg.svdvals(balls.placement[:, :3, :3].double())
    return (values > 1 / LARGEST_STRETCH).all(1) & (values < LARGEST_STRETCH).all(1)


def other_triangles(faces: Tensor, balls: Balls) -> tuple[Tensor, Tensor]:
    """The triangles of a mesh that belong to no ball, (G, 3), and their numbers in the mesh, (G,) int32.

    If all belong to balls, the result is one degenerate triangle.
    """
    others = torch.ones(len(faces), dtype=torch.bool)
    others[(balls.first[:, None] + torch.arange(TRIANGLES)).long()] = False
    numbers = others.nonzero().squeeze(1)
    if len(numbers) == 0:
        return faces[:1, :1].expand(1, 3).contiguous(), torch.zeros(1, dtype=torch.int32)
    return faces[numbers].contiguous(), numbers.to(torch.int32)
