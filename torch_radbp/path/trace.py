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
        walk(integrand, start, visit, L, hit, depth)
    return L


def walk(integrand: Integrand, start: PathState, visit: Visit | None, L: Vec3 | None = None, hit: Hit | None = None,
         depth: int = 0) -> None:
    """Shows `visit` what `trace` does, bounce by bounce.

    Args:
        integrand, start, visit, hit, depth: as there.
        L: (N,) the sum, which is added to; None: it is not wanted.
    """
    onward = Onward(start, None)
    with bounces_taken(integrand, start.pdf.dtype) as bounce:
        del start  # of which nothing is needed beside later bounces, as of these
        while depth < integrand.max_depth and onward.count:
            state, step, onward = bounce(onward, depth, hit, L)
            if visit is not None:
                visit(depth, state, step)
            del state, step
            depth, hit = depth + 1, None
