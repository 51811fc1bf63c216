"""The radiance along camera rays: the forward sum over bounces."""

from __future__ import annotations

from collections.abc import Callable

from torch_radbp.jit.recording.lane_count import most_of
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import Flight, PathState
from torch_radbp.path.step import Onward, Step
from torch_radbp.path.taped_bounces import Bounce, bounces_taken, found_out
from torch_radbp.path.wavefront import BroughtToFilm, bounced, film_buffer, radiance_buffer
from torch_radbp.path.whole_paths import brought_by_whole_paths, traced_whole
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.vec import Vec3

Visit = Callable[[int, PathState, Step], None]


def trace(integrand: Integrand, start: PathState, visit: Visit | None = None, hit: Hit | None = None,
          depth: int = 0, bounce: Bounce = bounced, flight: Flight | None = None) -> Vec3:
    """The radiance L_1 along each lane's camera ray: the sum of beta_k E_k over bounces.

    Args:
        integrand: the scene and how to step.
        start: from `start_path`.
        visit: called at every depth with the depth, the path states and the decisions there.
        hit: what the camera rays hit, if that is known.
        depth: of the first bounce to take; later ones begin in the middle of a path.
        bounce: takes one bounce.
        flight: how far rays come in media before `hit`, if that is known.

    Returns:
        (N,) linear RGB, in the order of `start`; attached if `integrand.scene` is. If some lanes are of the derivative alone
        (`integrand.differentiated`), it is 0 there.
    """
    def traced(integrand: Integrand) -> Vec3:
        onward = Onward(start, None, hit, flight=flight)
        L = traced_whole(integrand, onward, depth, bounce) if visit is None else None
        if L is None:
            L = radiance_buffer(integrand, start)
            walk(integrand, onward, visit, L, depth, bounce)
        return L

    return traced(integrand) if visit is not None else found_out(integrand, traced)


def trace_to_film(integrand: Integrand, start: PathState, deposit: Callable[[BroughtToFilm], None],
                  visit: Visit | None = None, bounce: Bounce = bounced, hit: Hit | None = None) -> None:
    """Traces paths from lamps, each of whose vertices contributes to the film.

    Args:
        integrand: the scene, with the camera in place of the lights, and how to step.
        start: from `start_path`.
        deposit: called with the contributions of each bounce, (N,).
        visit, bounce, hit: as for `trace`.
    """
    onward, depth = Onward(start, None, hit), 0
    brought = brought_by_whole_paths(integrand, onward, bounce) if visit is None else None
    if brought is not None:
        for found in brought:
            deposit(found)
        return
    with bounces_taken(integrand, start.pdf.dtype, bounce, waits=False) as take:
        while depth < integrand.bounces:
            onward = onward.with_less_room(depth)
            if not most_of(onward.count):
                break
            found = film_buffer(integrand, start)
            state, step, onward = take(onward, depth, found)
            deposit(found)
            if visit is not None:
                visit(depth, state, step)
            depth += 1


def walk(integrand: Integrand, onward: Onward, visit: Visit | None, L: Vec3 | None = None, depth: int = 0,
         bounce: Bounce = bounced) -> None:
    """Takes all bounces of paths, calls `visit` at each, and adds their radiance to `L`.

    Args:
        integrand, visit, depth, bounce: as for `trace`.
        onward: the paths.
        L: (N,) the sum of radiance; None: it is not wanted.
    """
    with bounces_taken(integrand, onward.paths.pdf.dtype, bounce, waits=False) as take:
        while depth < integrand.bounces:
            onward = onward.with_less_room(depth)
            if not most_of(onward.count):
                break
            state, step, onward = take(onward, depth, L)
            if visit is not None:
                visit(depth, state, step)
            del state, step
            depth += 1
