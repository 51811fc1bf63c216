"""Points on surfaces as a camera sees them: rays to them, and whether these meet their surface."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of, largest_coordinate
from torch_radbp.boundary.curve.intersections import TOUCHING
from torch_radbp.boundary.curve.places import APART, APERTURE_COUNTER
from torch_radbp.boundary.eye.seen_edges import BEFORE, corners_of
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.view import View
from torch_radbp.path.camera_rays import APERTURE_U, APERTURE_V, CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.sorting import first_hit
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import LaneKey, bounce_key, fine_unit, random_bits
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, dot, unit_normal
from torch_radbp.vertex.cone import camera_cone

ASIDE = 4.0 * APART  # share of its distance by which a border is looked at from aside, in the shade
ALIKE = 0.9  # cosine between normals of triangles of one surface


def aperture_of(view: View, key: LaneKey) -> Vec2 | None:
    """Random points on the camera's lens, as args of `CameraKind.sample_ray`; None: it is a pinhole."""
    if not view.camera.kind.has_aperture:
        return None
    more = bounce_key(key, APERTURE_COUNTER)
    return Vec2(*(fine_unit(random_bits(more, dimension)) for dimension in (APERTURE_U, APERTURE_V)))


def camera_sample(call: RenderCall, view: View, film: Vec2, aperture: Vec2 | None, key: LaneKey) -> CameraSample:
    """The camera rays through points of the film, pixels from the window's upper left corner; attached."""
    make = film_sample if any_differentiated((view.camera, film)) else call.stages(film_sample)
    return make(view.camera, film, aperture, key, call.scene.layout.traces_cones)


@stage("camera")
def film_sample(camera: Camera, film: Vec2, aperture: Vec2 | None, key: LaneKey, cones: bool) -> CameraSample:
    """The camera rays through points of the film, as a stage for `camera_sample`; `cones`: with ray cones."""
    dtype = camera.dtype
    position = Vec2(*(((place + crop) / size).to(dtype) for place, crop, size in (
        (film.x, camera.film.crop_x, camera.film.size_x), (film.y, camera.film.crop_y, camera.film.size_y))))
    aperture = None if aperture is None else aperture.map(lambda part: part.to(dtype))
    ray, weight = camera.kind.sample_ray(camera.lens, position, aperture)
    ray = Ray(*(part.map(torch.Tensor.contiguous) for part in ray))
    cone = camera_cone(camera, ray, position, aperture) if cones else None
    return CameraSample(ray, key, weight, cone, None)


def seen_at(hit: Hit, ray: Ray, p: Vec3) -> Hit:
    """Hits on given triangles, at their points p, (N,) float64, as rays would report them."""
    reach = p - ray.o.map(torch.Tensor.double)
    return hit._replace(t=torch.sqrt(dot(reach, reach)).to(ray.o.x.dtype))


def into_shade(camera: Camera, film: Vec2, aside: Vec2) -> Vec2:
    """Points of the film slightly beside shadow borders, on the side of the shadow."""
    length = torch.hypot(aside.x, aside.y).clamp_min(TINY)
    # Far enough for the rounding of positions on the film, however small the window.
    reach = ASIDE * torch.maximum(camera.film.size_x, camera.film.size_y).double() / length
    return Vec2(film.x + aside.x * reach, film.y + aside.y * reach)


def sees(integrand: Integrand, ray: Ray, receiver: Hit, p: Vec3) -> Tensor:
    """(N,) bool: camera rays that hit the receivers of shadow borders; `p` (N,) world points on these."""
    return integrand.stages(meets)(geometry_of(integrand.proposal), ray, first_hit(integrand, ray, 0), receiver, p)


@stage("geometry")
def meets(geometry: Geometry, ray: Ray, hit: Hit, receiver: Hit, p: Vec3) -> Tensor:
    """(N,) bool: hits that lie on the receivers of shadow borders; `p` (N,) world points on these.

    Another triangle counts as the same surface if the border lies in its plane, up to rounding and the offset of rays.
    """
    reach, corners = p - ray.o.map(torch.Tensor.double), corners_of(geometry, hit)
    distance, of_receiver = torch.sqrt(dot(reach, reach)), corners_of(geometry, receiver)
    n, n_receiver = (unit_normal(own[1] - own[0], own[2] - own[0]) for own in (corners, of_receiver))
    off = TOUCHING * largest_coordinate(p, *corners) + ASIDE * distance
    near = (dot(n, p - corners[0]).abs() < off) & ((hit.t - distance).abs() < BEFORE * distance)
    return (hit.prim >= 0) & ((hit.prim == receiver.prim) | (near & (dot(n, n_receiver).abs() > ALIKE)))
