"""The backward sweep: from the deepest bounce up, with the memo of incident radiance.

    L_k     = E_k + F_k L_{k+1}
    adj_k   = dloss/dL_k = adj_1 beta_k
    dloss/dtheta = sum_k adj_k (dE_k/dtheta + dF_k/dtheta L_{k+1})

When bounce k is reached, L_{k+1} stands in the memo: one vector-Jacobian product of the local map theta -> (E_k, F_k) gives
the parameters' derivatives, and the memo becomes L_k for the bounce above. There is no subtraction of prefixes and no
division by a BSDF value, so that a reflectance of exactly 0 has the right derivative.

One bounce is differentiated in `bounce.py`; `local_adjoint.py` hands it the lanes, queue by queue.

Reference: Li 2020, section 2 (`d_Li_cached`, where the memo is called `cache`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.bounce import LanesOfChunk, empty_memo
from torch_radbp.adjoint.local_adjoint import LocalAdjoints
from torch_radbp.adjoint.outside import HELD, ModuleAdjoint, ModuleGradients
from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.state import PathState
from torch_radbp.path.step import Step, survivors
from torch_radbp.path.wavefront import take_step
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.record import with_leaves
from torch_radbp.tensors.vec import Vec2, Vec3


class PathRecord(NamedTuple):
    """What a chunk's forward pass records for its backward pass."""

    start: Callable[[], PathState]  # makes the camera paths again
    radiance: Vec3 | None  # L_1 of each lane, kept for path replay only
    states: dict[int, PathState]  # by depth, where the schedule keeps them; depth 0 is `start`, or the `part_kept` of them
    steps: dict[int, Step]  # by depth, empty with keep_hits=False
    bounces: int
    weight: Tensor | None = None  # camera weight of each lane's radiance; None: 1
    place: Vec2 | None = None  # position of each lane in its pixel
    key: LaneKey | None = None  # of random numbers, of each lane; None: states have theirs


def numbered_leaves(scene: SceneTensors, wanted: tuple[bool, ...]) -> SceneTensors:
    """The structure of a scene with the gradient index of each differentiated leaf; None elsewhere.

    Args:
        scene: the scene.
        wanted: for each leaf of it, whether it is differentiated.
    """
    counted = itertools.count()
    return with_leaves(scene, [next(counted) if want else None for want in wanted])


class Sweep:
    """The state of one chunk's backward pass: the memo, the adjoint of the image, the gradients.

    Args:
        integrand: with a detached scene.
        record: of the forward pass.
        adj_L: (N,) dloss/dL_1 of the chunk's lanes.
        numbered: the gradient indices of the leaves, see `numbered_leaves`.
        gradients: the gradients of the leaves, added to.
    """

    def __init__(self, integrand: Integrand, record: PathRecord, adj_L: Vec3, numbered: SceneTensors,
                 gradients: Gradients):
        self.integrand, self.record, self.adj_L = integrand, record, adj_L
        self.local = LocalAdjoints(integrand, numbered)
        self.gradients, self.modules = gradients, ModuleGradients(integrand.scene, numbered, gradients)
        self.memo = empty_memo(adj_L.x, self.moving, bool(self.local.of_positions), integrand.scene)

    @property
    def moving(self) -> bool:
        """True if rays carry derivatives, so that bounces must be differentiated from the deepest up."""
        return self.integrand.settings.moving

    @property
    def chunk(self) -> LanesOfChunk:
        """The adjoints, memo and random keys of all lanes."""
        return LanesOfChunk(self.adj_L, self.memo, self.record.key)

    def advance(self, state: PathState, depth: int) -> PathState:
        """Replays one bounce: returns the states of the paths that go on."""
        vertex, _, step = take_step(self.integrand, state, depth, self.record.steps.get(depth), with_light=False)
        return survivors(self.integrand, vertex.next, step)

    def remember(self, L: Vec3) -> None:
        """Puts incident radiance L_{k+1} into the memo."""
        self.memo = self.memo._replace(L=L.map(torch.clone), asked=None)

    def adjoint(self, state: PathState, depth: int) -> None:
        """Differentiates one bounce and moves the memo from L_{k+1} to L_k."""
        # What was decided at this bounce: which surfaces were met, which shadow rays were free, who went on.
        step = self.record.steps.get(depth)
        if step is None:
            step = take_step(self.integrand, state, depth, with_light=False)[-1]
        adj_modules = self.differentiate(state, step, self.chunk, depth)
        # Networks are asked for their gradients when enough lanes wait for them.
        self.modules.hold(adj_modules, len(state.lane))
        if self.modules.lanes > HELD:
            self.finish()

    def differentiate(self, state: PathState, step: Step, chunk: LanesOfChunk, depth: int) -> tuple[ModuleAdjoint, ...]:
        """Differentiates a bounce whose decisions are known; returns the adjoints of network texture values."""
        adj_modules: tuple[ModuleAdjoint, ...] = ()
        # Surface by surface: the lanes that meet one appearance go through the functions of that.
        for local in self.local.maps(state, step, chunk, depth):
            # (E_k, F_k) is a function of theta. Its vector-Jacobian product with (adj_k, adj_k L_{k+1}), for which L_{k+1}
            # stands in the memo.
            here, adj_reads, adj_values = local.vector_jacobian_product()
            # dloss/dtheta += adj_k (dE_k/dtheta + dF_k/dtheta L_{k+1}): in tables by entries, in networks by values.
            self.gradients.add(local.contributions(here, adj_reads))
            adj_modules += tuple(adjoint._replace(first=local.queue.first, last=local.queue.last) for adjoint in
                                 self.modules.adjoints(local.scatterer, local.places, adj_values))
            # L_k = E_k + F_k L_{k+1} stands in the memo for the bounce above.
            put_rows(chunk.memo.parts_of(here), local.lane, here)
        return adj_modules

    def finish(self) -> None:
        """Adds the gradients of network textures whose adjoints are still queued."""
        self.modules.add_held()
