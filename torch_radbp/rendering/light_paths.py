"""Images by paths that begin at the lamps."""

from __future__ import annotations

from typing import TYPE_CHECKING

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
from torch_radbp.rendering.settings import settings_of_integrand
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene.packing.material_tables import one_sided
from torch_radbp.scene.tables.scene_tensors import SceneTensors, proposal_of
from torch_radbp.tensors.differentiated import any_differentiated, detached

if TYPE_CHECKING:
    from torch_radbp.rendering.renderer import Renderer

NARROW = 0.25  # roughness below which a material scatters narrowly
MOST_ON_CPU = 1 << 16  # lanes of a wavefront on a processor: more are quicker by a twentieth, and take more memory
OF_LAMPS = 0x2545F491  # tells the random numbers of paths from lamps from those of camera paths


def light_paths_of(renderer: Renderer, call: RenderCall, edges: EdgesOfCall) -> str:
    """Which light is that of paths that begin at lamps, as of `Settings`; says so where the user has not."""
    caustic, chosen = renderer.jump_watch.caustic, renderer.light_paths
    if chosen == "auto":
        wanted = call.can_begin_at_lamps if caustic is not None else edges.lamps_in_mirrors and call.can_follow_to_the_film
        chosen = "caustics" if wanted else "camera"
        if caustic is not None and wanted:
            renderer.jump_watch.say(caustic.traced())
    if caustic is not None and chosen == "camera":
        renderer.jump_watch.say(caustic.lacking())
    return chosen


def shared_image(renderer: Renderer, call: RenderCall, edges: EdgesOfCall) -> tuple[Tensor, RenderCall]:
    """The images of a call, (B, 3 + C, H, W), by paths that begin at the camera and at lamps, attached, in either mode; and
    the call as boundary terms take it.

    Args:
        renderer: has the settings.
        call: of the images.
        edges: that move.
    """
    light_paths = light_paths_of(renderer, call, edges)
    lit = lights_of_paths(call.scene, light_paths)
    if light_paths == "camera" or not lit:
        return rendered(call), call
    narrow = None if renderer.light_paths == "auto" else narrow_materials(call)
    whole, call = call, with_narrow_materials(call, narrow)
    # Paths from the camera find no light without extent by way of ideal vertices, so that there is nothing to share.
    apart = light_paths == "caustics" and narrow is None and all(kind.delta for kind in lit)
    first_only = light_paths == "all" and narrow is None and not any(
        appearance.kind.delta for appearance in call.scene.layout.appearances)
    share = call if apart else sharing(call, light_paths, 1 if first_only else None)
    if light_paths == "all" and all(kind.aimed for kind in lit):
        whole = whole._replace(camera_share=share)
    found = torch.cat([image_from_lamps(renderer, call, number, light_paths) for number in range(len(call.views))])
    sees_nothing = first_only and all(kind.delta for kind in lit)  # of lights without extent, and no narrow scattering
    if light_paths == "all" and call.quantities is None and (sees_nothing or not cameras_see_own_light(call)):
        return found, whole
    images = rendered(share)
    return images + found if images.shape[1] == 3 else torch.cat([images[:, :3] + found, images[:, 3:]], 1), whole


def narrow_materials(call: RenderCall) -> Tensor | None:
    """(2 M,) bool: the materials of small roughness, from the front and from the back; None: there is none."""
    narrow = [smallest_alpha(bsdf) < NARROW for bsdf in one_sided(call.module.bsdfs())]
    return torch.tensor(narrow, device=call.scene.device) if any(narrow) else None


def with_narrow_materials(call: RenderCall, narrow: Tensor | None) -> RenderCall:
    """A call whose scene knows the materials of small roughness."""
    def knowing(scene: SceneTensors) -> SceneTensors:
        return scene._replace(materials=scene.materials._replace(narrow=narrow))

    still = knowing(call.integrand.scene)
    integrand = call.integrand._replace(scene=still, proposal=proposal_of(still), parts={})
    return call._replace(scene=knowing(call.scene), integrand=integrand, make_integrand=call.make_integrand)


def sharing(call: RenderCall, light_paths: str, most: int | None) -> RenderCall:
    """A call whose paths share light with those from the other end; of at most `most` vertices, if it is given."""
    def shared(integrand: Integrand) -> Integrand:
        depth = integrand.max_depth if most is None else min(integrand.max_depth, most)
        return integrand._replace(settings=integrand.settings._replace(light_paths=light_paths), max_depth=depth, parts={})

    return call._replace(shared=True, make_integrand=lambda scene: shared(call.make_integrand(scene)),
                         integrand=shared(call.integrand))


def lights_of_paths(scene: SceneTensors, light_paths: str) -> list[LightKind]:
    """The kinds of light at which paths begin: caustics of the surroundings are the camera's."""
    return [kind for kind in scene.layout.lights if light_paths == "all" or not kind.surround]


def left_out_of_paths(light_paths: str) -> SilhouetteWarning:
    """The warning that no term has the edges that light from lamps passes."""
    light, lack = ("caustics", "what edges and borders of shadows contribute to the derivatives of that light is left out, "
                   "or not exact") if light_paths == "caustics" else (
        "light", "left out, or not exact, is what edges contribute to its derivatives that it passes on its way to or from "
        "mirrors and glass, or from a projector or a beam (directionalarea), or by bounces with sampling='attached'; and "
        "where bodies touch. Other edges in view and borders of shadows count")
    return SilhouetteWarning(f"shapes, lamps or cameras move, and paths from lamps bring {light}: {lack}. Those by colours, "
                             f"powers, roughness, indices of refraction and heights of bump maps lack at most the edges "
                             f"that turned light passes. check_gradient measures how much it is")


def image_from_lamps(renderer: Renderer, call: RenderCall, number: int, light_paths: str = "all") -> Tensor:
    """(1, 3, H, W) what paths from lamps bring to the image of view `number`; attached to the scene, in either mode.

    Args:
        renderer, call: as for `shared_image`.
        number: of the view.
        light_paths: see `Settings.light_paths`.

    Raises:
        ValueError: if the camera cannot tell where it sees points.
    """
    found, view = call_from_lamps(renderer, call, number, light_paths), call.views[number]
    if any_differentiated((found.scene.triangles, view.camera, found.source.ray)):
        renderer.jump_watch.say(left_out_of_paths(light_paths))
    if found.integrand.settings.moving and view.camera.film.kernel.flat:
        renderer.jump_watch.say(SilhouetteWarning(
            "light of paths from lamps lands elsewhere where what turns it changes, which a film with a box filter does not "
            "see: derivatives lack it. Take a smooth filter, such as gaussian"))
    return rendered(found)


def calls_from_lamps(renderer: Renderer, call: RenderCall) -> list[RenderCall]:
    """The calls of paths from lamps that may belong to a call, of each view, for predictions; nothing is said."""
    chosen = renderer.light_paths
    if chosen == "auto":
        caustic, turned = renderer.jump_watch.caustic, call.integrand.settings.moving and call.can_follow_to_the_film
        mirrors = any(look.kind.delta for look in call.scene.layout.appearances)
        chosen = "caustics" if mirrors and (turned or caustic is not None and call.can_begin_at_lamps) else "camera"
    if chosen == "camera" or not call.can_begin_at_lamps or not lights_of_paths(call.scene, chosen):
        return []
    return [call_from_lamps(renderer, call, number, chosen) for number in range(len(call.views))]


def call_from_lamps(renderer: Renderer, call: RenderCall, number: int, light_paths: str) -> RenderCall:
    """The call of `image_from_lamps`; args and errors as there."""
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
