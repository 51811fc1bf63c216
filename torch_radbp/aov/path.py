"""Quantities of whole paths, or of what their first bounces decide; detached."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.aov.surface import Values
from torch_radbp.path import PathState
from torch_radbp.vec import rows
from torch_radbp.wavefront import Bounce, Integrand, bounces, first_hit, trace

# Of linear sRGB primaries and white D65, as Mitsuba has them. Reference: IEC 61966-2-1.
XYZ_OF_RGB = ((0.412453, 0.357580, 0.180423), (0.212671, 0.715160, 0.072169), (0.019334, 0.119193, 0.950227))


def xyz(integrand: Integrand, start: PathState) -> Values:
    """The radiance along each camera ray in CIE XYZ."""
    L = trace(integrand, start)
    return tuple(L.x * row[0] + L.y * row[1] + L.z * row[2] for row in XYZ_OF_RGB)


def hit_anything(integrand: Integrand, start: PathState) -> Values:
    """1 where a surface is seen."""
    return (first_hit(integrand, start.ray, 0).prim >= 0).to(start.pdf.dtype),


def alpha(integrand: Integrand, start: PathState) -> Values:
    """1 where a surface or a visible surround is seen, surfaces that light passes straight through left out."""
    surrounded = integrand.scene.layout.surround is not None and not integrand.settings.hide_emitters
    found = torch.full_like(start.pdf, 1.0 if surrounded else 0.0)
    if surrounded or integrand.max_depth == 0:
        return found,
    for bounce in bounces(integrand._replace(max_depth=max(2, integrand.max_depth)), start):
        passes = passes_through(bounce)
        opaque = rows(bounce.step.hit.prim, bounce.step.order)[~passes] >= 0
        lanes = bounce.vertex.next.lane[~passes][opaque]
        found.index_fill_(0, lanes.long(), 1.0)
        if not (passes & bounce.step.survives).any():
            break
    return found,


def passes_through(bounce: Bounce) -> Tensor:
    """(M,) bool, in the order of the vertices: light goes on in the direction in which it came, chosen for certain."""
    before, after = rows(bounce.state.ray.d, bounce.step.order), bounce.vertex.next
    turn = before - after.ray.d
    return torch.isinf(after.pdf) & ((turn.x.abs() + turn.y.abs() + turn.z.abs()) < 1e-5) & bounce.step.survives


FUNCTIONS = {"xyz": xyz, "hit": hit_anything, "alpha": alpha}
