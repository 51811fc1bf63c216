"""The local map of a bounce as lanes have it, queue by queue: which functions, which part of the scene, which leaves.

`sweep.py` says what is done with these; here stands what that must keep in order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from torch import Tensor

from torch_radbp.adjoint.bounce import DifferentiatedPart, LanesOfChunk, Memo, affects_loss, bounce_adjoint
from torch_radbp.adjoint.kept_state import part_kept
from torch_radbp.adjoint.local_map import verdict_of
from torch_radbp.adjoint.outside import values_that_move
from torch_radbp.adjoint.scatter import Contribution
from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.jit.order import chosen
from torch_radbp.path.event import Ends, Event
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import Queue
from torch_radbp.path.state import PathState
from torch_radbp.path.step import Step, cut_to_count
from torch_radbp.path.texture_networks import Asking, values_of_queues
from torch_radbp.scene.tables.appearance import Appearance
from torch_radbp.scene.tables.part import leaves_of_part
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.record import rows_between
from torch_radbp.tensors.stage import Stage
from torch_radbp.tensors.vec import Vec3, rows
from torch_radbp.tensors.vector_jacobian import TableAdjoint
from torch_radbp.vertex.interaction import corner_rows


class Differentiated(NamedTuple):
    """The part of the scene, its leaves and the compiled stage by which the lanes of one event are differentiated."""

    part: DifferentiatedPart
    leaves: list[int]  # the numbers of the leaves that are differentiated
    stage: Stage  # `bounce_adjoint`, prepared for the part


class LocalAdjoint(NamedTuple):
    """The local map (theta, ray_k) -> (E_k, F_k, ray_{k+1}) of the M lanes of one queue, ready to be differentiated."""

    of_event: Differentiated
    arguments: tuple  # of `bounce_adjoint`, behind those of the event
    scatterer: Appearance | None  # None: the paths end here
    places: tuple[Place, ...]  # (M,) each, at which textures are read outside
    lane: Tensor  # (M,) int32, places in the chunk
    queue: Queue
    # If no bounce aims at what these lanes meet, of the three leaves of vertex positions and the integrand; else None.
    seen_first: tuple[Sequence[int], Integrand] | None

    def vector_jacobian_product(self) -> tuple[Memo, list[list[TableAdjoint]], tuple[Vec3, ...]]:
        """Differentiates the lanes: the memo for the bounce above, and the adjoints of table reads and texture values."""
        return self.of_event.stage(self.of_event.part, *self.arguments)

    def contributions(self, above: Memo, adj_reads: list[list[TableAdjoint]]) -> list[Contribution]:
        """The adjoints of table reads as contributions to gradients; args as `vector_jacobian_product` returns them."""
        parts = [Contribution(leaf, *read) for leaf, reads in zip(self.of_event.leaves, adj_reads) for read in reads]
        if self.seen_first is not None and above.adj_corners is not None:
            leaves, integrand = self.seen_first
            corners = integrand.part(Ends.SURROUNDINGS).call(corner_rows, above.hit)
            parts += [Contribution(leaf, row, part) for row, adj_p in zip(corners, above.adj_corners)
                      for leaf, part in zip(leaves, adj_p)]
        return parts


class LocalAdjoints:
    """Makes the local maps of bounces, which the backward sweep differentiates.

    Args:
        integrand: with a detached scene.
        numbered: a record of the scene's structure with the gradient index of each leaf, see `sweep.numbered_leaves`.
    """

    def __init__(self, integrand: Integrand, numbered: SceneTensors):
        self.integrand, self.numbered = integrand, numbered
        self.of_events: dict[Event, Differentiated] = {}
        positions, settings = numbered.triangles.vertices.p, integrand.settings
        # Two bounces read the vertices of a triangle, unless paths slide: the one that aims at it, and the one upon it.
        twice = settings.moving and settings.sampling != "attached" and positions.x is not None
        self.of_positions = list(positions) if twice else []  # leaves

    def of_event(self, event: Event) -> Differentiated:
        """The part of the scene, its leaves and the stage by which lanes with an event are differentiated; cached."""
        if event not in self.of_events:
            layout = self.integrand.scene.layout
            leaves = leaves_of_part(self.numbered, layout, self.integrand.scatterer(event))
            part = DifferentiatedPart(self.integrand.part(event).proposal, tuple(leaf is not None for leaf in leaves),
                                      event.still(layout))
            self.of_events[event] = Differentiated(part, [leaf for leaf in leaves if leaf is not None],
                                                   self.integrand.stages(bounce_adjoint).knowing(part))
        return self.of_events[event]

    def maps(self, state: PathState, step: Step, chunk: LanesOfChunk, depth: int) -> Iterator[LocalAdjoint]:
        """Yields the local maps of a bounce, one for each queue that is differentiated.

        Args:
            state: of the paths that reach the bounce.
            step: the decisions there.
            chunk: adjoints and memo of all lanes.
            depth: of the bounce.
        """
        state, step = cut_to_count(state, step)
        integrand = self.integrand
        state = state if chunk.key is None else part_kept(integrand, state)
        arrival = step.arrival(state)
        reached, of_chunk, at, settings = integrand.stages(bounce_adjoint).taken(
            arrival=arrival, chunk=chunk, at=integrand.at(depth), settings=integrand.settings_at(depth))
        queues = [(queue, values) for queue, values in zip(step.queues, step.texture_values)
                  if queue.first < queue.last and queue.derivative]
        asking = [(integrand.scatterer(queue.event),
                   integrand.places(queue.event, arrival, step.order[queue.first:queue.last], depth)) for queue, _ in queues]
        for (queue, _), (scatterer, places), values in zip(queues, asking, self.texture_values(queues, asking)):
            here = slice(queue.first, queue.last)
            lanes = step.order[here]
            verdict = rows_between(verdict_of(step), queue.first, queue.last) if queue.event.scatters else None
            if chunk.memo.asked is not None and verdict is not None:
                kept = chosen(integrand.stages(affects_loss)(chunk.memo.asked, state.lane, lanes, verdict.visible))
                lanes, verdict = integrand.stages(rows)((lanes, verdict), kept)
            yield LocalAdjoint(self.of_event(queue.event), (reached, lanes, verdict, of_chunk, at, settings, values),
                               scatterer, places, integrand.stages(rows)(state.lane, lanes), queue,
                               (self.of_positions, integrand) if depth == 0 else None)

    def texture_values(self, queues: Sequence[tuple[Queue, tuple[TextureValue, ...] | None]],
                       asking: Sequence[Asking]) -> Sequence[tuple[TextureValue, ...]]:
        """The values of network textures at a bounce, with derivatives by their inputs where rays carry derivatives.

        Args:
            queues: of the bounce, each with the values kept from the forward pass, or None.
            asking: for each queue its appearance and points.
        """
        scene = self.integrand.scene
        if self.integrand.settings.moving:
            return values_that_move(scene, asking)
        again = iter(values_of_queues(scene, [each for each, (_, kept) in zip(asking, queues) if kept is None]))
        return [next(again) if kept is None else rows_between(kept, 0, queue.last - queue.first) for queue, kept in queues]
