"""Boundary term of projected images: their borders on surfaces that the camera sees.

The picture of a projector ends with a jump, and there are lines at which it may jump itself. Each is a plane of light, which
meets a receiver along a curve; there the image changes as at the border of a shadow (`border.py`), by what is lit on either
side. A place of the curve lies where the ray of light through a place of the picture meets the plane of the receiver.
"""

from __future__ import annotations

from math import ceil, floor
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.curve.places import key_of_places, lot_of, on_film, picked
from torch_radbp.boundary.eye.deposit import Deposit
from torch_radbp.boundary.eye.seen_edges import Course, corners_of, crossed_at, finite_normal, pace, salted
from torch_radbp.boundary.eye.seen_on_film import aperture_of, camera_sample, seen_at, sees
from torch_radbp.boundary.terms.border import SHARE, most_samples
from torch_radbp.boundary.terms.call_traits import films_have_area
from torch_radbp.boundary.terms.lit_edges import samples_of
from torch_radbp.boundary.terms.shadow_term import CutOff, ShadowTerm, TermSize, cut_off, shadow_term
from torch_radbp.call.render_call import RenderCall, integrand_of, started
from torch_radbp.path.direct_light import LightDraw, light_sent_back
from torch_radbp.path.light_connection import light_numbers
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sampling.sampler import CAMERA_COUNTER, LaneKey, bounce_key, fine_unit, random_bits
from torch_radbp.scene.tables.light_choice import LightPick
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import joined, leaves_of, with_leaves
from torch_radbp.tensors.vec import Ray, Vec2, Vec3, interpolated, normalize, rows

SALT = 0x165667B1  # tells the random numbers of these places from others
BORDER = JumpLines(1.0, 0.0, 0.0, 0, 1), JumpLines(0.0, 1.0, 0.0, 0, 1)  # the sides of the unit square
BESIDE = 1e-4  # share of the picture by which it is looked at beside a line


class PictureLines(NamedTuple):
    """S line segments in projected images at which these are discontinuous; float64 but for integers."""

    row: Tensor  # (S,) int32, light: row of the table of its kind
    element: Tensor  # (S,) int32, of `LightTable`
    start: Vec2  # (S,) uv in the image
    end: Vec2


class LitCurves(NamedTuple):
    """N points on the discontinuity lines of projected images, and the surfaces that their light hits; detached."""

    row: Tensor  # (N,) int32, light: row of the table of its kind
    element: Tensor  # (N,) int32, of `LightTable`
    at: Vec2  # uv in its image
    along: Vec2  # vector from the segment's start to its end
    receiver: Hit


def lines_of_pictures(call: RenderCall) -> dict[int, PictureLines]:
    """The lines at which projected images are discontinuous, by kind of light; kinds without any are missing."""
    lights, device, found = call.scene.lights, call.scene.device, {}
    for number, kind in enumerate(call.scene.layout.lights):
        emitters = [] if kind.on_surface else [emitter for emitter in call.module.emitters if emitter.kind() == kind]
        lines = [(row, one, one in BORDER and emitter.picture_ends()) for row, emitter in enumerate(emitters)
                 for one in (*(BORDER if emitter.picture_ends() else ()), *emitter.picture_jumps())]
        elements = (lights.kind == number).nonzero().squeeze(1).tolist() if lines else []
        for row, one, whole in lines:
            start, end = in_picture(one, whole, device)
            rows_of, elements_of = (torch.full_like(start.x, value, dtype=torch.int32) for value in (row, elements[row]))
            found.setdefault(number, []).append(PictureLines(rows_of, elements_of, start, end))
    found = {number: joined(own) for number, own in found.items()}
    return {number: own for number, own in found.items() if len(own.row)}


def in_picture(lines: JumpLines, whole: bool, device: torch.device) -> tuple[Vec2, Vec2]:
    """Clips texture lines to the unit square: end points of S segments, (S,) each; float64.

    Args:
        lines: a line family in the coordinates of the unit square.
        whole: include those that run along its sides.
    """
    x, y, z = lines.x, lines.y, lines.z
    levels = [z, z + x, z + y, z + x + y]
    first, last = (ceil(min(levels)), floor(max(levels))) if whole else (floor(min(levels)) + 1, ceil(max(levels)) - 1)
    number = torch.arange(max(first, lines.first), min(last, lines.last) + 1, dtype=torch.float64, device=device)
    squared = x * x + y * y
    foot = Vec2((number - z) * (x / squared), (number - z) * (y / squared))
    low, high = torch.full_like(number, -2.0), torch.full_like(number, 2.0)
    for start, step in ((foot.x, -y), (foot.y, x)):
        if step != 0.0:
            ends = (0.0 - start) / step, (1.0 - start) / step
            low, high = torch.maximum(low, torch.minimum(*ends)), torch.minimum(high, torch.maximum(*ends))
    runs = low < high
    return tuple(Vec2((foot.x - y * way)[runs], (foot.y + x * way)[runs]) for way in (low, high))


class PictureBorders(NamedTuple):
    """K samples on discontinuities of projected images that the camera of a view sees; detached."""

    kind: int  # of lights
    curves: LitCurves
    aperture: Vec2 | None  # of the rays that see them


@shadow_term
class ProjectedImages(ShadowTerm):
    """The boundary term of projected images: their borders and discontinuities on surfaces that the camera sees."""

    rank = 1

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        samples = bool(lines_of_pictures(call)) * most_samples(call)
        return TermSize(0, samples, samples)

    def applies(self) -> bool:
        return films_have_area(self.call) and self.call.integrand.settings.nee

    def samples(self, number: int) -> list[CutOff] | None:
        found = [borders_seen(self.still, number, kind, *lit) for kind, lines in lines_of_pictures(self.still).items()
                 if (lit := curves_lit(self.still, number, kind, lines)) is not None]
        return [own for own in found if own is not None] or None

    def jumps(self, number: int, found: list[CutOff]) -> list[Deposit]:
        return [deposit for own in found for deposit in super(ProjectedImages, self).jumps(number, own)]

    def seen(self, number: int, geometry: Geometry, found: CutOff) -> Vec2:
        kind, curves, aperture = found.samples
        return on_film(self.call.views[number].camera, lit_at(self.call.scene, geometry, kind, curves), aperture)


def lit_at(scene: SceneTensors, geometry: Geometry, kind: int, curves: LitCurves, step: Tensor | float = 0.0,
           aside: float = 0.0) -> Vec3:
    """The points at which light through points of projected images hits the planes of receivers, (N,) world, attached.

    Args:
        scene, geometry: attached.
        kind: the number of the kind of light.
        curves: the samples.
        step: a shift of the samples along the lines, as a share of their lengths.
        aside: a shift of the samples across the lines, as a share of the picture.
    """
    corners = corners_of(geometry, curves.receiver)
    return interpolated(corners, *crossed_at(corners, light_of(scene, kind, curves, step, aside)))


def light_of(scene: SceneTensors, kind: int, curves: LitCurves, step: Tensor | float = 0.0, aside: float = 0.0) -> Ray:
    """The rays of light through points of projected images, attached, float64; args as for `lit_at`."""
    run = curves.along
    length = torch.hypot(run.x, run.y)
    across = Vec2(-run.y / length, run.x / length)
    uv = Vec2(*(at + way * step + off * aside for at, way, off in zip(curves.at, run, across)))
    light = lookup(scene.lights.tables[kind], curves.row)
    light = with_leaves(light, [leaf.double() for leaf in leaves_of(light)])
    return Ray(light.place, scene.layout.lights[kind].leaving(light, uv))


def curves_lit(call: RenderCall, number: int, kind: int,
               lines: PictureLines) -> tuple[LitCurves, Tensor, LaneKey] | None:
    """Samples discontinuities of projected images whose light hits a receiver, with weights and keys; None: none do.

    Args:
        call: without derivatives.
        number: of the view.
        kind: the number of the kind of light.
        lines: the lines of their images.
    """
    view, scene = call.views[number], call.scene
    run = lines.end + lines.start * -1.0
    weight = torch.hypot(run.x, run.y)
    count = samples_of(call, view, SHARE)
    place = torch.arange(count, dtype=torch.int32, device=scene.device)
    key = key_of_places(salted(view, SALT), place)
    along = fine_unit(random_bits(bounce_key(key, CAMERA_COUNTER), 0))
    line, share, times = picked(lot_of(weight, count, running_sum(weight)), place, along)
    row, element, start, run = rows((lines.row, lines.element, lines.start, run), line)
    nothing = Hit(place * 0, *(torch.zeros_like(share, dtype=scene.dtype),) * 3)
    curves = LitCurves(row, element, start + run * share, run, nothing)
    o, d = light_of(scene, kind, curves)
    ray = Ray(*(part.map(lambda c: c.to(scene.dtype).contiguous()) for part in (o, normalize(d))))
    receiver = call.caster.intersect(ray)
    met = (receiver.prim >= 0).nonzero().squeeze(1)
    return rows((curves._replace(receiver=receiver), times, key), met) if len(met) else None


def borders_seen(call: RenderCall, number: int, kind: int, curves: LitCurves, times: Tensor,
                 key: LaneKey) -> CutOff | None:
    """Selects the samples of projected images' lines that a view's camera sees; args as of `curves_lit`, and its result."""
    view, scene, geometry = call.views[number], call.scene, geometry_of(call.scene)
    integrand, camera = integrand_of(call, call.integrand, number), view.camera
    aperture, one = aperture_of(view, key), torch.ones_like(curves.receiver.t)
    film, along = pace(lambda step: on_film(camera, lit_at(scene, geometry, kind, curves, step), aperture), times)
    normal, seen = finite_normal(along, times), camera.film.sees(film)
    draw = LightDraw(light_numbers(bounce_key(key, SALT)), LightPick(curves.element, one, torch.zeros_like(one)))
    beside, lights = [], []
    for way in (-BESIDE, BESIDE):
        u, v = crossed_at(corners_of(geometry, curves.receiver), light_of(scene, kind, curves, aside=way))
        p = interpolated(corners_of(geometry, curves.receiver), u, v)
        beside.append(on_film(camera, p, aperture))
        sample = camera_sample(call, view, beside[-1], aperture, key)
        seen = seen & sees(integrand, sample.ray, curves.receiver, p)
        hit = seen_at(curves.receiver._replace(u=u.to(scene.dtype), v=v.to(scene.dtype)), sample.ray, p)
        light = light_sent_back(integrand, started(call, sample), hit, draw)
        lights.append(torch.stack(tuple(light if sample.weight is None else light * sample.weight)).double())
    aside = Vec2(*(after - before for before, after in zip(*beside)))
    course = Course(film, normal, aside, aside.x * normal.x + aside.y * normal.y)
    found = cut_off(film, course, torch.where(seen, lights[0] - lights[1], 0.0), (curves, aperture))
    return found and found._replace(samples=PictureBorders(kind, *found.samples))
