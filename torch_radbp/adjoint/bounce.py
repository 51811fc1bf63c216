"""The backward pass of one bounce: its local vector-Jacobian product, and the memo of the bounce below.

If geometry, camera or directions carry derivatives, the local map is (theta, ray_k) -> (E_k, F_k, ray_{k+1}), and beside the
radiance the memo holds dloss/dray_{k+1}, which has come up from below; the same product turns it into dloss/dray_k.

Two bounces read a triangle whose vertices carry derivatives: the one that aims at it, and the one below, which stands on it.
So the memo also holds what the one below has found, and both are added to the gradient at once.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.local_map import BothCorners, Verdict, local_map
from torch_radbp.interface.texture import TextureValue
from torch_radbp.path.state import Arrival, Position, Settings
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.scene.tables.scene_tensors import Layout, SceneTensors
from torch_radbp.scene.tables.triangle_corners import Corners, at_corners
from torch_radbp.tensors.lookup import Tap, tapped
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.torch_internals import tree_map
from torch_radbp.tensors.vec import Ray, Vec3, rows
from torch_radbp.tensors.vector_jacobian import TableAdjoint, table_adjoints, vector_jacobian_product, zeros_unless
from torch_radbp.vertex.cone import Cone
from torch_radbp.vertex.interaction import corner_rows


class Memo(NamedTuple):
    """What a bounce gets of the one after it in the backward sweep: L_{k+1} and derivatives, (N,); 0 where there is none."""

    L: Vec3  # L_{k+1}
    adj_ray: Ray | None = None  # dloss/dray_{k+1}; None if rays do not carry derivatives
    adj_pdf: Tensor | None = None  # dloss/dpdf of the density with which the ray was sampled
    adj_cone: Cone | None = None  # dloss/dcone of the ray's cone; None if paths carry none
    hit: Hit | None = None  # hit of the ray; triangle -1: a miss
    adj_corners: Corners | None = None  # partial dloss/dp of that triangle's vertices; None unless two bounces contribute
    # bool: the loss depends on the path from the bounce below on; elsewhere all of the above is 0, and of no bounce is asked
    # whose connection is not free. None: of all bounces is asked.
    asked: Tensor | None = None

    def parts_of(self, other: Memo) -> Memo:
        """A memo with only those fields that are not None in another."""
        return Memo(*(None if found is None else part for part, found in zip(self, other)))


def empty_memo(like: Tensor, moving: bool, twice: bool, scene: SceneTensors) -> Memo:
    """The initial memo of the backward sweep, before the deepest bounce of each lane.

    Args:
        like: (N,) gives device and dtype.
        moving: whether rays carry derivatives.
        twice: whether triangles do, to each of which two bounces contribute.
        scene: tells whether there are ray cones and instances.
    """
    asked = torch.zeros_like(like, dtype=torch.bool) if lanes_may_be_left_out(scene.layout) else None
    if not moving:
        return Memo(Vec3.buffer(like), asked=asked)
    nothing = torch.zeros_like(like, dtype=torch.int32)
    instance = None if scene.triangles.instances is None else torch.zeros_like(nothing)
    miss = Hit(nothing - 1, *(torch.zeros_like(like) for _ in range(3)), instance)
    adj_cone = Cone(torch.zeros_like(like), torch.zeros_like(like)) if scene.layout.traces_cones else None
    memo = Memo(Vec3.buffer(like), Ray(Vec3.buffer(like), Vec3.buffer(like)), torch.zeros_like(like), adj_cone, miss,
                asked=asked)
    if not twice:
        return memo
    return memo._replace(adj_corners=tuple(Vec3.buffer(like) for _ in range(3)))


def lanes_may_be_left_out(layout: Layout) -> bool:
    """True if the backward pass may skip lanes on which the loss does not depend.

    Along paths from lamps a vertex counts by its connection to the camera alone: one that the camera does not see has no
    adjoint. In media, and where connections are evaluated outside of compiled code, all lanes have to be there.
    """
    return layout.from_lamps and not layout.reads_outside and not layout.media


@stage("below", "lane")
def affects_loss(below: Tensor, lane: Tensor, lanes: Tensor, visible: Tensor) -> Tensor:
    """(M,) bool: the loss depends on what paths contribute at this bounce or deeper ones.

    Args:
        below: (N,) bool, the same for the bounce below: `Memo.asked`.
        lane: (N,) int32, indices in the chunk of the paths that reach the bounce.
        lanes: (M,) int32, the paths among these to test.
        visible: (M,) bool, their connections are unoccluded.
    """
    return visible | rows(below, rows(lane, lanes))


class DifferentiatedPart(NamedTuple):
    """The part of a scene that lanes of one event read, and which of its tensors are differentiated."""

    scene: SceneTensors  # detached
    wanted: tuple[bool, ...]  # of each leaf of `scene`, counted as `leaves_of` does, whether to differentiate it
    # Of each value of the material whether it depends on no parameter that is differentiated, so that nobody asks for the
    # adjoints of its reads; of an event without material nothing.
    still: tuple[bool, ...]


class LanesOfChunk(NamedTuple):
    """The adjoints, memo and random keys of all lanes of a chunk in the backward sweep."""

    adj_L: Vec3  # derivative of the loss with respect to L_1
    memo: Memo
    key: LaneKey | None = None  # of random numbers; None: states have theirs


@stage("part", "arrival", "chunk")
def bounce_adjoint(part: DifferentiatedPart, arrival: Arrival, lanes: Tensor, verdict: Verdict | None, chunk: LanesOfChunk,
                   at: Position, settings: Settings, texture_values: tuple[TextureValue, ...]
                   ) -> tuple[Memo, list[list[TableAdjoint]], tuple[Vec3, ...]]:
    """The local vector-Jacobian product of one bounce: from dloss/dL_k to gradients of scene tables and dloss/dray_k.

    Args:
        part: the part of the scene that the lanes read.
        arrival, lanes: as for `bounce`.
        verdict: the decisions of the forward pass for these lanes; None where nothing is scattered.
        chunk: adjoints and memo of all lanes.
        at, settings, texture_values: as in the forward pass.

    Returns:
        The memo of these lanes for the bounce above; for each wanted leaf of the scene the adjoints of its reads; and the
        adjoints of `texture_values`.
    """
    arrival = rows(arrival, lanes)
    state, hit, scene = arrival.state, arrival.hit, part.scene
    # adj_k = adj_1 beta_k, and L_{k+1} from the memo.
    adj_L, memo, key = rows(chunk, state.lane)
    state = state if key is None else state._replace(key=key)
    adj_L = adj_L * state.beta
    # theta, attached: the tables that are differentiated, the ray, and values from outside.
    taps: list[Tap] = []
    attached, _ = tapped(scene, part.wanted, 0, taps)
    attached = attached._replace(layout=replace(scene.layout, still=(part.still,)))
    inputs, corners = (), None
    carries = settings.moving and (memo.adj_corners is not None or not settings.fixed_start)
    if carries:
        ray, pdf = tree_map(as_leaf, (state.ray, state.pdf))
        cone = None if state.cone is None else tree_map(as_leaf, state.cone)
        state, inputs = state._replace(ray=ray, pdf=pdf, cone=cone), (*ray.o, *ray.d, pdf, *(cone or ()))
    if memo.adj_corners is not None:
        here, there = tree_map(as_leaf, at_corners(scene.triangles.vertices.p, corner_rows(scene, hit))), None
        if verdict is not None:
            there = read_again(attached.triangles.vertices.p, corner_rows(scene, memo.hit), memo.adj_corners)
        corners = BothCorners(here, there)
        inputs = (*inputs, *(coordinate for corner in here for coordinate in corner))
    texture_values = tuple(texture._replace(value=texture.value.map(as_leaf)) for texture in texture_values)
    values = [channel for texture in texture_values for channel in texture.value]
    # (E_k, F_k, ray_{k+1}) of theta, and its product with (adj_k, adj_k L_{k+1}, dloss/dray_{k+1}).
    with torch.enable_grad():
        arrival = arrival._replace(state=state)
        verdict = None if verdict is None else verdict._replace(following=memo.hit)
        local = local_map(attached, scene, arrival, verdict, at, settings, texture_values, corners)
        outputs, adjoints = [*local.E, *local.F], [*adj_L, *(adj_L * memo.L)]
        if local.ahead is not None:
            outputs += [*local.ahead.ray.o, *local.ahead.ray.d, local.ahead.pdf, *(local.ahead.cone or ())]
            adjoints += [*memo.adj_ray.o, *memo.adj_ray.d, memo.adj_pdf, *(memo.adj_cone or ())]
        reads = [read.leaf for tap in taps for read in tap.reads]
        adjoints = iter(vector_jacobian_product(outputs, [*inputs, *values, *reads], adjoints))
    # L_k = E_k + F_k L_{k+1} for the bounce above.
    asked = None if memo.asked is None else torch.ones_like(lanes, dtype=torch.bool)
    above = Memo((local.E + local.F * memo.L).detach(), asked=asked)
    found = [zeros_unless(next(adjoints), leaf) for leaf in inputs]
    adj_values = tuple(Vec3(*(zeros_unless(next(adjoints), leaf) for leaf in texture.value)) for texture in texture_values)
    if carries:
        above = above._replace(adj_ray=Ray(Vec3(*found[:3]), Vec3(*found[3:6])), adj_pdf=found[6], hit=hit)
        if state.cone is not None:
            above = above._replace(adj_cone=Cone(*found[7:9]))
    if memo.adj_corners is not None:
        of_corners = found[-9:]
        above = above._replace(adj_corners=tuple(Vec3(*of_corners[first:first + 3]) for first in (0, 3, 6)))
    return above, [table_adjoints(tap, adjoints) for tap in taps], adj_values


def as_leaf(tensor: Tensor) -> Tensor:
    """A detached leaf tensor with the same values, which requires a gradient."""
    return tensor.clone().requires_grad_()


def read_again(positions: Vec3, corners: tuple[Tensor, Tensor, Tensor], adj_corners: Corners) -> Corners:
    """Reads the corners of triangles once more, with the adjoints that the bounce below has found for them."""
    return tuple(Vec3(*(tap.read(row, found) for tap, found in zip(positions, adj_p)))
                 for row, adj_p in zip(corners, adj_corners))
