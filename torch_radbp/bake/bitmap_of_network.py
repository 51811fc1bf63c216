"""Bakes a network that is used as a texture to a bitmap."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torch_radbp.bake.texels import texels_of
from torch_radbp.formats.trimesh_arrays import is_trimesh
from torch_radbp.plugin import SceneWarning, integer
from torch_radbp.public_call import public_call
from torch_radbp.shape.mesh import TensorMesh
from torch_radbp.shape.surface import Surface
from torch_radbp.texture.bitmap import Bitmap
from torch_radbp.texture.neural import NeuralTexture

if TYPE_CHECKING:
    import trimesh

PLACES = 1 << 16  # that the network gets at a time
OUTSIDE = 1e-4  # surface coordinates that are taken for those of the border


@public_call
def bitmap(texture: NeuralTexture, resolution: int | Sequence[int],
           shape: Surface | trimesh.Trimesh | trimesh.Scene | None = None) -> Bitmap:
    """Bakes the values of a network at the centres of texels to a bitmap, which other programs can read.

        bsdf = scene.body.bsdf
        bsdf.reflectance = rb.bake.bitmap(bsdf.reflectance, 512, scene.body)

    A network of surface coordinates is read over the unit square. One of positions is read where the surface coordinates of
    a shape put the texels, in world space as the shape stands now; texels beside its triangles continue those, so that
    bilinear reading finds no seams.

    Args:
        texture: the network.
        resolution: of the bitmap: texels to a side, or height and width.
        shape: whose surface coordinates, within [0, 1], the bitmap covers; a network of positions needs it. A mesh of
            trimesh is first read as a shape `mesh`. One that has none, or whose triangles overlap there, is given others by
            `rb.bake.mesh`.

    Returns:
        A texture `bitmap` with `data` (H, W, 1 or 3) of the network's dtype and device, detached, read `bilinear` and
        clamped at its borders; row 0 is at v = 0.

    Raises:
        TypeError: if the texture is no network, or the shape is no surface.
        ValueError: if a shape is needed, has no surface coordinates, or some that are not within [0, 1].
        SceneWarning: (a warning) if triangles overlap in surface coordinates, so that they share texels.
    """
    if not isinstance(texture, NeuralTexture):
        raise TypeError(f"a network in the place of a texture is baked, rb.NeuralTexture, got {type(texture).__name__}")
    height, width = _size_of(resolution)
    if texture.of == "uv":
        v, u = ((torch.arange(side, dtype=torch.float64) + 0.5) / side for side in (height, width))
        places = torch.stack([u.expand(height, -1), v[:, None].expand(-1, width)], 2)
    else:
        places = _positions(TensorMesh.of_trimesh(shape) if is_trimesh(shape) else shape, height, width)
    like = next((value for value in texture.module.parameters()), torch.empty(0))
    function, values = texture.function().with_parameters(list(texture.module.parameters())), []
    with torch.no_grad():
        for part in places.view(height * width, -1).split(PLACES):
            part = part.to(like)
            values.append(function.run(part))
            function.check(values[-1], part)
    return Bitmap(data=torch.cat(values).view(height, width, -1), wrap_mode="clamp").to(like)


def _size_of(resolution: int | Sequence[int]) -> tuple[int, int]:
    """Height and width of a bitmap, from one number or two.

    Raises:
        ValueError: unless it is a whole number of at least 1, or two.
    """
    sides = tuple(resolution) if isinstance(resolution, Sequence) else (resolution, resolution)
    if len(sides) != 2:
        raise ValueError(f"resolution must be texels to a side, or height and width, got {resolution!r:.60}")
    height, width = (integer("resolution", side, 1) for side in sides)
    return height, width


def _positions(shape: Surface | None, height: int, width: int) -> Tensor:
    """(H, W, 3) world positions of the texels on a shape, by its surface coordinates, float64; errors as of `bitmap`."""
    if shape is None:
        raise ValueError("a network of positions is baked over the surface coordinates of a shape: give the shape, too")
    if not isinstance(shape, Surface):
        raise TypeError(f"the shape must be a surface, such as a mesh, got {type(shape).__name__}")
    with torch.no_grad():
        surface = shape.oriented()
    if surface.uv is None:
        raise ValueError(f"the {shape.type} has no surface coordinates; rb.bake.mesh makes a mesh of it that has")
    vertices, uv, faces = surface.vertices.double().cpu(), surface.uv.double().cpu(), surface.faces.long().cpu()
    low, high = uv.min().item(), uv.max().item()
    if low < -OUTSIDE or high > 1 + OUTSIDE:
        raise ValueError(f"surface coordinates must be within [0, 1] to be covered by a bitmap, got {low:.4g} to "
                         f"{high:.4g}; rb.bake.mesh(shape, unwrap=True) finds others")
    texels = texels_of(uv.clamp(0, 1), faces, height, width)
    if texels.shared:
        warnings.warn(f"triangles overlap in surface coordinates, so that {texels.shared} of {height * width} texels stand "
                      f"for several places and have the values of one; rb.bake.mesh(shape, unwrap=True) finds coordinates "
                      f"without overlap", SceneWarning, stacklevel=4)
    return texels.of_vertices(vertices, faces)
