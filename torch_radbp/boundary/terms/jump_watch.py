"""Warnings about derivatives without the contribution of silhouettes, shadows or discontinuous BSDFs.

The derivative of an image has two parts: that of the radiance inside each surface, and what is gained or lost at the edges
where one surface ends and another appears behind it. The second part is computed for the edges that the camera sees, see
`primary.py`, or sees in ideal mirrors and through ideal glass, see `reflections`, unless the renderer is told to leave it
out. It is missing for those that surfaces see there, and for those seen through rough glass. Borders of shadows are
silhouettes as seen from a light. Where a term is off, the parameters are those that move some of its own places
(`warning/left_out.py`, `shadow_term.py`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import torch
from torch import Tensor

from torch_radbp.boundary.curve.rendering import MOVE_LIGHTS, Rendering, listed
from torch_radbp.boundary.curve.term import TERMS
from torch_radbp.boundary.terms.edges_in_media import left_out_in_media
from torch_radbp.boundary.terms.shadows import shadows_left_out
from torch_radbp.boundary.warning.caustics import Caustic, caustic_of
from torch_radbp.boundary.warning.inward import inward_faces
from torch_radbp.boundary.warning.left_out import lines_left_out, silhouettes_left_out
from torch_radbp.boundary.warning.panes_met import panes_met
from torch_radbp.boundary.warning.slid_over import slid_over
from torch_radbp.boundary.warning.unmapped import unmapped_textures
from torch_radbp.boundary.warning.without_rays import views_without_rays
from torch_radbp.plugin.errors import level_of_the_caller
from torch_radbp.vertex.material import sampling_at

FLAT = 1e-6  # ratio of thickness to extent below which a scene is a plane
# How many times as far from the origin as it is large a shape may lie: its own vertices are rounded, or those of rays.
FARTHEST = {torch.float32: 5e3, torch.float64: 4e4}
AT_ONCE = 1 << 16  # corners of triangles, so that little memory is touched for the first time


OF_RAYS = ("A single ray has no area that they sweep, but a mean over rays, such as irradiance, has a biased gradient. "
           "Images of sensors have that contribution")


class SilhouetteWarning(UserWarning):
    """Warning: derivatives lack the contribution of silhouettes or shadow borders.

    The image is discontinuous at outlines and shadow borders; their motion over pixels contributes to derivatives, which is
    not computed. The message names the parameters, and `check_gradient` measures by how much theirs are biased. Each
    renderer says it once; `warnings.simplefilter("ignore", rb.SilhouetteWarning)` silences it.
    """


class JumpWarning(SilhouetteWarning):
    """Warning: derivatives lack the contribution of a discontinuous BSDF, such as a silhouette of its microfacets.

    The message names the parameters, and the `sampling` that has the contribution, if any; `check_gradient` measures the
    bias.
    """


class JumpWatch:
    """Warns, once of each kind, of discontinuities whose contribution derivatives lack, and of light that images lack."""

    def __init__(self) -> None:
        # Those that have not warned yet.
        self.looks = [self.silhouettes_in_view, self.lines_in_view, self.shadows_in_view, self.edges_in_media,
                      self.jumps_of_a_bsdf, self.edges_slid_over, self.edges_far_off]
        self.said: dict[str, Warning] = {}  # by their messages
        # Looks at the image that are due: one at the first rendering is enough.
        self.of_images: list[Callable] = [unmapped_textures, inward_faces, panes_met]
        self.caustic: Caustic | None = None  # as of the first rendering
        self.viewed: set[int] = set()  # ids of the sensors whose rays have been looked at
        self.looked_at: set[str | tuple] = set()  # the moving parameters for which shadows of some kinds have been searched
        self.sliding: set[str] = set()  # the parameters for which edges that directions slide over have been looked at
        self.in_media: set[frozenset[str]] = set()  # sets of them for which edges in media have been looked at
        self.placed: set[str] = set()  # those of which it is known how far from the origin they move things

    def look(self, rendering: Rendering) -> None:
        """Examines a rendering, and warns of what its image or its derivatives lack."""
        due, self.of_images = self.of_images, []
        if due:
            self.caustic = caustic_of(rendering)
        for look in due:
            self.say(look(rendering))
        sensors = {id(sensor) for sensor in rendering.sensors}
        if not sensors <= self.viewed:
            self.say(views_without_rays(rendering, self.viewed))
            self.viewed |= sensors
        segments = rendering.call.scene.layout.traces_segments  # through media, where all are looked at together
        for look in [self.edges_in_media] if segments else self.looks:
            warning = look(rendering)
            if warning is not None:
                self.looks = [other for other in self.looks if other != look]  # not in place: other threads look too
                self.say(warning)

    def say(self, warning: Warning | None) -> None:
        """Issues a warning, unless it is None or was issued before."""
        if warning is not None and str(warning) not in self.said:
            self.said[str(warning)] = warning
            warnings.warn(warning, stacklevel=level_of_the_caller())

    def silhouettes_in_view(self, rendering: Rendering) -> SilhouetteWarning | None:
        """The warning about silhouettes of moving shapes, or of all shapes if a camera moves, or None.

        Hidden silhouettes count as well.
        """
        missing = missing_silhouettes(rendering)
        if not missing:
            return None
        instead = ("A loss that depends on outlines, such as a shape's against its background, has a biased gradient; "
                   "check_gradient measures by how much. The default, terms=('interior', 'primary'), has what silhouettes "
                   "in view contribute") if rendering.has_area else OF_RAYS
        return SilhouetteWarning(f"derivatives with respect to {listed(missing)} lack the contribution of silhouettes: at "
                                 f"least {max(missing.values())} edges move in view, and what is seen is discontinuous "
                                 f"there. {instead}")

    def lines_in_view(self, rendering: Rendering) -> SilhouetteWarning | None:
        """The warning about moving lines on surfaces in view whose term is switched off; or None.

        Parameters that move silhouettes, too, are left out; hidden lines count as well.
        """
        if rendering.primary or rendering.call.scene.triangles.vertices.uv is None:
            return None
        found = {name: term.what for term in TERMS for name in sorted(lines_left_out(term, rendering))}
        named = missing_silhouettes(rendering) if found else {}
        found = {name: what for name, what in found.items() if name not in named}
        if not found:
            return None
        instead = "The default terms have it; check_gradient measures the bias" if rendering.has_area else OF_RAYS
        return SilhouetteWarning(f"derivatives with respect to {listed(found)} lack the contribution of "
                                 f"{' and '.join(dict.fromkeys(found.values()))}: some move in view. {instead}")

    def edges_in_media(self, rendering: Rendering) -> SilhouetteWarning | None:
        """The warning about edges and shadows in media that no term computes, if anything moves, or None.

        It is looked for once for each set of parameters.
        """
        names = frozenset(moving_names(rendering))
        if not names or names in self.in_media:
            return None
        self.in_media.add(names)
        found = left_out_in_media(rendering)
        if not found:
            return None
        return SilhouetteWarning(f"derivatives with respect to {listed(sorted(names))} lack what these contribute, since "
                                 f"light passes media: {'; '.join(found)}. check_gradient measures how much that is. Those "
                                 "by extinction, albedo and phase function, by colours and by lamps' powers lack nothing")

    def shadows_in_view(self, rendering: Rendering) -> SilhouetteWarning | None:
        """The warning about shadow borders that move with a light, an occluder, a receiver or the camera, or None.

        None where these are computed. Parameters that move silhouettes, too, are left out. Shadows are searched once for
        each parameter by the terms that are switched off, or that need pixels of some area.
        """
        soft, sharp = rendering.shadows, rendering.shadows and rendering.has_area
        found = self.sharp_shadows_in_mirrors(rendering) if soft else None
        if found is not None or soft and sharp or rendering.max_depth < 2:
            return found
        names = moving_names(rendering)
        looks = {(name, soft, sharp) for name in names}
        if not looks or rendering.has_area and looks <= self.looked_at:
            return None
        self.looked_at |= looks
        missing = shadows_left_out(rendering) - missing_silhouettes(rendering).keys()
        if not missing:
            return None
        instead = ("A loss that depends on where shadows lie has a biased gradient; check_gradient measures by how much. "
                   "The default terms have it") if rendering.has_area else OF_RAYS
        return SilhouetteWarning(f"derivatives with respect to {listed(sorted(missing))} lack the contribution of the "
                                 f"borders of shadows: some in view move over the image, or over the surface on which "
                                 f"they fall. Those of lamps with an extent, and of light from all around, are soft, but "
                                 f"the border of what hides a part of these counts likewise. {instead}")

    def sharp_shadows_in_mirrors(self, rendering: Rendering) -> SilhouetteWarning | None:
        """The warning about shadows of lights without extent that surfaces may see in ideal mirrors and glass, or None.

        Those that cameras see in mirrors and glass are computed (`reflections`).
        """
        ideal = [bsdf for bsdf, kind in rendering.materials() if kind.delta]
        scattering = any(kind.smooth for _, kind in rendering.materials())
        at_once = [] if rendering.has_area else ideal
        later = ideal if scattering and rendering.max_depth > 3 else []
        lights = [emitter for emitter in rendering.emitters if emitter.kind().delta]
        names = {name for emitter in lights for name in rendering.moving(emitter, MOVE_LIGHTS)}
        names = names.union(*rendering.movers, *rendering.camera_movers)
        if not ((at_once or later) and lights and names) or rendering.max_depth < 3 or names <= self.looked_at:
            return None
        self.looked_at |= names
        by, of = ("", at_once) if at_once else (" by surfaces, not by the camera,", later)
        return SilhouetteWarning(f"derivatives with respect to {listed(sorted(names))} lack the contribution of the borders "
                                 f"of shadows that `{rendering.scene.name_of(lights[0])}`, a light without extent, casts, "
                                 f"where they are seen{by} in `{rendering.scene.name_of(of[0])}`, a mirror or glass. "
                                 f"Give the light an extent, such as a small sphere with an area emitter; check_gradient "
                                 f"measures how much that matters")

    def jumps_of_a_bsdf(self, rendering: Rendering) -> JumpWarning | None:
        """The warning about a BSDF that is discontinuous in its directions, when these turn, or None.

        Detached directions miss that, and attached ones as well if samples end at the discontinuity; see `Kind.jumps` and
        `Kind.ends`.
        """
        sampling = rendering.sampling
        jumping = [(bsdf, kind) for bsdf, kind in rendering.materials()
                   if kind.ends or kind.jumps and sampling_at(kind, sampling) != "attached"]
        turning = [name for names in rendering.movers for name in names]
        turning += [name for names in rendering.camera_movers for name in names]
        for bsdf, kind in jumping:
            turning += rendering.turning(bsdf, kind) if kind.ends else rendering.moving(bsdf, ("eta",))
        if not (jumping and turning):
            return None
        bsdf, kind = jumping[0]
        lacking = (f"derivatives with respect to {listed(turning)} lack a part at the {bsdf.type} "
                   f"`{rendering.scene.name_of(bsdf)}`: its ")
        if not kind.ends:
            return JumpWarning(f"{lacking}refraction by GGX facets ends with a jump, which directions without derivatives "
                               f"miss. Use sampling='attached', or a roughdielectric of the distribution 'beckmann', which "
                               f"has no jump")
        instead = ("Use sampling='hybrid', which has all but what moves shapes and cameras" if sampling == "attached" else
                   "No sampling has what moves shapes and cameras; check_gradient measures how much that matters")
        return JumpWarning(f"{lacking}transmission by GGX facets ends with a jump, at which samples are lost. {instead}")

    def edges_slid_over(self, rendering: Rendering) -> SilhouetteWarning | None:
        """The warning about scattered directions that turn with a parameter, and so slide over edges; or None.

        Parameters that move silhouettes, too, are left out. It is looked for once for each parameter.
        """
        slid = slid_over(rendering)
        if slid.names.keys() <= self.sliding:
            return None
        self.sliding |= slid.names.keys()
        named = missing_silhouettes(rendering)
        names = {name: ideal for name, ideal in slid.names.items() if name not in named}
        if not names or flat(rendering.seen.vertices):
            return None
        instead = "" if all(names.values()) else (" With sampling='hybrid' those of surfaces that are neither ideal nor of "
                                                  "glass do not.")
        if slid.lamps and traces_from_lamps(rendering):
            instead += (f" Edges of lamps are not among them: paths that begin at these bring their light by way of ideal "
                        f"mirrors and glass (light_paths=\"{rendering.light_paths}\").")
        elif slid.lamps:
            instead += (" If most of it are edges of lamps, take light_paths=\"caustics\" and a smooth filter of the film, "
                        "such as gaussian: paths then begin at these and pass no such edge.")
        by = " by surfaces, not by the camera," if slid.seen_by_surfaces else ""
        return SilhouetteWarning(f"derivatives with respect to {listed(names)} lack the contribution of edges seen{by} by "
                                 f"reflection or refraction: scattered directions follow the parameter and slide over the "
                                 f"edges of shapes, where radiance is discontinuous.{instead} check_gradient measures how "
                                 f"much that matters")

    def edges_far_off(self, rendering: Rendering) -> SilhouetteWarning | None:
        """The warning that edges in view are so far from the origin that rays miss them, or None.

        For each parameter the things that it moves are examined once; for those of a camera, the whole scene.
        """
        cameras = {name for names in rendering.camera_movers for name in names}
        names = cameras.union(*rendering.movers)
        if not rendering.primary or names <= self.placed:
            return None
        self.placed |= names
        vertices, faces, counts = rendering.seen
        limit, far = FARTHEST[rendering.scene.dtype], {}
        for movers, own in zip(rendering.movers, faces.split(counts)):
            if movers and len(own):
                used = vertices.new_zeros(len(vertices), dtype=torch.bool)
                for some in own.flatten().split(AT_ONCE):
                    used.index_fill_(0, some.long(), True)
                far |= dict.fromkeys(movers, times_as_far(vertices if used.all() else vertices[used]))
        far |= dict.fromkeys(cameras, times_as_far(vertices))
        far = {name: times for name, times in far.items() if times > limit}
        if not far:
            return None
        return SilhouetteWarning(f"derivatives with respect to {listed(far)} have edges in view that lie up to "
                                 f"{max(far.values()):.0e} times as far from the origin as what they belong to is large: "
                                 f"float32, in which rays are cast whatever the scene's dtype, rounds positions so much "
                                 f"there that what edges contribute is inaccurate or missing. Move the scene to the origin, "
                                 f"cameras and lights included")


def traces_from_lamps(rendering: Rendering) -> bool:
    """True if some paths begin at lamps, because of light by way of mirrors and glass."""
    return rendering.light_paths in ("caustics", "all") or (
        rendering.light_paths == "auto" and rendering.call.can_follow_to_the_film and rendering.sampling != "attached")


def moving_names(rendering: Rendering) -> set[str]:
    """The names of the differentiated parameters that move shapes, lights or cameras."""
    names = {name for plugin in rendering.emitters for name in rendering.moving(plugin, MOVE_LIGHTS)}
    return names.union(*rendering.movers, *rendering.camera_movers)


def missing_silhouettes(rendering: Rendering) -> dict[str, int]:
    """The parameters that move silhouettes in view, with numbers of edges; empty if their term is on, or nothing moves."""
    moves = any(rendering.movers) or any(rendering.camera_movers)
    return silhouettes_left_out(rendering) if moves and not rendering.primary else {}


def times_as_far(vertices: Tensor) -> float:
    """The largest coordinate of vertices, (V, 3), relative to their extent."""
    low, high = vertices.aminmax(dim=0)
    return float(torch.maximum(low.abs(), high.abs()).max() / (high - low).max().clamp_min(torch.finfo(low.dtype).tiny))


def flat(vertices: Tensor) -> bool:
    """True if all vertices, (V, 3), lie in one plane, so that no ray between two of them is occluded."""
    centred = vertices.double() - vertices.double().mean(0)
    squared_extent = torch.linalg.eigvalsh(centred.T @ centred)
    return bool(squared_extent[0] <= FLAT**2 * squared_extent[-1])
