"""Checks and converts the meshes and rays that are handed to ray casters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.instances import Instances
from torch_radbp.raycast.protocol import Ray

DTYPES = (torch.float32, torch.float64)
MOST_FETCHED = 64  # triangles of which a device is asked for all corners


class MeshExtremes(NamedTuple):
    """Numbers about a mesh that the host reads from its device at once, to check it and to choose a caster."""

    finite: bool  # in float32
    indices: tuple[int, int]  # the least and the greatest
    extent: float  # the greatest, along an axis; of instances that in the world
    corners: Sequence[float]  # of few triangles the 9 coordinates of each, in float32; else none
    unmoved: bool = False  # vertices and faces, those of groups included, are known to be those of the last caster

    @staticmethod
    def asked_of(vertices: Tensor, faces: Tensor, instances: Instances | None = None) -> list[Tensor]:
        """A mesh's extremes, the numbers of this record, as tensors on the device; none if invalid: that is checked later.

        Args:
            vertices: (V, 3).
            faces: (F, 3).
            instances: of parts of the mesh.
        """
        if vertices.ndim != 2 or faces.ndim != 2 or not vertices.numel() or not faces.numel() or faces.is_complex():
            return []
        points = vertices.detach().float().double()
        low, high = points.amin(0), points.amax(0)
        extent = (high - low).amax() if instances is None else instances.extent(points)
        corners = [points[faces.long().clamp(0, len(points) - 1)]] if len(faces) <= MOST_FETCHED else []
        return [torch.isfinite(low + high).all(), *faces.aminmax(), extent, *corners]

    @staticmethod
    def of(numbers: Sequence[float], unmoved: bool = False) -> MeshExtremes | None:
        """The record of a mesh's extremes, made of the fetched values of the tensors of `asked_of`; None without values."""
        if not numbers:
            return None
        finite, least, greatest, extent, *corners = numbers
        return MeshExtremes(bool(finite), (int(least), int(greatest)), extent, corners, unmoved)


def checked_vertices(vertices: Tensor, device: torch.device | None = None, finite: bool | None = None) -> Tensor:
    """A detached, contiguous copy of the vertices in their own dtype.

    Args:
        vertices: (V, 3).
        device: where they must be; None allows any.
        finite: whether all are finite in float32, if already known.

    Raises:
        ValueError: not (V, 3) float32 or float64, none at all, not finite in float32, or not as demanded.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ValueError(f"vertices must have shape (V, 3), got {tuple(vertices.shape)}")
    if vertices.dtype not in DTYPES:
        raise ValueError(f"vertices must be float32 or float64, got {vertices.dtype}")
    if device is not None and vertices.device != device:
        raise ValueError(f"this ray caster works on {device}, got vertices on {vertices.device}; use another one")
    if len(vertices) == 0:
        raise ValueError("a ray caster needs a mesh with at least one triangle, got no vertices")
    finite = bool(torch.isfinite(vertices.detach().float()).all()) if finite is None else finite
    if not finite:
        broken = ~torch.isfinite(vertices.detach().float()).all(dim=1)
        first = int(broken.nonzero()[0])
        raise ValueError(
            f"vertices must be finite in float32, got {int(broken.sum())} that are not, "
            f"the first of them vertex {first}: {vertices[first].tolist()}"
        )
    return vertices.detach().clone(memory_format=torch.contiguous_format)


def checked_faces(faces: Tensor, vertex_count: int, device: torch.device | None = None,
                  extremes: tuple[int, int] | None = None) -> Tensor:
    """A contiguous int32 copy of the faces.

    Args:
        faces: (F, 3).
        vertex_count: V.
        device: where they must be; None allows any.
        extremes: the least and the greatest index, if they are known.

    Raises:
        ValueError: not (F, 3) integers, none at all, not on `device`, or an index outside of [0, vertex_count).
    """
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"faces must have shape (F, 3), got {tuple(faces.shape)}")
    if faces.is_floating_point() or faces.is_complex() or faces.dtype == torch.bool:
        raise ValueError(f"faces must be integers (int32), got {faces.dtype}")
    if device is not None and faces.device != device:
        raise ValueError(f"this ray caster works on {device}, got faces on {faces.device}; use another one")
    if len(faces) == 0:
        raise ValueError("a ray caster needs a mesh with at least one triangle, got no faces")
    lowest, highest = (int(faces.min()), int(faces.max())) if extremes is None else extremes
    if lowest < 0 or highest >= vertex_count:
        raise ValueError(f"faces must index {vertex_count} vertices, got indices from {lowest} to {highest}")
    return faces.to(torch.int32, copy=True).contiguous()


def check_lanes(ray: Ray, tmax: Tensor | None, device: torch.device) -> None:
    """Raises ValueError unless all components have one shape, one dtype of float32 and float64, and this device."""
    first = ray.o.x
    components = dict(zip(("o.x", "o.y", "o.z", "d.x", "d.y", "d.z"), (*ray.o, *ray.d), strict=True))
    if tmax is not None:
        components["tmax"] = tmax
    for name, lanes in components.items():
        if lanes.shape != first.shape:
            raise ValueError(
                f"components of rays must have one shape: o.x has {tuple(first.shape)}, {name} has {tuple(lanes.shape)}"
            )
        if lanes.dtype not in DTYPES or lanes.dtype != first.dtype:
            raise ValueError(
                f"components of rays must be all float32 or all float64: o.x is {first.dtype}, {name} is {lanes.dtype}"
            )
        if lanes.device != device:
            raise ValueError(f"rays must be where their caster is, on {device}: {name} is on {lanes.device}")


def columns_of(lanes: Iterable[Tensor], dtype: torch.dtype) -> list[Tensor]:
    """Components of rays as the compiled loops read them, contiguous and of one dtype; copies only where needed."""
    return [column if column.dtype == dtype and column.is_contiguous() else column.detach().to(dtype).contiguous()
            for column in lanes]
