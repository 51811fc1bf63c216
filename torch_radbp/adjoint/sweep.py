"""The backward sweep: from the deepest bounce up, with the memo of incident radiance.

    L_k     = E_k + F_k L_{k+1}
    adj_k   = dloss/dL_k = adj_1 beta_k
    dloss/dtheta = sum_k adj_k (dE_k/dtheta + dF_k/dtheta L_{k+1})

When bounce k is reached, L_{k+1} stands in the memo: one vector-Jacobian product of the local map theta -> (E_k, F_k) gives
the parameters' derivatives, and the memo becomes L_k for the bounce above. There is no subtraction of prefixes and no
division by a BSDF value, so that a reflectance of exactly 0 has the right derivative.

How one bounce is differentiated is told in `bounce.py`.

Reference: Li 2020, section 2 (`d_Li_cached`, where the memo is called `cache`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.bounce import Memo, bounce_adjoint, empty_memo
from torch_radbp.adjoint.local_map import Verdict
from torch_radbp.adjoint.outside import HELD, ModuleAdjoint, ModuleGradients, values_that_move
from torch_radbp.adjoint.scatter import Contribution, Gradients
from torch_radbp.path.event import Ends, Event
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.texture_networks import values_of_queues
from torch_radbp.path.wavefront import Step, cut_to_count, put_rows, survivors, take_step
from torch_radbp.scene.interaction import corner_rows
from torch_radbp.scene.part import leaves_of_part
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.record import rows_between, with_leaves
from torch_radbp.tensors.vec import Vec2, Vec3, rows


class PathRecord(NamedTuple):
    """The record of a chunk's forward pass that its backward pass needs."""

    start: Callable[[], PathState]  # makes the camera paths again
    radiance: Vec3 | None  # L_1 of each lane, kept for path replay only
    states: dict[int, PathState]  # by depth, where the schedule keeps them; depth 0 is `start`
    steps: dict[int, Step]  # by depth, empty with keep_hits=False
    bounces: int
    weight: Tensor | None = None  # what counts of each lane's radiance; None: all of it
    place: Vec2 | None = None  # of each lane in its pixel


def numbered_leaves(scene: SceneTensors, wanted: tuple[bool, ...]) -> SceneTensors:
    """The record with the numbers of the leaves that are to be differentiated, as `Gradients` counts them; None elsewhere.

    Args:
        scene: any.
        wanted: of each leaf of it.
    """
    counted = itertools.count()
    return with_leaves(scene, [next(counted) if want else None for want in wanted])


class Adjoint(NamedTuple):
    """What the lanes of one queue are differentiated with."""

    scene: SceneTensors  # the part that they read, detached
    wanted: tuple[bool, ...]  # which leaves of it have a number
    still: tuple[bool, ...]  # which values of the material do not depend on them
    leaves: list[int]  # these numbers
    of_bounce: Callable  # `bounce_adjoint`


class Sweep:
    """The state of one chunk's backward pass: the memo, the adjoint of the image, the gradients.

    Args:
        integrand: of the detached scene.
        record: of the forward pass.
        adj_L: (N,) dloss/dL_1 of the chunk's lanes.
        numbered: the scene with the numbers of the leaves to differentiate, see `numbered_leaves`.
        gradients: of these leaves, added to.
    """

    def __init__(self, integrand: Integrand, record: PathRecord, adj_L: Vec3, numbered: SceneTensors,
                 gradients: Gradients):
        self.integrand, self.record, self.adj_L = integrand, record, adj_L
        self.numbered, self.gradients = numbered, gradients
        self.modules = ModuleGradients(integrand.scene, numbered, gradients)
        self.adjoints: dict[Event, Adjoint] = {}
        positions = numbered.triangles.vertices.p
        twice = self.moving and integrand.settings.sampling != "attached" and positions.x is not None
        self.of_positions = list(positions) if twice else []  # leaves
        self.memo = empty_memo(adj_L.x, self.moving, twice, integrand.scene)

    def adjoint_of(self, event: Event) -> Adjoint:
        """What lanes are differentiated with to which this happens; made once."""
        if event not in self.adjoints:
            part, scatterer = self.integrand.part(event), self.integrand.scatterer(event)
            leaves = leaves_of_part(self.numbered, self.integrand.scene.layout, scatterer)
            wanted = tuple(leaf is not None for leaf in leaves)
            still = self.integrand.scene.layout.still[event.appearance] if event.scatters else ()
            self.adjoints[event] = Adjoint(
                part.proposal, wanted, still, [leaf for leaf in leaves if leaf is not None],
                self.integrand.stages(bounce_adjoint).knowing(part.tables, wanted, still))
        return self.adjoints[event]

    def advance(self, state: PathState, depth: int) -> PathState:
        """Replays one bounce."""
        vertex, _, step = take_step(self.integrand, state, depth, self.record.steps.get(depth), with_light=False)
        return survivors(self.integrand, vertex.next, step)

    @property
    def moving(self) -> bool:
        """True if rays carry derivatives, so that bounces must be differentiated from the deepest up."""
        return self.integrand.settings.moving

    def remember(self, L: Vec3) -> None:
        """Puts incident radiance into the memo."""
        self.memo = self.memo._replace(L=L.map(torch.clone))

    def adjoint(self, state: PathState, depth: int) -> None:
        """Differentiates one bounce and moves the memo from L_{k+1} to L_k."""
        step = self.record.steps.get(depth)
        if step is None:
            step = take_step(self.integrand, state, depth, with_light=False)[-1]
        self.modules.hold(self.differentiate(state, step, self.memo, self.adj_L, depth), len(state.lane))
        if self.modules.lanes > HELD:
            self.finish()

    def finish(self) -> None:
        """Adds what is still missing to the gradients."""
        self.modules.add_held()

    def differentiate(self, state: PathState, step: Step, memo: Memo, adj_L: Vec3, depth: int) -> tuple[ModuleAdjoint, ...]:
        """As `adjoint`, of a bounce whose decisions are known, but for the gradients of modules: returns the adjoints."""
        state, step = cut_to_count(state, step)
        integrand, arrival = self.integrand, step.arrival(state)
        same = integrand.stages(bounce_adjoint).taken(
            arrival=arrival, adj_L=adj_L, memo=memo, at=integrand.at(depth), settings=integrand.settings_at(depth))
        reached, *of_chunk, at, settings = same
        queues = [(queue, known) for queue, known in zip(step.queues, step.texture_values)
                  if queue.first < queue.last and queue.derivative]
        asking = [(integrand.scatterer(queue.event),
                   integrand.places(queue.event, arrival, step.order[queue.first:queue.last], depth)) for queue, _ in queues]
        if self.moving:
            values = values_that_move(integrand.scene, asking)
        else:
            unknown = [own for own, (_, known) in zip(asking, queues) if known is None]
            found = iter(values_of_queues(integrand.scene, unknown))
            values = [next(found) if known is None else rows_between(known, 0, queue.last - queue.first)
                      for queue, known in queues]
        asked_of_modules: tuple[ModuleAdjoint, ...] = ()
        for (queue, _), (scatterer, places), texture_values in zip(queues, asking, values):
            here, adjoint = slice(queue.first, queue.last), self.adjoint_of(queue.event)
            lanes = step.order[here]
            verdict = Verdict(step.visible[here], step.survives[here]) if queue.event.scatters else None
            above, tables, adj_values = adjoint.of_bounce(adjoint.scene, adjoint.wanted, adjoint.still, reached, lanes,
                                                          verdict, *of_chunk, at, settings, texture_values)
            asked_of_modules += self.modules.adjoints(scatterer, places, adj_values)
            found = [Contribution(leaf, *read) for leaf, reads in zip(adjoint.leaves, tables) for read in reads]
            if depth == 0 and above.adj_corners is not None:  # no bounce aims at what the camera sees
                corners = integrand.part(Ends.SURROUNDINGS).call(corner_rows, above.hit)
                found += [Contribution(leaf, row, part) for row, adj_p in zip(corners, above.adj_corners)
                          for leaf, part in zip(self.of_positions, adj_p)]
            self.gradients.add(found)
            put_rows(memo, integrand.stages(rows)(state.lane, lanes), above)
        return asked_of_modules
