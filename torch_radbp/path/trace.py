"""The radiance along camera rays: the sum over bounces, forwards."""

from __future__ import annotations

from collections.abc import Callable

from torch_radbp.path.integrand import Integrand
from torch_radbp.path.recorded_bounce import bounces_taken
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import Onward, Step
from torch_radbp.path.whole_paths import traced_whole
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.vec import Vec3

Visit = Callable[[int, PathState, Step], None]


def trace(integrand: Integrand, start: PathState, visit: Visit | None = None, hit: Hit | None = None,
          depth: int = 0) -> Vec3:
    """The radiance L_1 along each lane's camera ray: the sum of beta_k E_k over bounces.

    Args:
        integrand: the scene and how to step.
        start: from `start_path`.
        visit: called at every depth with the state that reached it and what was decided there.
        hit: of the camera rays, if it is known.
        depth: of the first bounce to take; later ones begin in the middle of a path.

    Returns:
        (N,) linear RGB, in the order of `start`; attached if `integrand.scene` is. If some lanes are of the derivative alone
        (`integrand.differentiated`), it is 0 there: nobody asks what these bring to the image.
    """
    L = traced_whole(integrand, start, hit, depth) if visit is None else None
    if L is None:
        L = Vec3.buffer(start.beta.x)
        take_bounces(integrand, start, L, visit, hit, depth)
    return L


def walk(integrand: Integrand, start: PathState, visit: Visit) -> None:
    """Shows `visit` what `trace` does, whose sum is not wanted."""
    take_bounces(integrand, start, None, visit, None, 0)


def take_bounces(integrand: Integrand, start: PathState, L: Vec3 | None, visit: Visit | None, hit: Hit | None,
                 depth: int) -> None:
    """Bounce by bounce what `trace` does; `L`: (N,) what it returns, added to, or None. Other args as there."""
    onward = Onward(start, None)
    with bounces_taken(integrand, start) as bounce:
        while depth < integrand.max_depth and onward.count:
            state, step, onward = bounce(onward, depth, hit, L)
            if visit is not None:
                visit(depth, state, step)
            depth, hit = depth + 1, None
