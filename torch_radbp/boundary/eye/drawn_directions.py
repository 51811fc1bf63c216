"""Inverse BSDF sampling: random numbers for which path vertices sample given directions, and the motion of these directions.

Directions that carry derivatives move while their random numbers stay. How those move that pass an edge is told by the
numbers for which the vertex draws just them. They are found by Newton's method, from the best of some guesses; a lobe is
picked by a number of its own beforehand. With p_l the density of that lobe at the direction and p that of all, light from
there that was picked so counts p_l / p times.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.path.integrand import Integrand
from torch_radbp.path.sorting import queued
from torch_radbp.path.state import BSDF_CHOICE, Arrival, PathState, Settings
from torch_radbp.path.surface import surface_met
from torch_radbp.path.texture_networks import texture_values_at
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import LARGEST_NUMBER, bounce_key, uniform
from torch_radbp.scene.tables.light_tree import Vantage
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.vec import TINY, Frame, Vec3, dot, masked, rows
from torch_radbp.tensors.vector_jacobian import vector_jacobian_product, zeros_unless
from torch_radbp.vertex.emission import vantage
from torch_radbp.vertex.interaction import SurfaceInteraction
from torch_radbp.vertex.material import Material, evaluate, material_at, material_places, sample

GUESSES = 6  # of each number
STEPS = 14
LARGEST_STEP = 0.15
CLOSE = 1e-9  # square of the angle by which a direction that was found may be off
SALT = 0x6A09E667  # tells the numbers that pick lobes from others


class DirectionNumbers(NamedTuple):
    """The random numbers of a BSDF direction sample, (N,)."""

    choice: Tensor  # of the lobe
    u: Tensor
    v: Tensor


class Drawn(NamedTuple):
    """Given directions as samples of path vertices' BSDFs, with the random numbers that yield them, (N,); detached."""

    numbers: DirectionNumbers
    share: Tensor  # density of the lobe divided by that of all lobes; 0: the chosen lobe has no such direction
    pdf: Tensor  # density over solid angle
    scattered: Vec3  # BSDF times cosine
    vantage: Vantage | None  # at the vertices; None if light selection does not depend on it


class Scatterers(NamedTuple):
    """The path vertices on surfaces of one kind of material, with their surface points."""

    lanes: Tensor  # (M,) int64
    material: Material
    si: SurfaceInteraction


def scatterers_met(integrand: Integrand, state: PathState, hit: Hit, settings: Settings) -> Iterator[Scatterers]:
    """Yields the surface points that rays hit, by kind of material; attached as the scene and the rays are.

    Args:
        integrand: with eager stages.
        state: (N,) path states with the rays.
        hit: what the rays hit.
        settings: whether surface points slide with the rays.
    """
    front, order, queues = queued(integrand, state.ray, hit, False)
    arrival = Arrival(state, hit, front)
    for queue in queues:
        if not queue.event.scatters:
            continue
        lanes, part, scatterer = order[queue.first:queue.last], integrand.part(queue.event), integrand.scatterer(queue.event)
        met = surface_met(part.scene, rows(arrival, lanes), settings)
        values = texture_values_at(integrand.scene, scatterer, material_places(part.scene, met) if scatterer.outside else ())
        of_material = values[:len(scatterer.outside)]
        yield Scatterers(lanes.long(), material_at(part.scene, met, of_material), met)


def drawn(integrand: Integrand, state: PathState, hit: Hit, d: Vec3) -> Drawn:
    """Inverts BSDF sampling: the random numbers with which path vertices sample given directions.

    Args:
        integrand: detached, with eager stages.
        state: (N,) path states with the rays that hit the vertices.
        hit: the vertices.
        d: (N,) unit directions away from them.
    """
    like, key = state.pdf, bounce_key(state.key, SALT)
    choice = uniform(key, BSDF_CHOICE, like.dtype)
    found = Drawn(DirectionNumbers(choice, torch.zeros_like(like), torch.zeros_like(like)), torch.zeros_like(like),
                  torch.zeros_like(like), Vec3.buffer(like),
                  None if state.vantage is None else Vantage(*(Vec3.buffer(like) for _ in Vantage._fields)))
    for lanes, material, si in scatterers_met(integrand, state, hit, Settings()):
        if not material.kind.smooth:
            continue
        wo = si.frame.to_local(rows(d, lanes))
        value, pdf = evaluate(material, si.wi, wo)
        numbers, density = inverted_sampling(material, Vec3(*si.wi), Vec3(*wo), choice[lanes])
        usable = si.valid & (pdf > 0)
        share = torch.where(usable, density / torch.where(usable, pdf.double(), 1.0), 0.0).to(like.dtype)
        own = Drawn(numbers, share, pdf, masked(usable, value), None if found.vantage is None else vantage(si))
        for target, new in zip(leaves_of(found), leaves_of(own)):
            if target is not None:
                target[lanes] = new.to(target.dtype)
    return found


class Try(NamedTuple):
    """An iterate of Newton's method: the sampled direction and its error, (N,) each."""

    u: Tensor
    v: Tensor
    off: Tensor  # squared distance from the wanted direction; infinite: a delta lobe
    density: Tensor  # over solid angle, of the lobe
    step: tuple[Tensor, Tensor]  # Newton step, to be subtracted


def inverted_sampling(material: Material, wi: Vec3, wo: Vec3, choice: Tensor) -> tuple[DirectionNumbers, Tensor]:
    """The random numbers u and v with which the lobe that `choice` selects yields directions, and the lobe's densities.

    The solid-angle densities are 0 where the lobe has no such direction, or is a delta lobe.

    Args:
        material, wi: (N,), detached.
        wo: (N,) unit, local, the directions to be sampled.
        choice: (N,) in [0, 1).
    """
    fine = Material(material.kind, tuple(value.map(torch.Tensor.double) for value in material.values))
    wi, wo, own = wi.map(torch.Tensor.double), wo.map(torch.Tensor.double), choice.double()
    # Begin with the best of some guesses.
    places = torch.cartesian_prod(*[(torch.arange(GUESSES, dtype=own.dtype, device=own.device) + 0.5) / GUESSES] * 2)
    u, v, best = own, own, torch.full_like(own, -2.0)
    for place in places:
        guess = [number.expand_as(own) for number in place]
        near = dot(drawn_direction(fine, wi, own, *guess)[0], wo)
        better = near > best
        u, v, best = (torch.where(better, *parts) for parts in zip((*guess, near), (u, v, best)))

    # Go on by Newton's method, by shorter steps where those lead away. Numbers that are angles go round.
    at, reach = tried(fine, wi, wo, own, u, v), torch.ones_like(own)
    for _ in range(STEPS):
        share = reach * (LARGEST_STEP / torch.maximum(at.step[0].abs(), at.step[1].abs()).clamp_min(LARGEST_STEP))
        u, v = (torch.frac(1.0 + number - share * step) for number, step in zip((at.u, at.v), at.step))
        then = tried(fine, wi, wo, own, u, v)
        nearer = then.off < at.off
        at = with_leaves(at, [torch.where(nearer, *parts) for parts in zip(leaves_of(then), leaves_of(at))])
        reach = torch.where(nearer, (2.0 * reach).clamp_max(1.0), 0.25 * reach)
    # In float32 a number just below 1 would become 1, which no random number is, and no direction belongs to.
    u, v = (number.clamp_max(LARGEST_NUMBER) for number in (at.u, at.v))
    return DirectionNumbers(choice, u, v), torch.where(at.off < CLOSE, at.density, 0.0)


def drawn_direction(material: Material, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> tuple[Vec3, Tensor]:
    """(N,) local directions that are sampled from random numbers, attached to `u` and `v`; and whether by a delta lobe."""
    kind, values = material.kind, material.values
    lobe = kind.choose(values, wi, choice, u.detach(), v.detach())
    return kind.sample(values, wi, lobe, u, v), lobe.is_delta(kind)


def tried(material: Material, wi: Vec3, wo: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> Try:
    """The Newton iterate at random numbers `u` and `v`; other args as for `inverted_sampling`."""
    axes, slopes = Frame.of(wo), []
    for axis in (axes.s, axes.t):
        with torch.enable_grad():
            numbers = [number.detach().requires_grad_() for number in (u, v)]
            d, delta = drawn_direction(material, wi, choice, *numbers)
            across = dot(d, axis)
            found = vector_jacobian_product([across], numbers, [torch.ones_like(across)])
            slopes.append([zeros_unless(slope, number).detach() for slope, number in zip(found, numbers)])
    d = d.map(torch.Tensor.detach)
    (s_u, s_v), (t_u, t_v), s, t, apart = *slopes, dot(d, axes.s), dot(d, axes.t), d - wo
    area = s_u * t_v - s_v * t_u
    known = area.abs() > TINY
    inverse = torch.where(known, 1.0 / torch.where(known, area, 1.0), 0.0)
    off = torch.where(torch.isfinite(area) & ~delta, dot(apart, apart), torch.inf)
    return Try(u, v, off, inverse.abs(), ((t_v * s - s_v * t) * inverse, (s_u * t - t_u * s) * inverse))


def directions_drawn(integrand: Integrand, state: PathState, hit: Hit, numbers: DirectionNumbers) -> Vec3:
    """(N,) unit world directions that path vertices sample from given random numbers, attached.

    Args:
        integrand: attached, with eager stages.
        state: (N,) path states with the rays that hit the vertices, attached.
        hit: the vertices.
        numbers: the random numbers.
    """
    found = [torch.zeros_like(part) for part in state.ray.d]
    for lanes, material, si in scatterers_met(integrand, state, hit, integrand.settings):
        if not material.kind.smooth:
            continue
        choice, u, v = rows(numbers, lanes)
        wo = sample(material, si.wi, choice, u, v, integrand.settings.sampling).wo
        found = [old.index_copy(0, lanes, new) for old, new in zip(found, si.frame.to_world(wo))]
    return Vec3(*found)
