"""Images by paths that begin at the lamps."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.rendered import rendered
from torch_radbp.boundary.terms.jump_watch import SilhouetteWarning
from torch_radbp.boundary.terms.of_call import EdgesOfCall
from torch_radbp.bsdf.roughness import smallest_alpha
from torch_radbp.call.chunks import LaneRange
from torch_radbp.call.lamps import lamps_as_source
from torch_radbp.call.light_film import LightFilm
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.view import View
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.connection.camera import from_lamps
from torch_radbp.interface.emitter import LightKind
from torch_radbp.path.integrand import Integrand
from torch_radbp.rendering.own_light import cameras_see_own_light
from torch_radbp.rendering.settings import CheckedRenderer, settings_of_integrand
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene.packing.material_tables import one_sided
from torch_radbp.scene.tables.scene_tensors import SceneTensors, proposal_of
from torch_radbp.tensors.differentiated import any_differentiated, detached

NARROW = 0.25  # roughness below which a material scatters narrowly
MOST_ON_CPU = 1 << 16  # lanes of a wavefront on a processor: more are quicker by a twentieth, and take more memory
OF_LAMPS = 0x2545F491  # tells the random numbers of paths from lamps from those of camera paths


def light_paths_of(renderer: CheckedRenderer, call: RenderCall, edges: EdgesOfCall) -> str:
    """Which light comes by paths from lamps: "camera" (none), "caustics" or "all"; where the user left it open, it warns.

    Raises:
        ValueError: for caustics of lamps with an extent whose derivatives would be wrong, if they are asked for.
    """
    caustic, chosen = renderer.jump_watch.caustic, renderer.light_paths
    if chosen == "auto":
        wanted = caustics_by_default(renderer, call, edges.lamps_in_mirrors)
        chosen = "caustics" if wanted else "camera"
        if caustic is not None and wanted:
            renderer.jump_watch.say(caustic.traced())
    if caustic is not None and chosen == "camera":
        renderer.jump_watch.say(caustic.lacking())
    moves = edges.casting is not None or edges.crossing is not None
    if chosen == "caustics" and moves and counts_edges_twice(renderer, call):
        raise ValueError("derivatives of caustics (light_paths='caustics') with sampling='attached', of lamps that have an "
                         "extent, would count edges twice that scattered directions slide over: take sampling='hybrid', "
                         "light_paths='camera', or terms without 'shadow'")
    return chosen


def caustics_by_default(renderer: CheckedRenderer, call: RenderCall, turned: bool) -> bool:
    """True if caustics come by paths from lamps by default; `turned`: mirrors in which lamps are seen turn."""
    if renderer.jump_watch.caustic is not None:
        return call.can_begin_at_lamps and not counts_edges_twice(renderer, call)
    return turned and call.can_follow_to_the_film and renderer.sampling != "attached"


def counts_edges_twice(renderer: CheckedRenderer, call: RenderCall) -> bool:
    """True if edges over which attached directions slide would count twice: paths from lamps have their effect, too."""
    return renderer.sampling == "attached" and not all(kind.delta for kind in lights_of_paths(call.scene, "caustics"))


def shared_image(renderer: CheckedRenderer, call: RenderCall, edges: EdgesOfCall) -> tuple[Tensor, RenderCall]:
    """Renders a call, (B, 3 + C, H, W), by paths that begin at the camera and at lamps, attached in forward and backward
    mode; also returns the call by which boundary terms are computed.

    Args:
        renderer: has the settings.
        call: of the images.
        edges: that move.
    """
    own = calls_of_light(renderer, call, light_paths_of(renderer, call, edges))
    if not own.of_lamps:
        return rendered(call), call
    found = torch.cat([image_from_lamps(renderer, own, number) for number in range(len(call.views))])
    if own.of_cameras is None:
        return found, own.whole
    images = rendered(own.of_cameras)
    return images + found if images.shape[1] == 3 else torch.cat([images[:, :3] + found, images[:, 3:]], 1), own.whole


class CallsOfLight(NamedTuple):
    """The calls whose images add up to an image, each with its own share of the light."""

    whole: RenderCall  # of all light by paths from the camera, as boundary terms take it
    of_cameras: RenderCall | None  # None: paths from the camera bring nothing
    of_lamps: list[RenderCall]  # of each view; empty: paths from the camera bring all


def calls_of_light(renderer: CheckedRenderer, call: RenderCall, light_paths: str) -> CallsOfLight:
    """Divides the light of a call among paths from the camera and paths from lamps, without warnings.

    Args:
        renderer, call: as for `shared_image`.
        light_paths: see `Settings.light_paths`.

    Raises:
        ValueError: if a camera cannot tell where it sees points.
    """
    lit = lights_of_paths(call.scene, light_paths)
    if light_paths == "camera" or not lit:
        return CallsOfLight(call, call, [])
    narrow = None if renderer.light_paths == "auto" else narrow_materials(call)
    whole, call = call, with_narrow_materials(call, narrow)
    # Paths from the camera find no light without extent by way of ideal vertices, so that there is nothing to share.
    apart = light_paths == "caustics" and narrow is None and all(kind.delta for kind in lit)
    first_only = light_paths == "all" and narrow is None and not any(
        appearance.kind.delta for appearance in call.scene.layout.appearances)
    share = call if apart else sharing(call, light_paths, 1 if first_only else None)
    if light_paths == "all" and all(kind.aimed for kind in lit):
        whole = whole._replace(camera_share=share)
    of_lamps = [call_from_lamps(renderer, call, number, light_paths) for number in range(len(call.views))]
    sees_nothing = first_only and all(kind.delta for kind in lit)  # of lights without extent, and no narrow scattering
    nothing = light_paths == "all" and call.quantities is None and (sees_nothing or not cameras_see_own_light(call))
    return CallsOfLight(whole, None if nothing else share, of_lamps)


def calls_traced(renderer: CheckedRenderer, call: RenderCall) -> list[RenderCall]:
    """The calls whose images may add up to the image of a call, for predictions; with paths from lamps if in doubt."""
    chosen = renderer.light_paths
    if chosen == "auto":
        mirrors = any(look.kind.delta for look in call.scene.layout.appearances)
        wanted = mirrors and caustics_by_default(renderer, call, call.integrand.settings.moving)
        chosen = "caustics" if wanted else "camera"
    own = calls_of_light(renderer, call, chosen if call.can_begin_at_lamps else "camera")
    return own.of_lamps if own.of_cameras is None else [own.of_cameras, *own.of_lamps]


def narrow_materials(call: RenderCall) -> Tensor | None:
    """(2 M,) bool: the materials of small roughness, from the front and from the back; None: there is none."""
    narrow = [smallest_alpha(bsdf) < NARROW for bsdf in one_sided(call.module.bsdfs())]
    return torch.tensor(narrow, device=call.scene.device) if any(narrow) else None


def with_narrow_materials(call: RenderCall, narrow: Tensor | None) -> RenderCall:
    """A call with the flags of materials of small roughness in the tables of its scene."""
    def knowing(scene: SceneTensors) -> SceneTensors:
        return scene._replace(materials=scene.materials._replace(narrow=narrow))

    still = knowing(call.integrand.scene)
    integrand = call.integrand._replace(scene=still, proposal=proposal_of(still), parts={})
    return call._replace(scene=knowing(call.scene), integrand=integrand, make_integrand=call.make_integrand)


def sharing(call: RenderCall, light_paths: str, most: int | None) -> RenderCall:
    """The call with paths that bring no light that is left to paths from the other end; of `most` vertices at most."""
    def shared(integrand: Integrand) -> Integrand:
        depth = integrand.max_depth if most is None else min(integrand.max_depth, most)
        return integrand._replace(settings=integrand.settings._replace(light_paths=light_paths), max_depth=depth, parts={})

    return call._replace(shared=True, make_integrand=lambda scene: shared(call.make_integrand(scene)),
                         integrand=shared(call.integrand))


def lights_of_paths(scene: SceneTensors, light_paths: str) -> list[LightKind]:
    """The kinds of light at which paths begin; caustics of an environment are left to paths from the camera."""
    return [kind for kind in scene.layout.lights if light_paths == "all" or not kind.surround]


def left_out_of_paths(light_paths: str) -> SilhouetteWarning:
    """The warning that derivatives lack edges past which paths from lamps bring light."""
    light, lack = ("caustics", "what edges and borders of shadows contribute to the derivatives of that light is left out, "
                   "or not exact") if light_paths == "caustics" else (
        "light", "left out, or not exact, is what edges contribute to its derivatives that it passes on its way to or from "
        "mirrors and glass, or from a projector or a beam (directionalarea), or by bounces with sampling='attached'; and "
        "where bodies touch. Other edges in view and borders of shadows count")
    return SilhouetteWarning(f"shapes, lamps or cameras move, and paths from lamps bring {light}: {lack}. Those by colours, "
                             f"powers, roughness, indices of refraction and heights of bump maps lack at most the edges "
                             f"that turned light passes. check_gradient measures how much it is")


def image_from_lamps(renderer: CheckedRenderer, own: CallsOfLight, number: int) -> Tensor:
    """(1, 3, H, W) the part of view `number`'s image by paths from lamps; attached to the scene, forwards and backwards."""
    call, view = own.of_lamps[number], own.whole.views[number]
    settings = call.integrand.settings
    if any_differentiated((call.scene.triangles, view.camera, call.source.ray)):
        renderer.jump_watch.say(left_out_of_paths(settings.light_paths))
    if settings.moving and view.camera.film.kernel.flat:
        renderer.jump_watch.say(SilhouetteWarning(
            "light of paths from lamps lands elsewhere where what turns it changes, which a film with a box filter does not "
            "see: derivatives lack it. Take a smooth filter, such as gaussian"))
    return rendered(call)


def call_from_lamps(renderer: CheckedRenderer, call: RenderCall, number: int, light_paths: str) -> RenderCall:
    """The call of paths from lamps to view `number`; the other args and errors as of `calls_of_light`."""
    view: View = call.views[number]
    if not view.camera.kind.sees_points:
        raise ValueError(f"paths from lamps cannot end at a {view.sensor.type} camera: only perspective, thinlens and "
                         f"orthographic cameras, and calibrated ones without distortion, tell how large what they see is; "
                         f"take light_paths=\"camera\"")
    keys = tuple(SampleKey(key.seed ^ OF_LAMPS, key.shared) for key in view.sample_keys)
    lamps, scene = lamps_as_source(call.scene, keys, light_paths), from_lamps(call.scene, view.camera)
    settings = settings_of_integrand(renderer, scene, lamps.ray)._replace(
        nee=True, hide_emitters=False, light_paths=light_paths)
    still = detached(scene)
    integrand = call.integrand._replace(scene=still, proposal=proposal_of(still), settings=settings, parts={}, clipping=None)

    def make_integrand(tensors: SceneTensors):
        return integrand._replace(scene=tensors, proposal=proposal_of(tensors), parts={})

    paths = view.width * view.height * call.spp
    most = max(wavefront.lanes for wavefront in call.wavefronts)  # what fits of paths from the camera fits of these
    most = min(most, -(-paths // call.workers), MOST_ON_CPU if call.scene.device.type == "cpu" else paths)
    wavefronts = [Wavefront((LaneRange(first, min(most, paths - first)),)) for first in range(0, paths, most)]
    sink = LightFilm(detached(view.camera).film.without_border(), (view.height, view.width), paths)
    return call._replace(
        scene=scene, source=lamps, sink=sink,
        wavefronts=wavefronts, make_integrand=make_integrand, integrand=integrand, together=False,
        following=settings.following, shared=True, quantities=None)
