"""Predicts the memory of calls, and divides these to fit a budget."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial

from torch import Tensor

from torch_radbp.boundary.terms.of_call import bytes_of_edges
from torch_radbp.call.render_call import RenderCall, pilot_paths
from torch_radbp.film.splat import TOGETHER
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lane_room import room_for
from torch_radbp.path.taped_bounces import keeps_all_lanes
from torch_radbp.rendering.bounce_memory import BounceMemory, measured, tables_of
from torch_radbp.rendering.memory import MemoryPlan, Workload, plan_memory, predict_all, reaching, record_sizes
from torch_radbp.rendering.settings import PRIMARY, SHADOW
from torch_radbp.tensors.differentiated import any_differentiated, detached, differentiable
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.torch_internals import tree_flatten

PILOT_LANES = 4096  # paths that predict the memory of a call
FEW_LANES = 64  # that tell what records they have


class MemoryPlanner:
    """Plans the calls of one renderer, and caches what it measures."""

    def __init__(self):
        self.measured: dict[tuple, BounceMemory] = {}  # by kind of call

    def plan(self, call: RenderCall, traced: Sequence[RenderCall], budget: str | int | None, adjoint_is_chosen: bool,
             terms: Collection[str]) -> MemoryPlan:
        """Plans chunk size and strategy of a call, with its predicted memory, by pilot paths.

        Args:
            call: with the chunks and the strategy that it would have without a budget.
            traced: the calls whose images add up to it, with the same strategy and no larger chunks.
            budget: bytes, or a string such as "2GiB"; None: the call is left as it is.
            adjoint_is_chosen: within a budget the strategy of the call is kept, too.
            terms: the terms of derivatives to compute, see `Renderer`.
        """
        works = [self.workload(each) for each in traced]
        works[0] = works[0]._replace(jumps=bytes_of_edges(call, PRIMARY in terms, SHADOW in terms))
        chunk = max(wavefront.lanes for wavefront in call.wavefronts)
        if budget is None:
            return predict_all(works, chunk, call.adjoint, call.record_bytes)
        return plan_memory(budget, works, chunk, call.adjoint if adjoint_is_chosen else None, call.shares_samples)

    def workload(self, call: RenderCall) -> Workload:
        """Measures the work of a call: path lengths, and the memory of a bounce."""
        scene, integrand, columns = detached(call.scene), call.integrand.with_stages(EAGER), call.source.columns
        moving = integrand.settings.moving
        triangles = (moving and integrand.settings.sampling != "attached"
                     and any_differentiated(call.scene.triangles.vertices.p))
        still = call.still()
        fractions = reaching(integrand, pilot_paths(still, PILOT_LANES))
        launched = keeps_all_lanes(call.integrand)
        if launched:
            fractions = room_for(fractions)[:integrand.max_depth]
        return Workload(fractions, sum(wavefront.lanes for wavefront in call.wavefronts), integrand.max_depth, scene.dtype,
                        call.stages.is_compiled, call.workers, moving,
                        record_sizes(integrand, pilot_paths(still, FEW_LANES), triangles), call.sink.bytes_held(call),
                        self.bounce_memory_of(call, integrand, triangles),
                        columns * min(call.spp, TOGETHER), columns * call.spp, launched=launched,
                        most=max(wavefront.lanes for wavefront in call.wavefronts), together=call.together)

    def bounce_memory_of(self, call: RenderCall, integrand: Integrand, triangles: bool) -> BounceMemory:
        """The memory of a bounce of a call; measured once for each kind of call.

        Args:
            call: whose scene, with what is differentiated in it, and whose strategy tell its kind.
            integrand: of the call, detached and eager.
            triangles: the backward pass carries adjoints of triangles from vertex to vertex.
        """
        wanted = tuple(isinstance(leaf, Tensor) and leaf.requires_grad for leaf in tree_flatten(call.scene)[0])
        taped = call.adjoint.taped
        case = (call.scene.layout, call.scene.dtype, integrand.settings, integrand.max_depth, wanted, triangles, taped)
        if case not in self.measured:
            attached = call.make_integrand(call.scene).with_stages(EAGER) if taped else None
            tables = tables_of(differentiable(call.scene), list(call.parameters.values()))
            asked, start = call.sink.asked_everywhere(call, integrand), call if taped else call.still()
            found = measured(integrand, asked, attached, partial(pilot_paths, start), wanted)
            self.measured[case] = found._replace(tables=tables)
        return self.measured[case]
