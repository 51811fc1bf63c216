"""The rays of camera paths after ideal vertices, attached."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.adjoint.attached import trace_attached
from torch_radbp.boundary.reflections.ideal_paths import only_ideal
from torch_radbp.call.render_call import RenderCall, started
from torch_radbp.path.bounce import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import Step
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.vec import Ray, Vec3, rows


def ray_after(call: RenderCall, integrand: Integrand, sample: CameraSample, depth: Tensor) -> Ray:
    """The rays of paths after so many vertices each.

    Args:
        integrand: attached.
        sample: (K,) where the paths begin, attached.
        depth: (K,) int64, less than the vertices of each.
    """
    integrand = only_ideal(integrand)
    settings = integrand.settings._replace(moving=True, sampling="hybrid")  # whether all directions are followed or not
    rays, lanes = [], []

    def visit(number: int, state: PathState, step: Step) -> None:
        own = (depth[state.lane.long()] == number).nonzero().squeeze(1)
        rays.append(rows(state.ray, own))
        lanes.append(state.lane[own].long())

    integrand = integrand._replace(settings=settings, max_depth=int(depth.max()) + 1).with_stages(call.stages.eager())
    trace_attached(integrand, started(call, sample), visit)
    place, found = torch.cat(lanes), joined(rays)
    return Ray(*(Vec3(*(torch.zeros_like(depth, dtype=part.dtype).index_copy(0, place, part) for part in parts))
                 for parts in found))
