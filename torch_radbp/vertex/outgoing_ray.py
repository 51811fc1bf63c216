"""The ray that leaves a vertex after scattering, and the derivatives that it carries.

The next vertex either *slides* or is *glued*. It slides if the direction is that of ideal specular scattering, or carries
derivatives itself (see `Kind.follows`): then it lies where the attached ray meets the surface. Otherwise it is glued to the
triangle that the ray met: it moves with the triangle, the direction follows both ends, and the integral over directions
becomes one over surfaces, whose element of solid angle

    G = |n' . d| A' / |x' - x|^2

changes, too: the weight is multiplied by G over its own value. A direction in which the ray meets nothing is fixed, or an
invisible boundary of a medium (`is_met`). Where the next vertex is close by, it does a part of either (`nearby.py`).

Reference: Zhang et al. 2020, "Path-Space Differentiable Rendering", section 4; Worchel et al. 2025, arXiv 2504.05750.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.scene.tables.placement import points_in_world, shown_normals
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import Corners, at_corners, edges, is_fine
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Ray, Vec3, attached, cross, dot, normalize, where
from torch_radbp.vertex.interaction import SurfaceInteraction, corner_rows, is_met, where_the_ray_goes
from torch_radbp.vertex.material import BSDFSample, Material, evaluate, sampling_at
from torch_radbp.vertex.nearby import Floor, Nearby, Slide, slide_at

LEAST_RISE = 1e-4  # cosine with the triangle's normal at which ideal reflections leave it, at least; rounding is far less


def above_triangle(scene: SceneTensors, si: SurfaceInteraction, hit, sample: BSDFSample) -> BSDFSample:
    """A BSDF sample whose ideally reflected direction leaves the triangle on the side that the ray meets.

    A direction that interpolated normals turn to the other side would lead into the body, where it is black. It runs along
    the triangle instead. So what a smooth body reflects is continuous up to its outline, as on the surface that its
    triangles stand for; in the black strip there, and where it ends, derivatives would have jumps as large as at the
    outline, each of which takes away what another has brought. Of coarse meshes, where the strip is wide and light would
    jump between triangles instead, nothing changes.

    Args:
        hit: a `raycast.Hit`, of the surface.
        sample: of the material there.

    Reference: Blender Foundation 2023, Cycles (`ensure_valid_specular_reflection` bends normals for the same reason).
    """
    n, wo = si.frame.to_local(si.n), sample.wo
    facing = n * torch.where(si.cosine > 0, -1.0, torch.ones_like(si.cosine))
    lacks = LEAST_RISE - dot(facing, wo)
    bends = torch.isinf(sample.pdf) & (lacks > 0) & (wo.z * si.wi.z > 0)
    normals = shown_normals(scene, hit, at_corners(scene.triangles.vertices.n, corner_rows(scene, hit)))
    bends = bends & is_fine(si.n, normals)
    return sample._replace(wo=where(bends, normalize(wo + facing * lacks), wo))


def outgoing_ray(si: SurfaceInteraction, wo: Vec3) -> Ray:
    """The ray that leaves the surface in the local direction `wo`."""
    d = normalize(si.frame.to_world(wo))
    return Ray(si.offset(d), d)


def attached_outgoing_ray(scene: SceneTensors, material: Material, si: SurfaceInteraction, sample: BSDFSample, following,
                       sampling: str, there: Corners | None = None) -> tuple[Vec3, Ray]:
    """The weight of a BSDF sample and the scattered ray, with the derivatives that `sampling` includes.

    Args:
        scene: attached; gives the geometry of the next vertex.
        material, si: of this vertex, attached.
        sample: the sampled direction.
        following: the `raycast.Hit` of the scattered ray.
        sampling: "detached", "hybrid" or "attached".
        there: the corners of the triangle that the ray meets, where it is an instance's in the frame of the group; None: as
            the scene has them.

    Returns:
        bsdf * |cos| / pdf, and the ray.
    """
    ray, sampling = outgoing_ray(si, sample.wo), sampling_at(material.kind, sampling)
    if sampling == "attached":
        return sample.weight, ray
    o, fixed = attached(ray.o, si.p), ray.d.detach()  # of a glued direction the offset carries no derivative
    chance = torch.isfinite(sample.pdf)
    if there is None:
        there = at_corners(scene.triangles.vertices.p, corner_rows(scene, following))
    there = points_in_world(scene, following, there)
    glued = chance & (sample.pdf > 0) & is_met(scene, following)
    floor = None if scene.triangles.plain is None else Floor(
        si.p.detach(), si.n.detach(), lookup(scene.triangles.plain, si.prim), si.clearance)
    d, change = glued_direction(there, o, fixed, following, glued, slide_of(scene, floor, there, fixed, following))
    specular = ray if sampling == "hybrid" else Ray(o, fixed)
    if not material.kind.smooth:
        return sample.weight, specular
    value, _ = evaluate(material, si.wi, si.frame.to_local(d))
    pdf = sample.pdf.detach()
    weight = value * (change / torch.where(pdf > 0, pdf, 1.0))  # a path that ends is masked by the caller, if finite
    if not material.kind.delta:
        return weight, Ray(o, d)
    return where(chance, weight, sample.weight), Ray(where(chance, o, specular.o), where(chance, d, specular.d))


def slide_of(scene: SceneTensors, floor: Floor | None, there: Corners, d: Vec3, following) -> Slide | None:
    """How far next vertices, hit at `following`, slide over their triangles; None: none does. `floor`: the surface of this
    vertex; None: no material lets points slide. Other args as for `glued_direction`."""
    if floor is None:
        return None
    plain = lookup(scene.triangles.plain, following.prim.clamp_min(0))
    return slide_at(Nearby(there, following.u, following.v, d, following.t, plain), floor)


def glued_direction(there: Corners, o: Vec3, d: Vec3, hit, glued: Tensor, slide: Slide | None = None) -> tuple[Vec3, Tensor]:
    """The direction from `o` to a fixed point of the triangle hit, and the change of its solid angle, a factor of value 1.

    Args:
        there: the corners of the triangle, attached.
        o: (N,) world, attached.
        d: (N,) detached.
        hit: a `raycast.Hit`.
        glued: (N,) bool: True where the ray hits a triangle; elsewhere the direction is fixed.
        slide: how much the point slides over the triangle; None: not at all.
    """
    p0, e1, e2 = edges(*there)
    reach = p0 + e1 * hit.u + e2 * hit.v - o
    squared = torch.where(glued, dot(reach, reach).clamp_min(TINY), 1.0)
    aim = reach * torch.rsqrt(squared)
    follow = glued.to(squared.dtype)
    moved = attached(d, aim * follow)
    element = dot(cross(e1, e2), aim).abs() / squared
    size = element.detach()
    has_area = glued & (size > TINY)  # else the triangle is seen edge-on
    change = (element - size) / torch.where(has_area, size, 1.0) * has_area.to(size.dtype)
    if slide is None:
        return moved, 1.0 + change
    fixed = where_the_ray_goes(Ray(o, d), p0, e1, e2, hit, glued)
    apart = slide.by_u * (fixed.u - hit.u.detach()) + slide.by_v * (fixed.v - hit.v.detach())
    stays = 1.0 - slide.share
    return attached(moved, d + (moved - d) * stays), 1.0 + change * stays + apart
