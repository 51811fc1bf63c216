"""Scattering by flakes that reflect, of directions that differ, such as of fibres."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torch_radbp.interface.phase import PhaseFunction, PhaseKind
from torch_radbp.interface.volume import VolumeKind
from torch_radbp.plugin import Volume, finite, register
from torch_radbp.plugin.domain import LARGEST_AMOUNT, Domain
from torch_radbp.tensors.vec import TINY, Frame, Vec3, cross, dot, normalize
from torch_radbp.volume.constvolume import as_volume
from torch_radbp.volume.gridvolume import GridVolume

LEAST = 1e-12  # area of an ellipsoid
Rows = tuple[Vec3, ...]  # of a matrix
ROWS = ((0, 3, 4), (3, 1, 5), (4, 5, 2))  # of the matrix, by the numbers of channels


@dataclass(frozen=True)
class SGGXKind(PhaseKind):
    """The phase function of flakes, D(h) / (4 a(wi)), with the half vector h of wi and wo, the distribution of the flakes'
    normals, and their area as seen along wi

        D(h) = 1 / (pi sqrt(det S) (h . S^-1 h)^2),    a(wi) = sqrt(wi . S wi)

    The normals of the flakes that wi sees are sampled, and reflect it.
    """

    matrix: VolumeKind

    def eval_pdf(self, table: Any, p: Vec3, wi: Vec3, wo: Vec3) -> tuple[Tensor, Tensor]:
        s, h = self.rows_at(table, p), normalize(wi + wo)
        # S^-1 h has the cross products of the rows over the determinant.
        cofactors = cross(s[1], s[2]), cross(s[2], s[0]), cross(s[0], s[1])
        determinant = dot(s[0], cofactors[0]).clamp_min(TINY)
        squared = dot(h, times(cofactors, h)) / determinant
        value = 0.25 / (math.pi * torch.sqrt(determinant) * squared * squared * area_seen(s, wi))
        return value, value

    def sample(self, table: Any, p: Vec3, wi: Vec3, u: Tensor, v: Tensor) -> Vec3:
        # A point of the hemisphere around wi becomes a normal by the triangular root of S in a frame with wi.
        s, frame = self.rows_at(table, p), Frame.of(wi)
        of_s, of_t, of_n = times(s, frame.s), times(s, frame.t), times(s, frame.n)
        kk, kj, ki, jj, ji = (dot(frame.s, of_s), dot(frame.s, of_t), dot(frame.s, of_n), dot(frame.t, of_t),
                              dot(frame.t, of_n))
        ii = dot(frame.n, of_n).clamp_min(LEAST)
        plane = torch.sqrt((jj * ii - ji * ji).clamp_min(TINY))
        determinant = kk * jj * ii - kj * kj * ii - ki * ki * jj - ji * ji * kk + 2.0 * kj * ki * ji
        radius, phi, root = torch.sqrt(u), 2.0 * math.pi * v, torch.sqrt(ii)
        x, y, z = radius * torch.cos(phi), radius * torch.sin(phi), torch.sqrt((1.0 - u).clamp_min(0.0))
        along_s = x * torch.sqrt(determinant.clamp_min(TINY)) / plane + (z * ki - y * (ki * ji - kj * ii) / plane) / root
        normal = normalize(Vec3(along_s, (y * plane + z * ji) / root, z * root))
        facing = frame.to_world(normal)
        return normalize(facing * (2.0 * dot(wi, facing)) - wi)

    def projected_area(self, table: Any, p: Vec3, wi: Vec3) -> Tensor:
        return area_seen(self.rows_at(table, p), wi)

    def rows_at(self, table: Any, p: Vec3) -> Rows:
        """The rows of the flakes' matrix S at points in the world."""
        channels = self.matrix.values(table, p)
        return tuple(Vec3(*(channels[number] for number in row)) for row in ROWS)


def times(rows: Rows, v: Vec3) -> Vec3:
    """The product of a matrix, by its rows, and a vector."""
    return Vec3(*(dot(row, v) for row in rows))


def area_seen(rows: Rows, wi: Vec3) -> Tensor:
    """The area of flakes as seen along a direction."""
    return torch.sqrt(dot(wi, times(rows, wi)).clamp_min(LEAST))


@register("phase", "sggx")
class SGGX(PhaseFunction):
    """Scattering by flakes that reflect, whose normals are distributed as those of an ellipsoid: fibres, or sheets.

    Parameters: `S.data`, (Z, Y, X, 6). Derivatives: with respect to it. The extinction of the medium is multiplied by the
    area of the flakes as seen along a ray, which is 1 where S is the identity. Reference: Heitz, Dupuy, Crassin and
    Dachsbacher 2015, "The SGGX Microflake Distribution", with its listings.

    Args:
        S: the symmetric positive definite matrix of the ellipsoid, by xx, yy, zz, xy, xz and yz: six numbers, or a
            `gridvolume` of as many channels.

    Raises:
        ValueError: on another number of channels, or a matrix that is not positive definite.
    """

    def __init__(self, *, S: Volume | Tensor):
        super().__init__()
        if not isinstance(S, Volume):
            S = GridVolume(data=finite("S", S, (6,)).reshape(1, 1, 1, 6))
        self.S = as_volume(self, "S", S, (6,))
        entries = self.S.samples()
        least = float(torch.linalg.eigvalsh(entries.detach().double()[..., torch.tensor(ROWS)]).min())
        if least <= 0.0:
            raise ValueError(f"S of sggx must be positive definite, got a matrix with the eigenvalue {least:g}")

    def domains(self) -> dict[str, Domain]:
        return {"S": Domain(limit=LARGEST_AMOUNT)}

    def kind(self) -> SGGXKind:
        return SGGXKind(self.S.kind())

    def row(self) -> Any:
        return self.S.table()

    def extreme_areas(self) -> tuple[Tensor, Tensor]:
        # Roots of eigenvalues, of which the largest is not more than the trace, and none is less than by how much a diagonal
        # entry exceeds the others of its row (Gershgorin 1931); interpolation does not exceed them.
        xx, yy, zz, xy, xz, yz = self.S.samples().detach().unbind(-1)
        rows = xx - xy.abs() - xz.abs(), yy - xy.abs() - yz.abs(), zz - xz.abs() - yz.abs()
        least = torch.stack([row.amin() for row in rows]).amin()
        return (xx + yy + zz).amax().clamp_min(LEAST).sqrt(), least.clamp_min(0.0).sqrt()

    def even_area(self) -> bool:
        entries = self.S.samples()
        return entries[..., 0].numel() == 1
