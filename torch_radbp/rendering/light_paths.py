"""Images by paths that begin at the lamps."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.adjoint.rendered import rendered
from torch_radbp.call.chunks import LEAST_LANES, LaneRange
from torch_radbp.call.lamps import lamps_of
from torch_radbp.call.light_film import LightFilm
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.view import View
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.connection.camera import from_lamps
from torch_radbp.rendering.settings import settings_of_integrand
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene.tables.scene_tensors import SceneTensors, proposal_of
from torch_radbp.tensors.differentiated import detached

OF_LAMPS = 0x2545F491  # tells the random numbers of paths from lamps from those of camera paths


def image_from_lamps(renderer, call: RenderCall, number: int) -> Tensor:
    """(1, 3, H, W) what paths from lamps bring to the image of view `number`: all light but what it sees of lamps directly.

    Attached to the scene, in either mode.

    Args:
        renderer: has the settings.
        call: of the image.
        number: of the view.

    Raises:
        ValueError: if the camera cannot tell where it sees points, or there are no lights.
    """
    view: View = call.views[number]
    if not view.camera.kind.sees_points:
        raise ValueError(f"paths from lamps cannot end at a {view.sensor.type} camera: only perspective, thinlens and "
                         f"orthographic cameras, and calibrated ones without distortion, tell how large what they see is; "
                         f"take light_paths=\"camera\"")
    keys = tuple(SampleKey(key.seed ^ OF_LAMPS, key.shared) for key in view.sample_keys)
    lamps, scene = lamps_of(call.scene, keys), from_lamps(call.scene, view.camera)
    settings = settings_of_integrand(renderer, scene, lamps.ray)._replace(nee=True, hide_emitters=False)
    still = detached(scene)
    integrand = call.integrand._replace(scene=still, proposal=proposal_of(still), settings=settings, parts={}, clipping=None)

    def make_integrand(tensors: SceneTensors):
        return integrand._replace(scene=tensors, proposal=proposal_of(tensors), parts={})

    paths = view.width * view.height * call.spp
    most = renderer.chunk or max(LEAST_LANES, -(-paths // call.workers))
    wavefronts = [Wavefront((LaneRange(first, min(most, paths - first)),)) for first in range(0, paths, most)]
    return rendered(call._replace(
        scene=scene, source=lamps, sink=LightFilm(detached(view.camera).film, (view.height, view.width), paths),
        wavefronts=wavefronts, make_integrand=make_integrand, integrand=integrand, together=False,
        following=settings.following, quantities=None))
