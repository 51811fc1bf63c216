"""A place where the shapes of a group are seen."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.domain import POSE, Domain
from torch_radbp.plugin import Matrix4, Shape, register
from torch_radbp.shape.ball import Ball
from torch_radbp.shape.shapegroup import ShapeGroup
from torch_radbp.shape.surface import Triangles, affine, transform_normals, transform_points, turned


@register("shape", "instance")
class Instance(Shape):
    """The shapes of a group, under `to_world`.

    Parameters: `to_world` (4, 4). A mirroring one keeps the normals on their side of the surface, as in Mitsuba.

    Each instance has triangles of its own, placed for every rendering in which a pose or a shape has changed: parameters are
    shared, memory is not. A million triangles of instances take 0.4 GB, and 0.6 GB if their vertices have derivatives.

    Args:
        shapegroup: what is shown; usually a reference to an object of the scene.

    Raises:
        ValueError: if it is no `shapegroup`.
    """

    def __init__(self, *, shapegroup: Shape, to_world: Matrix4 | None = None):
        super().__init__()
        if not isinstance(shapegroup, ShapeGroup):
            raise ValueError(f"an instance shows a shapegroup, got a shape of type {shapegroup.type}: put it into one")
        self.shapegroup = shapegroup
        self.freeze("to_world", affine("to_world", to_world))

    def domains(self) -> dict[str, Domain]:
        return {"to_world": POSE}


def instanced(surface: Triangles, poses: tuple[Tensor, ...]) -> Triangles:
    """A surface once for each of I instances, (4, 4) transforms each; attached to both. Faces are int32, to save memory."""
    matrices = torch.stack(poses)
    count, size = len(poses), len(surface.vertices)
    mirrored = torch.linalg.det(matrices.detach()[:, :3, :3]) < 0
    local = surface.faces.to(torch.int32)
    faces = torch.where(mirrored[:, None, None], turned(local), local)
    faces += size * torch.arange(count, dtype=torch.int32, device=faces.device)[:, None, None]
    normals, ball = surface.normals, surface.ball
    if normals is not None:
        normals = transform_normals(matrices, normals).flatten(0, 1)
    if ball is not None:
        ball = Ball(placed(matrices.detach().double(), ball.placement.detach().double()),
                    tuple((mirrored ^ ball.turned[0]).tolist()))
    uv = None if surface.uv is None else surface.uv.repeat(count, 1)
    attributes = tuple((name, values.repeat(count, 1)) for name, values in surface.attributes)
    return Triangles(transform_points(matrices, surface.vertices).flatten(0, 1), faces.flatten(0, 1), normals, uv, ball,
                     attributes)


def placed(outer: Tensor, inner: Tensor) -> Tensor:
    """The products of affine (I, 4, 4) and (1, 4, 4) matrices; of their last rows nothing is read, as for vertices."""
    upper = outer[:, :3, :3] @ inner[:, :3, :]
    upper = torch.cat([upper[..., :3], upper[..., 3:] + outer[:, :3, 3:]], -1)
    return torch.cat([upper, upper.new_tensor([[[0.0, 0.0, 0.0, 1.0]]]).expand(len(outer), 1, 4)], 1)
