"""Light that passes right beside edges through media, and what surfaces send of it along rays.

Such rays and such light pass invisible boundaries of media. Who is behind these is known by following them.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import geometry_of
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.eye.past_edges import hides_all, leaving_towards
from torch_radbp.boundary.eye.seen_edges import Passed, unhidden
from torch_radbp.boundary.eye.seen_on_film import meets
from torch_radbp.boundary.eye.viewpoints import path_of
from torch_radbp.call.render_call import RenderCall
from torch_radbp.path.direct_light import LightDraw, light_sent_back
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.sorting import first_hit
from torch_radbp.path.state import Flight, PathState
from torch_radbp.path.through_media import free_flights, free_ways, let_through
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.vec import Vec3, dot, rows


def behind_boundaries(integrand: Integrand, state: PathState, hit: Hit) -> tuple[Hit, Flight]:
    """Follows rays through invisible boundaries of media: the surfaces that they hit, and the way there, without scattering.

    Args:
        integrand: with a detached scene.
        state, hit: (N,) the path states with the rays, and what these hit first.
    """
    return free_flights(integrand.standing(), state, hit, integrand.max_depth - 1)


def lit_surfaces(call: RenderCall, outline: Outline, passed: Passed) -> tuple[Tensor, Hit]:
    """The indices of samples on edges that are not hidden from their light, (K,) int64, and the surfaces beyond the edges.
    Where boundaries of media are passed, hidden ones are left in; `light_sent_past` removes these.

    Args:
        call: detached.
        outline: the edges.
        passed: (N,) samples on these as the lights see them.
    """
    integrand = call.integrand
    if not call.scene.layout.traces_segments:
        hit = integrand.caster.intersect(passed.onwards)
        kept = (hit.prim >= 0).nonzero().squeeze(1)
        kept = kept[unhidden(integrand, rows(passed, kept))]
        return kept, rows(hit, kept)
    hides = integrand.part(Ends.SURROUNDINGS).call(hides_all, outline.triangle(passed.edge)).nonzero().squeeze(1)
    passed = rows(passed, hides)
    state = path_of(call, passed.onwards, passed.key)
    state = state._replace(medium=torch.full_like(state.lane, -1))  # which one it is does not matter here
    hit, _ = behind_boundaries(integrand, state, integrand.caster.intersect(state.ray))
    return rows((hides, hit), (hit.prim >= 0).nonzero().squeeze(1))


def sees_receivers(integrand: Integrand, state: PathState, receiver: Hit, p: Vec3,
                   depth: int) -> tuple[Tensor, Flight | None]:
    """The indices of rays that hit the receivers of shadow borders, (K,) int64, and the ways of all rays through media;
    None: there are no boundaries of media.

    Args:
        integrand: for the view, with a detached scene.
        state: (N,) path states with the rays.
        receiver, p: (N,) the receiving surfaces, and world points on these, float64.
        depth: of the bounce; 0: camera rays.
    """
    hit, flight = first_hit(integrand, state.ray, depth), None
    if integrand.proposal.layout.traces_segments:
        hit, flight = behind_boundaries(integrand, state, hit)
    met = integrand.stages(meets)(geometry_of(integrand.proposal), state.ray, hit, receiver, p)
    return met.nonzero().squeeze(1), flight


def light_sent_past(integrand: Integrand, state: PathState, receiver: Hit, flight: Flight | None, draw: LightDraw,
                    passed: Passed, depth: int) -> Vec3:
    """The light of one sample, passing an edge, that surfaces reflect back along rays, (N,); 0 if it is hidden behind
    boundaries of media.

    Args:
        integrand: for the view, with a detached scene.
        state, receiver, flight: (N,) rays, the surfaces that they hit, and their ways, as of `sees_receivers`.
        draw: the light samples.
        passed: the edges that the light passes.
        depth: of the surfaces.
    """
    light = light_sent_back(integrand, state, receiver, draw, flight)
    if flight is None:
        return light
    part = integrand.part(Ends.SURROUNDINGS)
    back, medium = part.call(leaving_towards, state.ray, receiver, flight, passed.onwards.o)
    gone = passed.onwards.o - back.o
    length = torch.sqrt(dot(gone, gone)) + passed.distance
    free, way = free_ways(integrand, back, length, medium, state.key, depth)
    return part.call(let_through, light, back, length, way._replace(crossings=None)) * free.to(length.dtype)
