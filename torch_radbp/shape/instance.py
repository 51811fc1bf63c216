"""An instance of a group of shapes."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.plugin import Matrix4, Shape, register
from torch_radbp.plugin.domain import POSE, Domain
from torch_radbp.shape.shapegroup import ShapeGroup
from torch_radbp.shape.surface import Triangles, turned
from torch_radbp.transforms import mirrors, transform, transform_normals, transform_points


@register("shape", "instance")
class Instance(Shape):
    """The shapes of a group, under `to_world`.

    Parameters: `to_world` (4, 4). A mirroring `to_world` keeps the normals on their side of the surface, as in Mitsuba.

    The triangles of the group are kept once, and its tree for ray casting is built once, however many instances there are
    and wherever they move. A sphere in a group is cast as triangles.

    Args:
        to_world: the pose of the group; affine.
        shapegroup: what is shown; usually a reference to an object of the scene.

    Raises:
        ValueError: if it is no `shapegroup`.
    """

    def __init__(self, *, shapegroup: Shape, to_world: Matrix4 | None = None):
        super().__init__()
        if not isinstance(shapegroup, ShapeGroup):
            raise ValueError(f"an instance shows a shapegroup, got a shape of type {shapegroup.type}: put it into one")
        self.shapegroup = shapegroup
        self.freeze("to_world", transform("to_world", to_world))

    def domains(self) -> dict[str, Domain]:
        return {"to_world": POSE}


def instanced(surface: Triangles, to_world: Tensor) -> Triangles:
    """Transforms a surface by an instance's (4, 4) pose; attached to both."""
    normals = None if surface.normals is None else transform_normals(to_world, surface.normals)
    faces = turned(surface.faces) if mirrors(to_world) else surface.faces
    return surface._replace(vertices=transform_points(to_world, surface.vertices), faces=faces, normals=normals, ball=None)
