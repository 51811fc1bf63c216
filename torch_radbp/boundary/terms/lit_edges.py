"""Edges as seen from light samples: the silhouettes past which light falls on its way to receivers."""

from __future__ import annotations

from typing import NamedTuple

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.curve.places import FEWEST
from torch_radbp.boundary.eye.edges_tried import edges_tried, eyes_for_each
from torch_radbp.boundary.eye.eyes import Eyes
from torch_radbp.boundary.eye.light_points import light_eyes, light_points
from torch_radbp.boundary.eye.seen_edges import Casting, Passed, places_on, places_seen, salted
from torch_radbp.boundary.eye.ways_down import lot_of_found
from torch_radbp.boundary.terms.covered_lights import Lights
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.view import View
from torch_radbp.path.direct_light import LightDraw
from torch_radbp.path.event import Ends
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene.tables.scene_tensors import extent_of
from torch_radbp.tensors.stage import Stages
from torch_radbp.tensors.vec import rows

SALT = 0x1F83D9AB  # tells the random numbers of borders from others
MOST = 1 << 19  # samples
LOOKS = 4  # for edges from each light sample

class LitEdges(NamedTuple):
    """N samples on edges as seen from M light samples, before the light is traced on to receivers."""

    passed: Passed  # with light samples as viewpoints
    draw: LightDraw  # (M,)
    eyes: Eyes  # (M,)
    count: int  # number of all light samples, those of other lights included


class EdgesFromLights:
    """Samples of edges as seen from lights, cached for terms that need the same ones; `call`: detached."""

    def __init__(self, call: RenderCall, casting: Casting):
        self.call, self.casting = call, casting
        self.last: tuple[tuple, LitEdges | None] | None = None  # what was asked for last, and the samples

    def lit(self, number: int, lights: Lights, share: int) -> LitEdges | None:
        """Samples on silhouette edges as light samples see them, cached; args and result as of `lit_edges`."""
        asked = number, share, [lights.covers(kind) for kind in self.call.scene.layout.lights]
        if self.last is None or self.last[0] != asked:
            self.last = asked, lit_edges(self.call, number, self.casting, lights, share)
        return self.last[1]


def lit_edges(call: RenderCall, number: int, casting: Casting, lights: Lights, share: int) -> LitEdges | None:
    """Samples silhouette edges as seen from light samples; None: they see none.

    Args:
        call: detached.
        number: of the view.
        casting: the edges.
        lights: the lights whose shadows are sampled.
        share: the number of image paths for each sample.
    """
    view, scene = call.views[number], call.scene
    points = light_points(call.stages, scene, view, samples_of(call, view, share))
    count, meant = len(points.kind), lights.of(scene)[points.kind].nonzero().squeeze(1)
    points = rows(points, meant)
    if not len(meant):
        return None
    eyes = call.integrand.part(Ends.SURROUNDINGS).call(light_eyes, points.draw)
    passed = places_lit(call.stages, geometry_of(scene), casting, eyes, salted(view, SALT), count)
    if passed is not None and casting.outline.parts is not None:  # what rests on its receiver is counted in `under_edges.py`
        passed = rows(passed, (rows(casting.outline.parts.counts, passed.edge) == 1.0).nonzero().squeeze(1))
    return None if passed is None or not len(passed.edge) else LitEdges(passed, points.draw, eyes, count)


def places_lit(stages: Stages, geometry: Geometry, casting: Casting, eyes: Eyes, seed: SampleKey,
               count: int) -> Passed | None:
    """Samples points on edges as light samples see them; args and result as for `places_seen`."""
    each, outline = eyes_for_each(casting.outline, eyes, LOOKS), casting.outline
    if not each:
        return places_seen(stages, geometry, casting, eyes, seed, LOOKS, count)
    found, eye = edges_tried(stages, geometry, outline, eyes, seed, each, extent_of(geometry))
    return places_on(stages, geometry, outline, eyes, seed, lot_of_found(found, eye, 1, count))


def samples_of(call: RenderCall, view: View, share: int) -> int:
    """The number of samples on shadow borders for a view, one for `share` paths of its image."""
    return max(FEWEST, min(MOST, view.width * view.height * call.spp // share))
