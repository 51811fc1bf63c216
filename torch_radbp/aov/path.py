"""AOVs of whole paths, or of their first bounces; detached."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.aov.surface import Values
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.trace import trace
from torch_radbp.path.wavefront import Bounce, bounces
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.vec import Vec3, rows

# Of linear sRGB primaries and white D65, as Mitsuba has them. Reference: IEC 61966-2-1.
XYZ_OF_RGB = ((0.412453, 0.357580, 0.180423), (0.212671, 0.715160, 0.072169), (0.019334, 0.119193, 0.950227))
STRAIGHT = 1e-5  # largest difference of directions that are one


def xyz(integrand: Integrand, start: PathState, hit: Hit, L: Vec3 | None) -> Values:
    """The radiance along each camera ray in CIE XYZ."""
    L = trace(integrand, start, hit=hit) if L is None else L
    return tuple(L.x * row[0] + L.y * row[1] + L.z * row[2] for row in XYZ_OF_RGB)


def hit_anything(integrand: Integrand, start: PathState, hit: Hit, L: Vec3 | None) -> Values:
    """1 where the camera ray hits a surface, else 0."""
    return (hit.prim >= 0).to(start.pdf.dtype),


def alpha(integrand: Integrand, start: PathState, hit: Hit, L: Vec3 | None) -> Values:
    """1 where a surface or visible environment is seen; surfaces that light passes straight through do not count."""
    surrounded = integrand.scene.layout.surround is not None and not integrand.settings.hide_emitters
    opacity = torch.full_like(start.pdf, 1.0 if surrounded else 0.0)
    if surrounded or integrand.max_depth == 0:
        return opacity,
    for bounce in bounces(integrand._replace(max_depth=integrand.max_depth + 1), start, hit=hit):
        if bounce.depth == integrand.max_depth:
            break
        met = bounce.state.lane[bounce.step.hit.prim >= 0]
        passing = passes_through(bounce)
        opacity.index_fill_(0, met.long(), 1.0).index_fill_(0, passing.long(), 0.0)
        if not len(passing):
            break
    return opacity,


def passes_through(bounce: Bounce) -> Tensor:
    """1 in lanes whose path goes on straight through a surface (null scattering), else 0; int32."""
    after = bounce.vertex.next
    turn = rows(bounce.state.ray.d, bounce.step.order[:bounce.step.scattered]) - after.ray.d
    straight = turn.x.abs() + turn.y.abs() + turn.z.abs() < STRAIGHT
    return after.lane[torch.isinf(after.pdf) & straight & bounce.step.survives]


# Of the paths, what their rays meet, and their radiance if it is known.
FUNCTIONS = {"xyz": xyz, "hit": hit_anything, "alpha": alpha}
