"""The gradients of barycentric coordinates along a surface, by which bump maps turn its normal.

A height that lifts a surface along its shading normal n_s, and rises by r_k along the edge e_k of a triangle, has the
gradient along the surface

    grad h = r_1 g_1 + r_2 g_2,    g_1 = e_2 x n_s / V,  g_2 = n_s x e_1 / V,  V = (e_1 x e_2) . n_s

so that g_j . e_k = 1 where j = k and else 0, and g_j . n_s = 0: the g are the gradients of the barycentric coordinates. The
lifted surface has the normal n_s - grad h. That is the cross product of dp_du and dp_dv whose components along n_s are
replaced by dh/du and dh/dv (Blinn 1978), without a division by areas in uv.

Reference: Blinn 1978, "Simulation of Wrinkled Surfaces"; Mikkelsen 2010, "Bump Mapping Unparametrized Surfaces on the GPU".
"""

from __future__ import annotations

import torch

from torch_radbp.tensors.vec import TINY, ShadingFrame, Vec3, cross, dot

LEAST_COSINE = 1e-6  # between a shading normal and that of the triangle


def barycentric_gradients(frame: ShadingFrame, shading: Vec3, n: Vec3, e1: Vec3, e2: Vec3) -> tuple[Vec3, Vec3]:
    """The world gradients of the barycentric coordinates of triangles' second and third vertices; attached; 0 if degenerate.

    Args:
        frame: the shading frame, with a tangent along u.
        shading: the shading normal, before it is turned to the viewer's side.
        n: the normal of the triangle.
        e1, e2: the edges of the triangle from the first vertex to the second and the third.

    Returns:
        Each by its components along the tangents of the frame; as z, the one along `n` over the cosine between `n` and
        `shading`: where the z of a gradient is greater than 1, the lifted surface faces the other side of the triangle.
    """
    volume, cosine = dot(cross(e1, e2), shading), dot(n, shading)
    is_regular = (volume.abs() > TINY) & (cosine.abs() > LEAST_COSINE)
    scale, upright = (is_regular.to(one.dtype) / torch.where(is_regular, one, 1.0) for one in (volume, cosine))
    gradients = (cross(e2, shading) * scale, cross(shading, e1) * scale)
    return tuple(Vec3(dot(world, frame.s), dot(world, frame.t), dot(world, n) * upright) for world in gradients)
