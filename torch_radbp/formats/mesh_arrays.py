"""A triangle mesh as arrays, and the steps that readers of mesh files share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

SHORTEST_NORMAL, LONGEST_NORMAL = 1e-12, 1e12  # beyond these the direction is lost in float32


class MeshArrays(NamedTuple):
    """A triangle mesh in the file's own coordinates."""

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3) int64
    normals: np.ndarray | None  # (V, 3) float64, as in the file: not normalised
    uv: np.ndarray | None  # (V, 2) float64, as in the file: `flip_tex_coords` is the plugin's business
    attributes: Mapping[str, np.ndarray] = MappingProxyType({})  # (V, 1 or 3) vertex_NAME, (F, 1 or 3) face_NAME, float64


def fans(corners: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Triangulates polygons, each as a fan around its first corner.

    Args:
        corners: (C,) what is to be in the triangles, polygon after polygon.
        counts: (P,) the number of corners of each polygon, 3 or more.

    Returns:
        (T, 3) of the dtype of `corners`, in the order of the polygons.
    """
    if (counts == 3).all():
        return corners.reshape(-1, 3)
    triangles = counts - 2
    begin = np.repeat(np.cumsum(counts) - counts, triangles)
    step = np.arange(triangles.sum()) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([corners[begin], corners[begin + step + 1], corners[begin + step + 2]], axis=1)


def check_finite(name: str, values: np.ndarray, place: Callable[[int], str]) -> None:
    """Raises ValueError with the `place` of the first row of `values` that is not finite."""
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        raise ValueError(f"{place(int(np.argmax(bad)))}: {name} must be finite, {int(bad.sum())} of {len(bad)} are NaN or "
                         "infinite")


def check_normals(normals: np.ndarray, place: Callable[[int], str]) -> None:
    """Raises ValueError with the `place` of the first normal without a direction; Mitsuba's OBJ reader does the same."""
    length = np.linalg.norm(normals, axis=1)
    bad = ~((length >= SHORTEST_NORMAL) & (length <= LONGEST_NORMAL))
    if bad.any():
        first = int(np.argmax(bad))
        raise ValueError(f"{place(first)}: a normal must have a length between {SHORTEST_NORMAL:g} and {LONGEST_NORMAL:g}, "
                         f"got {length[first]:g}; give face_normals or recompute_normals to do without the file's normals")
