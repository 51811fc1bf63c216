"""Curves in view, and borders of shadows there, where light comes by paths that begin at lamps.

Points at which these end are fixed to surfaces, and move over the film with them, where those of paths from the camera stay
in their pixels and slide over surfaces. So a curve that moves by v changes an image of their light by

    dI = integral of h (L_behind (v - v_behind) - L_ahead (v - v_ahead)) . n dl

with the motions of both surfaces on the film. What moves with its own surface, as the outline in front of a background, or a
crease, has no part in it. `terms/primary.py` and `terms/border.py` have v; the rest stands here.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry
from torch_radbp.boundary.curve.places import Places, on_film
from torch_radbp.boundary.eye.deposit import Deposit, attached_geometry, swept_areas
from torch_radbp.boundary.eye.seen_edges import corners_of
from torch_radbp.call.render_call import RenderCall, integrand_of, started
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.trace import trace
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.differentiated import primal
from torch_radbp.tensors.vec import Vec2, interpolated, rows


def motion_of_surface(call: RenderCall, number: int, geometry: Geometry, hit: Hit, aperture: Vec2 | None) -> Vec2:
    """(N,) zeros whose derivatives are those of the film positions, in pixels, of hit points that are fixed to surfaces."""
    at = interpolated(corners_of(geometry, hit), hit.u.double(), hit.v.double())
    return Vec2(*(part - primal(part) for part in on_film(call.views[number].camera, at, aperture)))


def light_from_lamps(call: RenderCall, number: int, sample: CameraSample, hit: Hit) -> Tensor:
    """(3, N) float64, the light of paths from lamps at the points that camera rays hit; `call`: detached."""
    whole, own = (trace(integrand_of(part, part.integrand, number), started(part, sample), hit=hit)
                  for part in (call, call.camera_share))
    light = torch.stack(tuple(whole - own)).double()
    return light if sample.weight is None else light * sample.weight


def deposits_of_sides(call: RenderCall, number: int, places: Places, hit: Hit, light: Tensor) -> list[Deposit]:
    """The deposits by the motion of the surfaces on both sides of K samples, for light that is fixed to surfaces.

    Args:
        call, number: the rendering, and the number of the view.
        places: samples on curves.
        hit: (2 K,) the surfaces behind them, then those ahead.
        light: (3, 2 K) the light from lamps there, per sample.
    """
    geometry, count = attached_geometry(call.scene), len(places.u)
    found = []
    for side, sign in ((slice(0, count), -1.0), (slice(count, 2 * count), 1.0)):
        met, own = Hit(*(None if part is None else part[side] for part in hit)), sign * light[:, side]
        there = ((met.prim >= 0) & (own != 0).any(0)).nonzero().squeeze(1)
        place, met = rows((places, met), there)
        moved = motion_of_surface(call, number, geometry, met, place.aperture)
        found.append(Deposit(place.film, own[:, there].unbind(), swept_areas(moved, place.normal)))
    return found
