"""Which lights' shadow borders each boundary term of shadows samples."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.terms.call_traits import films_have_area, follows_mirrors
from torch_radbp.call.render_call import RenderCall
from torch_radbp.interface.emitter import LightKind
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import detached


class Lights(NamedTuple):
    """A selection of kinds of lights, for which a boundary term samples shadow borders."""

    sharp: bool  # lights without extent
    soft: bool  # area lights
    around: bool  # the environment

    @staticmethod
    def covered(call: RenderCall) -> Lights:
        """The lights whose shadow borders on surfaces that the camera sees are sampled (by `DirectShadows`); none if pixels
        have no area.
        """
        if not films_have_area(call):
            return Lights(False, False, False)
        lights = Lights.sampled_whole(call)
        # Where rays pass boundaries of media others are seen by all vertices alike.
        return lights._replace(soft=False, around=False) if call.scene.layout.traces_segments else lights

    @staticmethod
    def bounced(call: RenderCall) -> Lights:
        """The lights whose shadow borders are sampled (by `BouncedShadows`) at random path vertices after the first.

        For environments, and for lamps behind boundaries of media, edges are better sampled from path vertices.
        """
        lights = Lights.sampled_whole(call) if call.integrand.max_depth > 2 else Lights(False, False, False)
        soft = lights.sharp and lights.soft and not call.scene.layout.traces_segments
        return Lights(lights.sharp, soft, False)

    @staticmethod
    def mirrored(call: RenderCall) -> Lights:
        """The lights whose shadow borders, seen by way of ideal vertices, `reflections.py` finds by scans of the film.

        Area lights only by way of one coat, which few paths sample, each with a large contribution. What mirrors and glass
        show is seen by all paths, and found from path vertices with less noise.
        """
        lights, layout = Lights.sampled_whole(call), call.scene.layout
        if call.integrand.max_depth < 3 or not follows_mirrors(call) or layout.traces_segments:
            return Lights(False, False, False)
        settings, in_media = call.integrand.settings, layout.scattering_media or layout.emitting_media
        coats = all(look.kind.smooth for look in layout.appearances if look.kind.delta)
        glued = settings.sampling == "hybrid" and not settings.following
        return Lights(lights.sharp, lights.sharp and lights.soft and coats and glued and not in_media, False)

    @staticmethod
    def with_shafts(call: RenderCall) -> Lights:
        """The lights whose shafts in media, borders of shadow there, are sampled; only sharp ones if pixels have no area."""
        lights = Lights.sampled_whole(call)
        return lights if films_have_area(call) else lights._replace(soft=False, around=False)

    @staticmethod
    def sampled_whole(call: RenderCall) -> Lights:
        """The lights all of whose light is found by light samples."""
        emitters, lights, layout = call.module.emitters, call.scene.lights, call.scene.layout
        surfaces, around = (all(emitter.sampled_whole() for emitter in emitters if emitter.kind().surround == around)
                            for around in (False, True))
        if layout.surround is not None:
            number, kind = layout.surround
            around = around and not kind.even(detached(lights.tables[number]))
        return Lights(call.integrand.settings.nee, surfaces, around or layout.surround is None)

    @staticmethod
    def uncovered(call: RenderCall) -> Lights:
        """The lights of some extent whose shadow borders are not sampled on surfaces that the camera sees."""
        covered = Lights.covered(call)
        return Lights(False, not covered.soft, not covered.around)

    def covers(self, kind: LightKind) -> bool:
        """True if a kind of light is selected."""
        return self.sharp if kind.delta else self.around if kind.surround else self.soft

    def of(self, scene: SceneTensors) -> Tensor:
        """For each kind of light in a scene, whether it is selected; bool."""
        return torch.tensor([self.covers(kind) for kind in scene.layout.lights], device=scene.device)


SOFT = Lights(False, True, True)
