"""Reads the primitives of a glTF mesh as triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from torch_radbp.io.gltf.accessor import Buffers
from torch_radbp.io.gltf.document import DocumentPart, Losses
from torch_radbp.shape.normals import angle_weighted_normals

TRIANGLES, STRIP, FAN = 4, 5, 6
MODES = {0: "points", 1: "lines", 2: "line loops", 3: "line strips"}
SETS = 2  # of surface coordinates: TEXCOORD_0 and TEXCOORD_1
SHORTEST = 1e-6  # of normals
ROUNDING = 1e-5  # by which colours may leave [0, 1] unsaid


class Primitive(NamedTuple):
    """A glTF primitive as triangles in the node's frame, float64 and int64."""

    positions: np.ndarray  # (V, 3)
    faces: np.ndarray  # (F, 3)
    normals: np.ndarray | None  # (V, 3)
    uv: tuple[np.ndarray | None, ...]  # (V, 2) of each set
    colour: np.ndarray | None  # (V, 3) linear RGB
    custom: dict[str, np.ndarray]  # (V, 1 or 3) custom attributes, by their lower-case names without the leading underscore

    def numbers(self) -> int:
        """The number of scalars in all its arrays."""
        arrays = (self.positions, self.faces, self.normals, self.colour, *self.uv, *self.custom.values())
        return sum(array.size for array in arrays if array is not None)


class Primitives:
    """Reads the primitives of a document, once however many nodes show them."""

    def __init__(self, buffers: Buffers, losses: Losses):
        self.buffers, self.losses = buffers, losses
        self.cached: dict[str, Primitive | None] = {}

    def of(self, part: DocumentPart) -> Primitive | None:
        """Reads the triangles of a primitive; None for points and lines.

        Raises:
            SceneError: if it is damaged, or the scene has too many numbers with it.
        """
        if part.place not in self.cached:
            self.cached[part.place] = read_primitive(part, self.buffers, self.losses)
        elif self.cached[part.place] is not None:
            self.buffers.claim(part, self.cached[part.place].numbers())
        return self.cached[part.place]


def read_primitive(part: DocumentPart, buffers: Buffers, losses: Losses) -> Primitive | None:
    """Reads the triangles of a primitive; None, with a note, for points and lines, and without triangles."""
    mode = part.integer("mode", TRIANGLES, high=6)
    if mode in MODES:
        losses.add(part.place, f"{MODES[mode]} are not read")
        return None
    attributes = part.part("attributes")
    if not attributes.has("POSITION"):
        losses.add(part.place, "is left out: it has no POSITION")
        return None

    def array(name: str, *types: str) -> np.ndarray | None:
        elements = buffers.array(attributes.integer(name), attributes, name, types) if attributes.has(name) else None
        if elements is not None and len(elements) != len(positions):
            raise attributes.fail(f"{name} has {len(elements)} elements, POSITION has {len(positions)}")
        return elements

    positions = buffers.array(attributes.integer("POSITION"), attributes, "POSITION", ("VEC3",)).astype(np.float64)
    corners = np.arange(len(positions))
    if part.has("indices"):
        corners = buffers.array(part.integer("indices"), part, "indices", ("SCALAR",))[:, 0]
        least, greatest = corners.min(initial=0), corners.max(initial=-1)
        if corners.dtype.kind != "i" or least < 0 or greatest >= len(positions):
            raise part.fail(f"indices must be integers from 0 to {len(positions) - 1}, got {least} to {greatest}")
    if len(corners) < 3:
        losses.add(part.place, "is left out: it has no triangles")
        return None
    if mode == TRIANGLES and len(corners) % 3:
        losses.add(part.place, "the corners at the end that make no whole triangle are left out")
        corners = corners[:len(corners) // 3 * 3]
    faces = triangles(corners, mode)
    colour = array("COLOR_0", "VEC3", "VEC4")
    if colour is not None:
        if colour.dtype.kind != "f" or not colour.min() >= -ROUNDING:
            raise attributes.fail(f"COLOR_0 must be in [0, 1], got {colour.min():.9g} to {colour.max():.9g}")
        if colour.max() > 1 + ROUNDING:
            losses.add(f"{part.place} (up to {colour.max():g})", "colours of vertices (COLOR_0) above 1 are read as 1")
        colour = colour.clip(0, 1)
        if colour.shape[1] == 4 and (colour[:, 3] != 1).any():
            losses.add(part.place, "the opacity of vertices (alpha of COLOR_0) is not read")
    custom = {name[1:].lower(): array(name, "SCALAR", "VEC3").astype(np.float64) for name in attributes.value
              if name.startswith("_") and is_own(name)}
    for name in attributes.value:
        if name.startswith(("JOINTS_", "COLOR_")) and name != "COLOR_0" or name in ("TEXCOORD_2", "TEXCOORD_3"):
            losses.add(part.place, f"{name} is not read")
    if part.has("targets"):
        losses.add(part.place, "morph targets are not read: the mesh has its basic form")
    uv = tuple(finite_uv(array(f"TEXCOORD_{number}", "VEC2"), part, losses) for number in range(SETS))
    return Primitive(positions, faces, usable(array("NORMAL", "VEC3"), positions, faces, part, losses), uv,
                     None if colour is None else colour[:, :3], custom)


def is_own(name: str) -> bool:
    """True for the name of a custom vertex attribute that can become the name of a mesh's parameter."""
    return name[1:].isidentifier() and name[1:].lower() not in ("positions", "normals", "texcoords", "color")


def finite_uv(uv: np.ndarray | None, part: DocumentPart, losses: Losses) -> np.ndarray | None:
    """Texture coordinates, (0, 0) where they are not finite."""
    bad = np.zeros(0, bool) if uv is None else ~np.isfinite(uv).all(axis=1)
    if not bad.any():
        return uv
    losses.add(f"{part.place} ({bad.sum()} of {len(bad)})", "surface coordinates that are not finite are read as (0, 0)")
    return np.where(bad[:, None], 0.0, uv)


def triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    """(F, 3) corners of triangles from a list, a strip or a fan."""
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    if mode == FAN:
        return np.stack([corners[1:-1], corners[2:], np.full(len(corners) - 2, corners[0])], axis=1)
    odd = np.arange(len(corners) - 2) % 2
    first = np.arange(len(corners) - 2)
    return corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]


def usable(normals: np.ndarray | None, positions: np.ndarray, faces: np.ndarray, part: DocumentPart,
           losses: Losses) -> np.ndarray | None:
    """The normals; those without a direction are computed from the triangles around the vertex."""
    if normals is None:
        return None
    length = np.linalg.norm(normals.astype(np.float64), axis=1)
    bad = ~((length >= SHORTEST) & (length < np.inf))
    if not bad.any() or not np.isfinite(positions).all():
        return normals.astype(np.float64)
    place = f"{part.place} ({bad.sum()} of {len(bad)})"
    losses.add(place, "normals that are zero or not finite are made from the triangles around")
    made = angle_weighted_normals(torch.from_numpy(positions), torch.from_numpy(np.ascontiguousarray(faces))).numpy()
    return np.where(bad[:, None], made, normals)
