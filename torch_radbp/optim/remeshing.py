"""Remeshing of a mesh while it is optimised."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.formats.trimesh_arrays import is_trimesh
from torch_radbp.optim.adjacency import welded_vertices
from torch_radbp.optim.closest import closest_points
from torch_radbp.optim.large_steps import LargeSteps
from torch_radbp.shape.mesh import Mesh
from torch_radbp.shape.surface import turned
from torch_radbp.transforms import transform_points

if TYPE_CHECKING:
    import trimesh

POSITIONS = "vertex_positions"


def remesh(mesh: Mesh, remesher: Callable | trimesh.Trimesh, optimizer: torch.optim.Optimizer | None = None) -> None:
    """Replaces the triangles of a mesh, and transfers attributes and the optimizer's state from the old ones.

    Normals, surface coordinates and attributes of vertices are those of the closest points of the old mesh, interpolated,
    and attributes of faces those of the triangles there; so is what the optimizer has of them, such as moments. A
    `LargeSteps` of the positions is made anew, as smooth as it was. Seams of surface coordinates are not kept: vertices at
    one place are one before the remesher sees them.

    Args:
        mesh: of a scene; its group may be shown by instances.
        remesher: takes vertices (V, 3) and faces (F, 3), numpy arrays of float64 and int64, and returns others; such as
            `gpytoolbox.remesh_botsch`, or `lambda v, f: trimesh.remesh.subdivide(v, f)`. It may return a `trimesh.Trimesh`.
            Or what comes in the place, a `trimesh.Trimesh` in world space, such as `mesh.to_trimesh().subdivide()`; vertices
            at one place become one. Only vertices and faces of a `trimesh.Trimesh` count.
        optimizer: what holds parameters of the mesh; None: nothing does.

    Raises:
        TypeError: if it is no mesh with vertex positions, or the remesher can neither be called nor is a mesh.
        ValueError: if what the remesher returns is none, or the positions have another parametrisation than `LargeSteps`.

    Reference: Botsch and Kobbelt 2004, "A Remeshing Approach to Multiresolution Modeling", for what a remesher does.
    """
    if not isinstance(mesh, Mesh):
        raise TypeError(f"remesh takes a mesh with vertex_positions, got {type(mesh).__name__}")
    if not callable(remesher) and not is_trimesh(remesher):
        raise TypeError("remesher must be a function of vertices and faces, or a trimesh.Trimesh, got "
                        f"{type(remesher).__name__}")
    steps, held = large_steps_of(mesh), _parameters_of(mesh)
    faces, positions = mesh.faces.cpu(), mesh.vertex_positions.detach().double().cpu()
    place, count = welded_vertices(positions)
    places = torch.zeros(count, 3, dtype=torch.float64).index_copy_(0, place, positions)
    if is_trimesh(remesher):
        vertices, triangles = in_the_place(mesh, remesher)
    else:
        vertices, triangles = checked_mesh(remesher(places.numpy(), place[faces].numpy()))
    at_vertices = closest_points(vertices, positions, faces)
    at_faces = closest_points(vertices[triangles].mean(1), positions, faces)

    def carried(name: str, rows: Tensor) -> Tensor:
        """Transfers rows of vertices or faces from the old mesh to the new one."""
        return at_faces.of_faces(rows) if name.startswith("face_") else at_vertices.of_vertices(rows, faces)

    columns = {name: carried(name, parameter.detach()) for name, parameter in held.items() if name != POSITIONS}
    if "vertex_normals" in columns:
        columns["vertex_normals"] = torch.nn.functional.normalize(columns["vertex_normals"], dim=1)
    if steps is not None:
        parametrize.remove_parametrizations(mesh, POSITIONS)
    mesh.replace(vertices.to(mesh.vertex_positions), triangles, columns)
    at_places = at_vertices
    if steps is not None:
        made, old_positions = LargeSteps(mesh.faces, mesh.vertex_positions, steps.smoothness), mesh.vertex_positions.detach()
        old_positions = old_positions.new_zeros(made.count, 3).index_copy_(0, made.place, old_positions)
        at_places = closest_points(old_positions.double().cpu(), positions, faces)
        parametrize.register_parametrization(mesh, POSITIONS, made)
    for name, parameter in _parameters_of(mesh).items():
        parameter.requires_grad_(held[name].requires_grad)
        if optimizer is not None:
            smooth = steps is not None and name == POSITIONS
            exchange(optimizer, held[name], parameter,
                     (lambda rows: at_places.of_vertices(rows, place[faces])) if smooth else partial(carried, name))


def checked_mesh(returned: Any) -> tuple[Tensor, Tensor]:
    """Checks the vertices, (V, 3) float64, and faces, (F, 3) int64, that a remesher returned, or those of a trimesh mesh.

    Raises:
        ValueError: if they are none: another number or shape, NaN or infinity, faces of vertices that do not exist.
    """
    says = "the remesher must return vertices (V, 3) and faces (F, 3)"
    if is_trimesh(returned) and hasattr(returned, "faces"):  # which a scene has not
        returned = (returned.vertices, returned.faces)
    if not isinstance(returned, (tuple, list)) or len(returned) != 2:
        got = f"{len(returned)} values" if isinstance(returned, (tuple, list)) else type(returned).__name__
        raise ValueError(f"{says}, got {got}")
    try:
        vertices, faces = (torch.as_tensor(np.array(part) if isinstance(part, np.ndarray) else part).detach().cpu()
                           for part in returned)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{says}, got {' and '.join(type(part).__name__ for part in returned)}") from None
    if any(part.ndim != 2 or part.shape[1] != 3 or len(part) == 0 for part in (vertices, faces)):
        raise ValueError(f"{says}, one or more of each, got {tuple(vertices.shape)} and {tuple(faces.shape)}")
    if vertices.is_complex() or faces.is_floating_point() or faces.is_complex() or faces.dtype == torch.bool:
        raise ValueError(f"{says}, numbers and whole numbers, got {vertices.dtype} and {faces.dtype}")
    if not vertices.isfinite().all():
        bad = int((~vertices.isfinite()).any(1).sum())
        raise ValueError(f"the remesher returned {bad} of {len(vertices)} vertices that are NaN or infinite")
    faces = faces.long()
    if not 0 <= int(faces.min()) <= int(faces.max()) < len(vertices):
        raise ValueError(f"the remesher returned faces of the vertices {int(faces.min())} to {int(faces.max())}; there are "
                         f"{len(vertices)}, from 0 to {len(vertices) - 1}")
    return vertices.double(), faces


def in_the_place(mesh: Mesh, made: trimesh.Trimesh) -> tuple[Tensor, Tensor]:
    """Converts a trimesh mesh, welded, to positions (V, 3) and faces (F, 3) in the frame of a mesh's parameters.

    The frame is that in which the mesh was loaded; the faces are as they are before `flip_normals`.
    """
    vertices, triangles = checked_mesh(made)
    place, count = welded_vertices(vertices)
    vertices = torch.zeros(count, 3, dtype=torch.float64).index_copy_(0, place, vertices)
    back = torch.linalg.inv(mesh.motion().detach().double().cpu())
    triangles = place[triangles]
    return transform_points(back, vertices), turned(triangles) if mesh.flip_normals else triangles


def large_steps_of(mesh: Mesh) -> LargeSteps | None:
    """The `LargeSteps` parametrisation of a mesh's positions; None: there is none."""
    if not parametrize.is_parametrized(mesh, POSITIONS):
        return None
    steps = list(mesh.parametrizations[POSITIONS])
    if len(steps) != 1 or not isinstance(steps[0], LargeSteps):
        raise ValueError(f"the positions have the parametrisation {', '.join(type(each).__name__ for each in steps)}; only "
                         f"LargeSteps is carried over: remove it, and register it again")
    return steps[0]


def _parameters_of(mesh: Mesh) -> dict[str, nn.Parameter]:
    """The parameters with a row for each vertex or face, by name; for parametrised positions what is optimised."""
    names = [name for name in (POSITIONS, "vertex_normals", "vertex_texcoords", *mesh.attribute_names)
             if name in dict(mesh.named_parameters(recurse=False)) or parametrize.is_parametrized(mesh, name)]
    return {name: mesh.parametrizations[name].original if parametrize.is_parametrized(mesh, name) else getattr(mesh, name)
            for name in names}


def exchange(optimizer: torch.optim.Optimizer, old: nn.Parameter, new: nn.Parameter,
             carried: Callable[[Tensor], Tensor]) -> None:
    """Replaces a parameter in an optimizer, and transfers the state of its rows."""
    for group in optimizer.param_groups:
        group["params"] = [new if parameter is old else parameter for parameter in group["params"]]
    state = optimizer.state.pop(old, None)
    if state is not None:
        rows = {key: carried(value) if isinstance(value, Tensor) and value.shape == old.shape else value
                for key, value in state.items()}
        optimizer.state[new] = rows
