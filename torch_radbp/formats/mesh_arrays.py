"""A triangle mesh as arrays, and the steps that readers of mesh files share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from torch_radbp.formats.leniency import Repairs

FEW_CORNERS = "the face has fewer than 3 corners, and is left out"
SHORTEST_NORMAL, LONGEST_NORMAL = 1e-12, 1e12  # beyond these the direction is lost in float32


class MeshArrays(NamedTuple):
    """A triangle mesh as arrays, in the file's own coordinates."""

    vertices: np.ndarray  # (V, 3) float64
    faces: np.ndarray  # (F, 3) int64
    normals: np.ndarray | None  # (V, 3) float64, as in the file: not normalised; 0 where it has no usable one
    uv: np.ndarray | None  # (V, 2) float64, as in the file: the plugin applies `flip_tex_coords`
    attributes: Mapping[str, np.ndarray] = MappingProxyType({})  # (V, 1 or 3) vertex_NAME, (F, 1 or 3) face_NAME, float64


def fans(corners: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Triangulates polygons as fans around their first corners.

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


def used_by(faces: np.ndarray, rows: int) -> np.ndarray:
    """(rows,) bool: vertices, of 0 to `rows` - 1, that a face uses."""
    used = np.zeros(rows, bool)
    used[faces] = True
    return used


def usable_positions(vertices: np.ndarray, used: np.ndarray, place: Callable[[int], str]) -> np.ndarray:
    """The positions of vertices, with those that are not finite replaced if no face uses them.

    Raises:
        ValueError: names the `place` of the first vertex that a face uses and whose position is not finite.
    """
    check_finite("vertices", np.where(used[:, None], vertices, 0.0), place)
    bad = ~np.isfinite(vertices).all(axis=1)
    return _replaced(vertices, bad, vertices[np.argmax(used)], bad, place,
                     "the position is not finite; no face uses the vertex, and it is moved to another")


def usable_normals(normals: np.ndarray, used: np.ndarray, place: Callable[[int], str]) -> np.ndarray:
    """The normals, 0 where one has no direction; warns of those that faces use, at their `place`."""
    length = np.linalg.norm(normals, axis=1)
    bad = ~((length >= SHORTEST_NORMAL) & (length <= LONGEST_NORMAL))
    return _replaced(normals, bad, np.zeros(3), bad & used, place,
                     "the normal has no direction (zero or not finite), and is made from the triangles around")


def usable_uv(uv: np.ndarray, used: np.ndarray, place: Callable[[int], str]) -> np.ndarray:
    """Texture coordinates, (0, 0) where they are not finite; warns of those that faces use, at their `place`."""
    bad = ~np.isfinite(uv).all(axis=1)
    return _replaced(uv, bad, np.zeros(2), bad & used, place, "the texture coordinate is not finite, and read as (0, 0)")


def _replaced(values: np.ndarray, bad: np.ndarray, by: np.ndarray, told: np.ndarray, place: Callable[[int], str],
              what: str) -> np.ndarray:
    """A copy of `values` with `by` in the rows that are `bad`; warns of the rows `told`."""
    if told.any():
        with Repairs() as repairs:
            repairs.add_rows(np.flatnonzero(told).tolist(), place, what)
    return np.where(bad[:, None], by, values) if bad.any() else values
