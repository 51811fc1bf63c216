"""Radiance from any source of paths to any sink."""

from __future__ import annotations

import warnings
from collections.abc import Callable

from torch import Tensor

from torch_radbp.adjoint.rendered import rendered
from torch_radbp.boundary.terms.jump_watch import SilhouetteWarning
from torch_radbp.call.chunks import LEAST_LANES, LaneRange
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.sink import Sink
from torch_radbp.call.source import PathSource
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.rendering.renderer import Renderer
from torch_radbp.rendering.settings import settings_of_integrand
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import any_differentiated

Keys = tuple[SampleKey, SampleKey]  # of random numbers: of the image, and of its derivative


def transport(renderer: Renderer, source: Callable[[Keys], PathSource], sink: Sink[RenderCall], lanes: int,
              seed: int | None = None) -> Tensor:
    """The values that a sink gathers from paths of a source; attached to scene and source, in forward and backward mode.

    Its derivatives are those of radiance along each path; where rays have no area, jumps at the edges of what moves are left
    out, which a `SilhouetteWarning` says.

    Args:
        renderer: has the scene, the strategy of the backward pass and all other settings.
        source: makes the source of paths from the keys of its random numbers.
        sink: receives the radiance of each path.
        lanes: how many paths there are.
        seed: as for a rendering.

    Returns:
        `SinkValues.values` of the sink.
    """
    call = renderer.prepare(seed, [0], 1, None)
    begins = source(call.views[0].sample_keys)
    settings = settings_of_integrand(renderer, call.scene, begins.tensors)
    if any_differentiated(call.scene.triangles.vertices.p):
        warnings.warn("shapes move among rays that have no area: what edges contribute to the derivative is left out",
                      SilhouetteWarning, stacklevel=2)

    def make_integrand(tensors: SceneTensors):
        return call.make_integrand(tensors)._replace(settings=settings)

    most = renderer.chunk or max(LEAST_LANES, -(-lanes // call.workers))
    wavefronts = [Wavefront((LaneRange(first, min(most, lanes - first)),)) for first in range(0, lanes, most)]
    return rendered(call._replace(
        source=begins, sink=sink, wavefronts=wavefronts, make_integrand=make_integrand, together=False,
        integrand=call.integrand._replace(settings=settings, parts={}), following=settings.following))
