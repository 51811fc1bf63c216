"""Meshes of the library trimesh as arrays.

Their surface coordinates have v upwards, as in OBJ; here v points down, as in glTF. Colours are linear, as in glTF.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from torch_radbp.formats.leniency import Repairs
from torch_radbp.formats.mesh_arrays import SHORTEST_NORMAL, MeshArrays

if TYPE_CHECKING:
    import trimesh

RESERVED = ("positions", "normals", "texcoords", "color")  # names of attributes that mean something else here


class PlacedMesh(NamedTuple):
    """A mesh in a `trimesh.Scene`, at one node that shows it."""

    name: str
    mesh: trimesh.Trimesh
    to_world: np.ndarray  # (4, 4)


def note(place: str, what: str) -> None:
    """Warns that something is left out; within a strict reader it becomes an error."""
    with Repairs() as repairs:
        repairs.add(place, what)


def is_trimesh(value: Any) -> bool:
    """True for a `trimesh.Trimesh` or `trimesh.Scene`; works without importing trimesh."""
    trimesh = sys.modules.get("trimesh")
    return trimesh is not None and isinstance(value, trimesh.Trimesh | trimesh.Scene)


def placed_meshes(source: trimesh.Trimesh | trimesh.Scene) -> list[PlacedMesh]:
    """The meshes of a scene, node by node, or a single mesh; warns of point clouds and paths, which are left out.

    Raises:
        ValueError: if there are no triangles.
    """
    import trimesh
    if isinstance(source, trimesh.Trimesh):
        return [PlacedMesh("mesh", source, np.eye(4))]
    placed, left_out = [], {}
    for node in source.graph.nodes_geometry:
        to_world, name = source.graph[node]
        mesh = source.geometry[name]
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            placed.append(PlacedMesh(str(node), mesh, np.array(to_world, dtype=np.float64)))
        else:
            kind = "Trimesh without faces" if isinstance(mesh, trimesh.Trimesh) else type(mesh).__name__
            left_out[str(node)] = kind
    if not placed:
        others = ", ".join(f"{node}, a {kind}" for node, kind in left_out.items())
        raise ValueError(f"the trimesh.Scene has no triangles{others and f', only {others}'}")
    for node, kind in left_out.items():
        note(node, f"a {kind} of trimesh is left out: only triangles are rendered")
    return placed


def arrays_of(source: trimesh.Trimesh | trimesh.Scene) -> MeshArrays:
    """A mesh, or all meshes of a scene in the world, joined to one; see `mesh_arrays`."""
    return joined_meshes([transformed_mesh(mesh_arrays(placed.mesh), placed.to_world) for placed in placed_meshes(source)])


def mesh_arrays(mesh: trimesh.Trimesh) -> MeshArrays:
    """A mesh as arrays: vertex normals if it has any, uv, colours and attributes.

    It holds the normals that it was given, or that were asked of it (`mesh.vertex_normals`), as for trimesh's own writer of
    glTF; without any it is flat. Colours become `vertex_color` or `face_color`, fractions of 255.
    """
    visual, uv = mesh.visual, getattr(mesh.visual, "uv", None)
    attributes = {}
    for kind, rows, values in (("vertex", len(mesh.vertices), mesh.vertex_attributes),
                               ("face", len(mesh.faces), mesh.face_attributes)):
        for name, array in values.items():
            numbers = _column(array, rows)
            attribute = str(name).lstrip("_").replace(".", "_")
            if numbers is None or not attribute or attribute in RESERVED:
                note(f"the {kind} attribute {name!r} of trimesh", f"is left out: one of numbers, with one or three for each "
                     f"{kind}, and a name that is not another's, is read")
            else:
                attributes[f"{kind}_{attribute}"] = numbers
    name, colours = colours_of(visual)
    if name:
        if (colours[:, 3:] != 255).any():
            note("trimesh", "the opacity of colours (their fourth channel) is not read")
        attributes[name] = colours[:, :3] / 255.0
    if uv is not None and len(uv) == len(mesh.vertices):
        uv = np.array(uv, dtype=np.float64)[:, :2] * (1, -1) + (0, 1)
    else:
        uv = None
    return MeshArrays(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64), normals_of(mesh), uv,
                      attributes)


def _column(values: Any, rows: int) -> np.ndarray | None:
    """(rows, 1 or 3) float64 of an attribute; None if it has no such shape."""
    array = np.asarray(values)
    array = array[:, None] if array.ndim == 1 else array
    fits = array.ndim == 2 and array.shape[0] == rows and array.shape[1] in (1, 3)
    return array.astype(np.float64) if fits and array.dtype.kind in "iuf" else None


def colours_of(visual: Any) -> tuple[str, np.ndarray]:
    """The attribute that the colours of a mesh become, and (V or F, 4) bytes; an empty name if it has none."""
    if visual.kind in ("vertex", "face"):
        return f"{visual.kind}_color", np.asarray(getattr(visual, f"{visual.kind}_colors"))
    colours = getattr(visual, "vertex_attributes", {}).get("color")  # beside surface coordinates
    return ("", np.empty((0, 4))) if colours is None else ("vertex_color", np.asarray(colours))


def normals_of(mesh: trimesh.Trimesh) -> np.ndarray | None:
    """(V, 3) the vertex normals that a mesh stores; those of unused vertices, which trimesh leaves zero, point up."""
    if "vertex_normals" not in mesh._cache:  # the one place where trimesh keeps them
        return None
    normals = np.array(mesh.vertex_normals, dtype=np.float64)
    lone = np.linalg.norm(normals, axis=1) < SHORTEST_NORMAL
    lone[mesh.faces] = False
    normals[lone] = (0, 0, 1)
    return normals


def joined_meshes(parts: list[MeshArrays]) -> MeshArrays:
    """Joins several meshes to one; warns of columns that only some have, which are left out."""
    if len(parts) == 1:
        return parts[0]
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    columns = [{"normals": part.normals, "uv": part.uv, **part.attributes} for part in parts]
    names = {name for each in columns for name, values in each.items() if values is not None}
    shared = {name for name in names if all(each.get(name) is not None for each in columns)
              and len({each[name].shape[1] for each in columns}) == 1}
    if names - shared:
        note(", ".join(sorted(names - shared)), f"left out, since only some of {len(parts)} meshes that are joined have it")
    together = {name: np.concatenate([each[name] for each in columns]) for name in sorted(shared)}
    return MeshArrays(np.concatenate([part.vertices for part in parts]),
                      np.concatenate([part.faces + start for part, start in zip(parts, starts)]),
                      together.pop("normals", None), together.pop("uv", None), together)


def transformed_mesh(arrays: MeshArrays, to_world: np.ndarray) -> MeshArrays:
    """Transforms a mesh; after a mirroring transform it still faces outwards, as with `trimesh.apply_transform`."""
    linear, normals = to_world[:3, :3], arrays.normals
    if np.array_equal(to_world, np.eye(4)):
        return arrays
    if normals is not None:
        normals = normals @ np.linalg.inv(linear)
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    faces = arrays.faces[:, [0, 2, 1]] if np.linalg.det(linear) < 0 else arrays.faces
    return arrays._replace(vertices=arrays.vertices @ linear.T + to_world[:3, 3], faces=faces, normals=normals)
