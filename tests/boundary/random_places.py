"""Random triangles, and eyes in and around them."""

from __future__ import annotations

import torch

from torch_radbp.boundary.curve.faces import Faces
from torch_radbp.boundary.curve.geometry import Geometry, NormalsOnly
from torch_radbp.boundary.eye.eyes import Eyes, Lobe
from torch_radbp.scene.tables.scene_tensors import TriangleTable, VertexTable
from torch_radbp.tensors.vec import Vec3, normalize, rows


def eyes_around(count: int = 200) -> Eyes:
    """Points in and around the scene, on surfaces, on such that are lit from behind or not, and on none; and directions.

    Each has a wide lobe, and some a narrow one.
    """
    numbers = torch.randn(count, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    place, n = (Vec3.of(part) for part in numbers.split(3, 1))
    kind = torch.arange(count) % 4
    n = normalize(n).map(lambda c: torch.where(kind == 0, 0.0, c))
    narrow = 100.0 * (numbers[:, 0] > 0).double()
    lobes = Lobe(normalize(-place), torch.ones_like(narrow)), Lobe(normalize(n - place), narrow)
    return Eyes(place, (kind != 3).double(), n, (kind == 1).double(), 0.1 * (kind == 2).double(), lobes)


def of_each(eyes: Eyes, count: int) -> Eyes:
    """Each eye so many times in a row."""
    return rows(eyes, torch.arange(len(eyes.w)).repeat_interleave(count))


def triangles(count: int, bodies: int) -> tuple[Geometry, Faces, torch.Tensor]:
    """So many random triangles, and how many those of each body are."""
    p = torch.rand(count, 1, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(count)) + 0.3 * torch.randn(
        count, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    corners = tuple(3 * torch.arange(count, dtype=torch.int32) + k for k in range(3))
    nothing = dict.fromkeys(TriangleTable._fields[2:9])
    table = TriangleTable(vertices=VertexTable(Vec3.of(p.flatten(0, 1)), None, None, ()), corners=corners, attributes=(),
                          **nothing)
    sizes = torch.full((bodies,), count // bodies)
    return Geometry(table, NormalsOnly(False)), Faces(torch.arange(count, dtype=torch.int32), None, None), sizes
