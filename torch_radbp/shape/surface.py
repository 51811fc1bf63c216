"""The base class of surfaces: placement, material, emission and triangles."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.balls import Ball
from torch_radbp.plugin import BSDF, REGISTRY, Emitter, Medium, Shape
from torch_radbp.plugin.domain import POSE, Domain
from torch_radbp.transforms import mirrors, transform, transform_normals, transform_points

if TYPE_CHECKING:
    import trimesh


class Triangles(NamedTuple):
    """World-space triangles of one shape, attached to its parameters."""

    vertices: Tensor  # (V, 3)
    faces: Tensor  # (F, 3) integers
    normals: Tensor | None  # (V, 3) unit shading normals, or None for flat faces
    uv: Tensor | None  # (V, 2)
    ball: Ball | None = None  # the sphere (or several) that the triangles tessellate; None: none
    attributes: tuple[tuple[str, Tensor], ...] = ()  # (V, 1 or 3) or (F, 1 or 3), by names that begin with vertex_ or face_


def turned(faces: Tensor) -> Tensor:
    """(F, 3) faces turned inside out."""
    return faces[:, [0, 2, 1]]


class Surface(Shape):
    """A shape with a material, and perhaps an area emitter; without a material it is grey, or black if it emits light.

    A mirroring transform turns faces inside out. Mitsuba keeps the normal of the untransformed surface then, and so do the
    analytic shapes here, but for the sphere, whose normals it turns there and here.

    Args:
        bsdf: the material.
        emitter: a light that shines from the surface, such as `area`.
        flip_normals: turn the surface inside out.
        to_world: the pose, world from local; affine.
        interior: the medium behind the surface, on the side away from its normal.
        exterior: the medium before it. Without both the surface is no boundary: what is before it is behind it, too; with
            one of them, nothing is on the other side.
    """

    converter: ClassVar[Callable[[Surface], trimesh.Trimesh]]  # set by `torch_radbp.io.trimesh_out`
    faces: Tensor  # (F, 3) int64: `triangles()` has as many, in the same order
    may_cross_itself = False  # its vertices may move so that it passes through itself

    def __init__(self, *, bsdf: BSDF | None = None, emitter: Emitter | None = None, flip_normals: bool = False,
                 interior: Medium | None = None, exterior: Medium | None = None):
        super().__init__()
        diffuse = REGISTRY["bsdf"]["diffuse"]
        self.bsdf = diffuse(reflectance=0.5 if emitter is None else 0.0) if bsdf is None else bsdf
        if emitter is not None and not emitter.kind().on_surface:
            raise ValueError(f"a shape can carry an emitter that shines from surfaces, such as area; got {emitter.type!r}, "
                             f"which belongs to the scene itself")
        self.add_module("emitter", emitter)
        self.flip_normals = flip_normals
        self.add_module("interior", interior)
        self.add_module("exterior", exterior)

    @property
    def bounds_media(self) -> bool:
        """True if the surface is a boundary of a medium."""
        return self.interior is not None or self.exterior is not None

    def connections(self) -> tuple[Callable[..., NamedTuple], tuple[Any, ...]] | None:
        """A function that computes detached facts about the shape for `triangles`, such as its topology, and its arguments.

        Returns:
            A function of a module and its arguments, tensors and plain values, attached or not; None: there is none.
        """
        return None

    def to_trimesh(self) -> trimesh.Trimesh:
        """The shape as a `trimesh.Trimesh` with current values: in world space, detached, float64.

        It has the normals that the shape is shaded by (none if it is flat), surface coordinates with v upwards, attributes
        without the prefix of their names, and the material as `save` writes it to glTF, a `PBRMaterial` (trimesh keeps
        colours in 8 bits); base colours that are an attribute of the mesh are `visual.vertex_colors` or
        `visual.face_colors`, and no material is beside them. What trimesh has no place for is named in one `SceneWarning`.
        """
        return self.converter(self)

    def triangles(self) -> Triangles:
        """The shape as triangles in world space; results of `connections` may be passed, or else are computed."""
        raise TypeError(f"{type(self).__name__} does not define its triangles")

    def oriented(self, *connections: NamedTuple) -> Triangles:
        """`triangles()`, turned inside out if `flip_normals` is set; `connections`: the result of that method's function."""
        surface = self.triangles(*connections)
        if not self.flip_normals:
            return surface
        normals = None if surface.normals is None else -surface.normals
        ball = surface.ball
        ball = None if ball is None else ball._replace(turned=tuple(not each for each in ball.turned))
        return surface._replace(faces=turned(surface.faces), normals=normals, ball=ball)


class Tessellated(Surface):
    """An analytic shape: a fixed tessellation of its canonical form under `to_world`.

    Parameters: `to_world` (4, 4).
    """

    turned_by_mirrors = False  # a mirroring transform turns the normals to the other side

    def domains(self) -> dict[str, Domain]:
        return {"to_world": POSE}

    def place(self, to_world: Tensor | None, surface: Triangles) -> None:
        """Stores the canonical tessellation and the transform."""
        self.freeze("to_world", transform("to_world", to_world))
        self.tessellate(surface)

    def tessellate(self, surface: Triangles) -> None:
        """Stores the canonical tessellation."""
        dtype = torch.get_default_dtype()
        self.register_buffer("canonical_vertices", surface.vertices.to(dtype), persistent=False)
        self.register_buffer("canonical_normals", None if surface.normals is None else surface.normals.to(dtype),
                             persistent=False)
        self.register_buffer("canonical_uv", surface.uv.to(dtype), persistent=False)
        self.register_buffer("faces", surface.faces, persistent=False)

    def triangles(self) -> Triangles:
        vertices = transform_points(self.to_world, self.canonical_vertices)
        normals = self.canonical_normals
        if normals is not None:
            normals = transform_normals(self.to_world, normals)
        faces = self.faces
        if mirrors(self.to_world):
            faces = faces if self.turned_by_mirrors else turned(faces)
            normals = -normals if self.turned_by_mirrors and normals is not None else normals
        return Triangles(vertices, faces, normals, self.canonical_uv)


def grid(columns: int, rows: int) -> tuple[Tensor, Tensor]:
    """A (rows+1) x (columns+1) grid over the unit square: (V, 2) coordinates, (F, 3) faces counter-clockwise in (u, v)."""
    v, u = torch.meshgrid(torch.linspace(0, 1, rows + 1, dtype=torch.float64),
                          torch.linspace(0, 1, columns + 1, dtype=torch.float64), indexing="ij")
    corner = (torch.arange(rows)[:, None] * (columns + 1) + torch.arange(columns)).reshape(-1)
    right, up = corner + 1, corner + columns + 1
    faces = torch.cat([torch.stack([corner, right, up + 1], 1), torch.stack([corner, up + 1, up], 1)])
    return torch.stack([u.reshape(-1), v.reshape(-1)], 1), faces
