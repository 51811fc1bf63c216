"""One call of a renderer: all that is needed to trace its paths, and the camera rays of its chunks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

from torch import Tensor

from torch_radbp.call.sink import Sink
from torch_radbp.call.source import Cameras, PathSource
from torch_radbp.call.view import View
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.jit.recording.repetitions import LearntRepetitions
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState, start_path
from torch_radbp.raycast import RayCaster
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.cache.common_work import Facts
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.stage import Stages
from torch_radbp.tensors.vec import Vec3
from torch_radbp.threads.workers import by_number, in_turns
from torch_radbp.threads.zeroed_memory import ZeroedMemory

Result = TypeVar("Result")


class RenderCall(NamedTuple):
    """One rendering: everything that tracing and differentiating its paths needs beside the scene's tensors."""

    scene: SceneTensors
    caster: RayCaster | None  # of its triangles; None, as the next field, while the integrand is made
    make_integrand: Callable[[SceneTensors], Integrand] | None
    integrand: Integrand | None  # of the detached scene, made once for all that is traced
    stages: Stages
    adjoint: object  # the strategy
    source: PathSource  # where paths begin
    sink: Sink[RenderCall]  # where their radiance goes
    wavefronts: list[Wavefront]
    spp: int
    shares_samples: bool  # the backward pass differentiates the samples of the image itself
    record_bytes: float  # bytes of path records that are kept for it at most; other paths are traced again
    together: bool  # the derivative's own samples are traced together with those of the image, in half as many calls
    workers: int  # number of threads that trace wavefronts
    memory: ZeroedMemory  # for the totals of gradients
    repetitions: LearntRepetitions  # in sequences of launches
    following: bool = False  # see `Settings.following`
    module: Scene | None = None  # the scene's module; gives names to errors
    parameters: dict[str, Tensor] = {}  # parameters that require a gradient, by name
    # What of camera paths is shown beside the image, C of (N,), detached: of the integrand, the paths, what their rays meet
    # (None: not known), and their radiance.
    quantities: Callable[[Integrand, PathState, Hit | None, Vec3], Sequence[Tensor]] | None = None
    shared: bool = False  # light is shared among paths that begin at the camera and at lamps: see `Settings.light_paths`
    # The same call with the light of paths from the camera alone, where all other light comes by paths from lamps, and is
    # fixed to the surfaces that it lights, not to pixels; for boundary terms. None: it does not.
    camera_share: RenderCall | None = None

    def still(self) -> RenderCall:
        """The same call without derivatives."""
        return self._replace(scene=self.still_scene, source=self.source.still())

    def facts(self) -> Facts:
        """All that the call's images and the places of their discontinuities depend on, without derivatives, as a key under
        which other renderings find work that they have in common."""
        still, integrand = self.still(), self.integrand
        return Facts.of((still.scene, still.views, integrand.settings, integrand.max_depth, integrand.rr_depth, self.spp,
                         self.shares_samples, self.shared, self.following))

    @property
    def views(self) -> list[View]:
        """The views at whose cameras paths begin."""
        return self.source.views

    @property
    def can_begin_at_lamps(self) -> bool:
        """True if paths can begin at all lamps and be connected to all cameras."""
        return not self.scene.layout.lit and all(view.camera.kind.sees_points for view in self.views)

    @property
    def can_follow_to_the_film(self) -> bool:
        """True if paths from lamps also have derivatives by their positions on the films, which box filters do not have."""
        return self.can_begin_at_lamps and not any(view.camera.film.kernel.flat for view in self.views)

    def with_views(self, views: list[View]) -> RenderCall:
        """The same call for other views."""
        return self._replace(source=Cameras(views))

    @property
    def still_scene(self) -> SceneTensors:
        """The scene without derivatives."""
        return detached(self.scene) if self.integrand is None else self.integrand.scene

    def of_derivative(self) -> RenderCall:
        """The call that renders the image from the samples by which its derivative is estimated."""
        make = self.make_integrand if self.shares_samples else lambda scene: self.make_integrand(scene).for_derivatives()
        return self._replace(source=self.source.of_derivative(), make_integrand=make)


def started(call: RenderCall, sample: CameraSample) -> PathState:
    """The path states at the start of some rays."""
    layout = call.scene.layout
    medium = (-1 if layout.around is None else layout.around) if layout.traces_segments else None
    return start_path(sample, call.scene.lights.by_place, call.following, medium, call.shared)


def start_paths(call: RenderCall, wavefront: Wavefront, which: int) -> PathState:
    """The initial states of a wavefront's paths; `which`: 0 for those of the image, 1 for those of its derivative."""
    return started(call, camera_samples(call, wavefront, which))


def camera_samples(call: RenderCall, wavefront: Wavefront, which: int) -> CameraSample:
    """The first rays of a wavefront's lanes, with the keys of their random numbers; `which` as for `start_paths`."""
    return joined(samples_of_chunks(call, wavefront, which))


def samples_of_chunks(call: RenderCall, wavefront: Wavefront, which: int) -> list[CameraSample]:
    """The first rays of a wavefront's lanes, chunk by chunk; args as for `camera_samples`."""
    return [call.source.samples(chunk, which, call.stages, call.scene.layout.traces_cones) for chunk in wavefront.chunks]


def pilot_paths(call: RenderCall, lanes: int) -> PathState:
    """The initial states of a few paths from all over the source, as the first image, by which memory is predicted."""
    return started(call, call.source.pilots(lanes, call.stages, call.scene.layout.traces_cones))


def integrand_of(call: RenderCall, integrand: Integrand, number: int) -> Integrand:
    """The integrand for the camera of view `number`, with its far plane."""
    view = call.views[number]
    return integrand._replace(clipping=view.camera if view.clips else None)


def integrand_of_wavefront(call: RenderCall, integrand: Integrand, wavefront: Wavefront, which: int = 0) -> Integrand:
    """The integrand for the lanes of a wavefront; where a far plane cuts the scene all have the same camera.

    Args:
        which: 0 for samples of the image, 1 for those of its derivative, which may be the same.
    """
    integrand = integrand.for_derivatives() if which and not call.shares_samples else integrand
    return integrand._replace(clipping=call.source.clipping(wavefront.chunks[0]))


def of_wavefronts(call: RenderCall, wavefronts: list[Wavefront], work: Callable[[Wavefront], Result]) -> list[Result]:
    """Runs `work` on wavefronts in several threads; returns the results in order."""
    return by_number(in_turns(len(wavefronts), call.workers, lambda share: [work(wavefronts[index]) for index in share]))
