"""Surfaces that rays pass straight on their ways, where a scene has media: panes of glass, the holes of masks.

With t(x) the share of light that a surface lets pass straight at x, a path passes it with the probability p that its BSDF
chooses a lobe that does so, and counts by t(x) / p; else it meets the surface, whose lobe is the one that was chosen.
Connections to lights pass all of them and count by t(x). Either way counts

    T = t(x_1) t(x_2) ... t(x_n)

Its derivative is the sum over i of that of t(x_i) times the others. One of them is picked evenly, and counts n times. There
is no division by t, so that a surface that lets nothing pass has the right derivative.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.path.state import PanesPassed
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import next_number
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Ray, Vec3, where
from torch_radbp.vertex.interaction import surface_interaction
from torch_radbp.vertex.material import material_at


class Pane(NamedTuple):
    """How much light surfaces let pass straight, (N,) each; zeros where a surface is no pane or mask that rays pass."""

    through: Vec3  # share of light; attached
    chance: Tensor  # probability that such a lobe is chosen, detached
    chosen: Tensor  # bool: it is; False if nobody asks


def pane_at(scene: SceneTensors, ray: Ray, hit: Hit, choice: Tensor | None = None, slides: Tensor | None = None) -> Pane:
    """The straight transmission of the surfaces that rays hit.

    Surfaces that emit light let nothing pass: there paths have a vertex.

    Args:
        scene: any part of it.
        ray, hit: (N,).
        choice: (N,) random numbers that choose lobes; None: none is chosen.
        slides: as for `surface_interaction`.
    """
    zero = torch.zeros_like(hit.t)
    found = Pane(Vec3.full(zero, 0.0), zero, zero > 0)
    for number, row, look in scene.layout.panes:
        seen = scene._replace(layout=replace(scene.layout, scatterer=look, still=()))
        si = surface_interaction(seen, ray, hit, slides)
        here = si.valid & (lookup(scene.materials.appearance, si.material) == number)
        if si.emitter is not None:
            here = here & (si.emitter < 0)
        kind, values, _ = material_at(seen, si._replace(material=torch.where(here, si.material, row)), ())
        through, chance = kind.null_transmission(values, si.wi)
        chosen = found.chosen
        if choice is not None:  # lobes that let light pass depend on no other number
            chosen = torch.where(here, kind.chooses_null(kind.choose(values, si.wi, choice, zero, zero)), chosen)
        found = Pane(where(here, through, found.through), torch.where(here, chance, found.chance), chosen)
    return found


def no_panes(scene: SceneTensors, none: Tensor) -> PanesPassed | None:
    """The state of N rays that have passed no pane yet; None: the scene has no panes. `none`: (N,) zeros."""
    if not scene.layout.panes:
        return None
    number = torch.zeros_like(none, dtype=torch.int32)
    instance = None if scene.triangles.instances is None else number
    return PanesPassed(none, Vec3.full(none, 1.0), Hit(number - 1, none, none, none, instance), Vec3.full(none, 1.0))


def with_pane(panes: PanesPassed, hit: Hit, through: Vec3, passes: Tensor, seed: Tensor) -> tuple[Tensor, PanesPassed]:
    """Adds a pane to those that rays have passed, where `passes`; returns the next seeds, (N,) int32, and the panes.

    Args:
        panes: passed so far.
        hit, through: (N,) where rays hit it, and the share of light that it lets pass; detached.
        passes: (N,) bool: rays pass it.
        seed: (N,) int32, of random numbers.
    """
    seed, number = next_number(seed, panes.count.dtype)
    count = panes.count + passes.to(panes.count.dtype)
    picked = passes & (number * count < 1.0)
    pick = Hit(*(None if new is None else torch.where(picked, new, old) for new, old in zip(hit, panes.picked)))
    others = where(picked, panes.through, where(passes, panes.others * through, panes.others))
    return seed, PanesPassed(count, where(passes, panes.through * through, panes.through), pick, others)


def through_panes(scene: SceneTensors, light: Vec3, ray: Ray, panes: PanesPassed | None, moving: bool) -> Vec3:
    """The light that is left behind all panes that rays have passed, (N,), attached.

    Args:
        scene, ray: attached.
        light: (N,) before the panes.
        panes: those that rays have passed; None: the scene has none.
        moving: rays carry derivatives.
    """
    if panes is None:
        return light
    slides = torch.ones_like(panes.count, dtype=torch.bool) if moving else None
    through = pane_at(scene, ray, panes.picked, slides=slides).through
    change = (through - through.map(settled)) * panes.others * panes.count
    return light * (panes.through + change)
