"""The surface interaction: the point where a ray meets a surface, with normals, frame and texture coordinates."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.texture import TexturePoint, TriangleEdges
from torch_radbp.scene.tables.placement import points_in_world, shown_direction, shown_normals
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import Corners, along_edges, at_corners, clearance, edges
from torch_radbp.tensors.lookup import lookup, untapped
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import (
    TINY,
    LocalVec3,
    Ray,
    ShadingFrame,
    Vec3,
    attached,
    crossing,
    dot,
    interpolated,
    normalize,
    unit_normal,
    where,
)
from torch_radbp.vertex.barycentric_gradients import barycentric_gradients
from torch_radbp.vertex.cone import Cone, footprint
from torch_radbp.vertex.nearby import slides_from


class SurfaceInteraction(NamedTuple):
    """A surface point per lane; directions `wi` point away from the surface, in the local frame."""

    valid: Tensor  # bool: the ray meets a surface at all
    prim: Tensor  # int32 triangle, 0 where invalid
    material: Tensor | None  # int32 row of the material table; None where nothing is scattered
    emitter: Tensor | None  # int32 element of the light table, -1: emits nothing; None: no triangle of the scene emits
    p: Vec3  # world position
    n: Vec3  # unit geometric normal
    frame: ShadingFrame  # shading frame; its normal is turned to the viewer's side of a two-sided material
    front: Tensor  # bool: the viewer is on the side of the shading normal
    wi: LocalVec3  # towards the viewer, local
    point: TexturePoint  # where textures are read
    t: Tensor  # distance that the ray has come
    cosine: Tensor  # between the geometric normal and the ray's direction
    clearance: Tensor  # distance off the surface at which rays start; detached

    def offset(self, d: Vec3) -> Vec3:
        """The origin of a ray that leaves in direction `d`: moved off the surface to avoid self-intersection."""
        return self.p + self.n * torch.copysign(self.clearance, dot(self.n, d))


def is_met(scene: SceneTensors, hit) -> Tensor:
    """(N,) bool: rays hit a surface that fixes the next vertex, not an invisible boundary of a medium where their flight
    ends."""
    met = hit.prim >= 0
    return met if scene.boundaries is None else met & ~is_boundary(scene, hit.prim)


def is_boundary(scene: SceneTensors, prim: Tensor) -> Tensor:
    """(N,) bool: triangles that are invisible boundaries of media; -1: no triangle. For scenes with such boundaries."""
    return (prim >= 0) & lookup(scene.boundaries.invisible, lookup(scene.triangles.boundary, prim.clamp_min(0)))


def surface_interaction(scene: SceneTensors, ray: Ray, hit, slides: Tensor | None = None, here: Corners | None = None,
                        front: Tensor | None = None, cone: Cone | None = None) -> SurfaceInteraction:
    """Computes the surface interaction from the triangle that a ray has hit.

    Args:
        scene: the part that the lanes read; for a whole scene the fields that depend on the material are left out.
        ray: (N,) rays.
        hit: a `raycast.Hit`: triangle (-1: none), barycentric coordinates of its second and third vertex, distance.
        slides: (N,) bool: how the point follows when ray and scene are attached. True: it stays on the ray and slides over
            the triangle. False: it is glued to the triangle, at fixed barycentric coordinates, whatever the ray does, unless
            the ray begins close by (`vertex.nearby`). None: it does not follow, because nothing moves.
        here: the corners of the triangle, where it is an instance's in the frame of the group; None: as the scene has them.
        front: (N,) bool: the viewer is on the side of the shading normal, which was decided before where the sides of a
            material differ in appearance; None: nowhere.
        cone: of the rays; None if no texture is filtered by it.
    """
    triangles, scatterer = scene.triangles, scene.layout.scatterer
    valid = hit.prim >= 0
    prim = hit.prim.clamp_min(0)
    vertices, layout = triangles.vertices, scene.layout
    t, rows = hit.t, corner_rows(scene, hit)
    corners = points_in_world(scene, hit, at_corners(vertices.p, rows) if here is None else here)
    p0, e1, e2 = edges(*corners)
    n = triangle_normal(scene, hit, e1, e2)
    if slides is not None and triangles.plain is not None:
        slides = slides | slides_from(corners, hit.t, lookup(triangles.plain, prim))
    if slides is not None:
        slides = slides if scene.boundaries is None else slides | ~is_met(scene, hit)
        hit = where_the_ray_goes(ray, p0, e1, e2, hit, slides & valid)
    p = p0 + e1 * hit.u + e2 * hit.v  # not o + t d, which for a long ray lies off the surface by rounding
    if slides is not None:
        t = attached(t, dot(p - ray.o, ray.d))
        n = attached(n, unit_normal_shown(scene, hit, e1, e2))
        if layout.from_lamps and layout.shading_normals:
            n = turning_as_it_slides(scene, hit, n)
    cosine = dot(n, ray.d)
    shading = shading_normal(scene, hit, n)
    shading_cosine = dot(shading, ray.d)
    in_front = shading_cosine < 0
    emitter = lookup(triangles.emitter, prim) if layout.lit_surfaces else None
    uv, uv_corners = None, None
    if layout.radiance_bitmaps or (scatterer is not None and scatterer.needs_uv):
        uv_corners = at_corners(vertices.uv, rows)
        uv = interpolated(uv_corners, hit.u, hit.v)
    at_vertices = [at_corners(column, rows) for column in vertices.attributes]
    of_faces = [lookup(column, prim) for column in triangles.attributes]
    names = (*layout.vertex_attributes, *layout.face_attributes)
    of_vertices = [interpolated(corners, hit.u, hit.v) for corners in at_vertices]
    point = TexturePoint(uv, dict(zip(names, (*of_vertices, *of_faces))))
    material, along, side, upright = None, None, None, shading
    if scatterer is not None:
        material = lookup(triangles.material, prim)
        if front is not None:
            differs = lookup(scene.materials.differs, material)
            in_front = (front & differs) | (in_front & ~differs)
        along = shown_direction(scene, hit, lookup(triangles.along, prim)) if scatterer.kind.oriented else None
        if layout.back_sides:
            material = material + (~in_front).to(material.dtype) * scene.materials.count
            side = 1.0 - 2.0 * lookup(scene.materials.turned, material).to(cosine.dtype)
            shading, shading_cosine = shading * side, shading_cosine * side
    frame = ShadingFrame(shading, along, side)
    if scatterer is not None and scatterer.needs_edges:
        level = tuple((value.map(torch.zeros_like),) * 2 for value in of_faces)
        changes = dict(zip(names, (*map(along_edges, at_vertices), *level)))
        point = point._replace(edges=TriangleEdges((e1, e2), None if uv is None else along_edges(uv_corners), changes,
                                           barycentric_gradients(frame, upright, n, e1, e2)))
    if scatterer is not None and scatterer.needs_footprint:
        come, change = torch.where(valid, t, 0.0), along_edges(uv_corners)
        point = point._replace(footprint=footprint(cone, come, cosine, (e1, e2), change))
    if scatterer is not None and any(reader.needs_position for reader in scatterer.readers):
        point = point._replace(p=p)
    wi = LocalVec3(frame, ray.d, backwards=True, z=-shading_cosine)
    return SurfaceInteraction(valid, prim, material, emitter, p, n, frame, in_front, wi, point, t, cosine,
                              clearance_at(scene, hit, corners))


def shading_normal(scene: SceneTensors, hit, n: Vec3) -> Vec3:
    """The unit shading normal, interpolated from vertex normals and attached to these; `n` where there are none."""
    triangles = scene.triangles
    if not scene.layout.shading_normals:
        return n
    normals = shown_normals(scene, hit, at_corners(triangles.vertices.n, corner_rows(scene, hit)))
    shading = normalize(interpolated(normals, hit.u, hit.v))
    return shading if triangles.smooth is None else where(lookup(triangles.smooth, hit.prim.clamp_min(0)), shading, n)


def turning_as_it_slides(scene: SceneTensors, hit, n: Vec3) -> Vec3:
    """Geometric normals with the derivatives of shading normals, for points that slide over smooth surfaces.

    The adjoint BSDF has the cosines of both normals. Along a smooth surface these turn together on average, but the
    geometric normal turns at edges only, where no derivative sees it.
    """
    still = untapped(scene.triangles.vertices.n).map(torch.Tensor.detach)
    vertices = scene.triangles.vertices._replace(n=still)
    slid = shading_normal(scene._replace(triangles=scene.triangles._replace(vertices=vertices)), hit, n.detach())
    side = torch.copysign(torch.ones_like(n.x), dot(slid, n).detach())
    return n + (slid - slid.detach()) * side


def is_in_front(scene: SceneTensors, ray: Ray, hit) -> Tensor:
    """(N,) bool: rays that meet the side of the surface to which the shading normal points."""
    return dot(shading_normal(scene, hit, triangle_normal(scene, hit)), ray.d) < 0


def triangle_normal(scene: SceneTensors, hit, e1: Vec3 | None = None, e2: Vec3 | None = None) -> Vec3:
    """The unit geometric normals of hit triangles, detached; `e1`, `e2`: their edges in the world, if these are known."""
    if scene.triangles.instances is None:
        return lookup(scene.triangles.n, hit.prim.clamp_min(0))
    if e1 is None:
        _, e1, e2 = edges(*points_in_world(scene, hit, at_corners(scene.triangles.vertices.p, corner_rows(scene, hit))))
    return unit_normal_shown(scene, hit, e1.detach(), e2.detach())


def unit_normal_shown(scene: SceneTensors, hit, e1: Vec3, e2: Vec3) -> Vec3:
    """The unit geometric normals of hit triangles, attached to their edges e1 and e2 in the world."""
    n, instances = unit_normal(e1, e2), scene.triangles.instances
    return n if instances is None else n * lookup(instances.side, hit.instance)


def clearance_at(scene: SceneTensors, hit, corners: Corners) -> Tensor:
    """The distances off hit triangles at which rays start, detached; see `clearance`."""
    instances = scene.triangles.instances
    if instances is None:
        return lookup(scene.triangles.clearance, hit.prim.clamp_min(0))
    return torch.maximum(clearance(corners), lookup(instances.clearance, hit.instance))


@stage("scene")
def corner_rows(scene: SceneTensors, hit) -> tuple[Tensor, Tensor, Tensor]:
    """The three vertices of hit triangles, (N,) int32 rows of the vertex table each."""
    return tuple(lookup(corner, hit.prim.clamp_min(0)) for corner in scene.triangles.corners)


def where_the_ray_goes(ray: Ray, p0: Vec3, e1: Vec3, e2: Vec3, hit, slides: Tensor):
    """The hit with barycentric coordinates attached to ray and triangle, where `slides`: the point slides with the ray."""
    volume, of_u, of_v = crossing(ray, p0, e1, e2)
    slides = slides & (volume.abs() > TINY)  # else it is seen edge-on
    volume = torch.where(slides, volume, 1.0)
    u, v = of_u / volume, of_v / volume  # no reciprocal: its square may overflow
    follow = slides.to(u.dtype)
    return hit._replace(u=attached(hit.u, u * follow), v=attached(hit.v, v * follow))
