"""`Renderer`: the public entry. Packs the scene, plans chunks, calls the tracer."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from math import inf
from types import MappingProxyType
from typing import TYPE_CHECKING, overload

import torch
from torch import Tensor, nn
from torch.func import functional_call

from torch_radbp.adjoint import AdjointStrategy, MemoizedAdjoint
from torch_radbp.adjoint.forward_mode import inside_transforms, render_outside_transforms
from torch_radbp.aov.images import beside_image
from torch_radbp.aov.quantity import checked_names
from torch_radbp.boundary.curve.rendering import rendering_of
from torch_radbp.boundary.terms.jump_watch import JumpWatch
from torch_radbp.boundary.terms.of_call import EdgesOfCall, edges_of_call
from torch_radbp.call.pixels import Films
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.source import Cameras
from torch_radbp.call.view import OF_NO_SENSOR, Shot, view_of
from torch_radbp.jit.recording.repetitions import LearntRepetitions
from torch_radbp.jit.stages import compiled
from torch_radbp.jit.target import COMPILED
from torch_radbp.path.integrand import Integrand
from torch_radbp.public_call import public_call
from torch_radbp.raycast import RayCaster
from torch_radbp.raycast.kept_caster import KeptCaster
from torch_radbp.rendering.cast_triangles import cast_triangles
from torch_radbp.rendering.cost import Request, bytes_of_records
from torch_radbp.rendering.lanes import plan_lanes, wavefronts_of
from torch_radbp.rendering.light_paths import calls_traced, shared_image
from torch_radbp.rendering.memory import MemoryPlan
from torch_radbp.rendering.noise_watch import NoiseWatch
from torch_radbp.rendering.planner import MemoryPlanner
from torch_radbp.rendering.quantities import named_quantities
from torch_radbp.rendering.radiance import radiance_outside
from torch_radbp.rendering.settings import (
    INTERIOR,
    OF_DERIVATIVE,
    PRIMARY,
    SHADOW,
    TERMS,
    UNLIMITED,
    SensorChoice,
    check_settings,
    checked_scene,
    checked_seeds,
    refuse_tracing,
    samples_per_pixel,
    settings_of_integrand,
)
from torch_radbp.rendering.shots import WindowChoice, shots_of
from torch_radbp.rendering.zero_gradients import GradientWatch
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.modules.parameters import check_names
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.modules.wanted import wanted_parameters
from torch_radbp.scene.packing.geometry import PlacedShape
from torch_radbp.scene.packing.pack import PLACED, pack
from torch_radbp.scene.tables.scene_tensors import SceneTensors, proposal_of
from torch_radbp.sensor.rays import given_rays
from torch_radbp.tensors.asked_later import Presumptions
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.stage import EAGER
from torch_radbp.threads.team import threads
from torch_radbp.threads.zeroed_memory import ZeroedMemory


class Renderer(nn.Module):
    """A differentiable path tracer as a module.

    Args:
        scene: what is rendered; `renderer.scene` afterwards.
        spp: samples per pixel; None: what the sampler elements of the sensors that are rendered say.
        max_depth: 1 = emission only, 2 = direct light, -1 = unlimited; None: what the integrator element says.
        rr_depth: scattering events before Russian roulette; None likewise.
        hide_emitters: do not show emitters that the camera sees directly; None likewise.
        adjoint: how the backward pass works: `MemoizedAdjoint(stride)`, or another `AdjointStrategy`.
        sampling: which derivatives go through the choice of directions; all agree in expectation where they apply.
            "hybrid": directions, densities and weights carry no derivative, but those of ideal mirrors and glass do.
            "detached": those neither, so that what is seen in them does not follow their shape and index of refraction.
            "attached": all do: the derivative of the estimator itself, `d_Li` of the note. Noisier, and the one to take
            where a density becomes very narrow, as roughness near 0 does.
        nee: next-event estimation with multiple importance sampling; None: what the integrator element says.
        chunk: lanes (paths) traced together at most, but for a row of pixels with 8 samples; None picks.
        memory_budget: bytes, or a string such as "2GiB" or "2GB": picks chunk and, unless `adjoint` is given, the stride, so
            that the predicted peak fits. `renderer.memory_plan()` tells what was picked and predicted.
        compile: fuse the functions of a bounce into loops of vector instructions, once a process for each kind of material
            and dtype, in seconds. On the CPU, and on CUDA, where they are kernels of PTX; elsewhere, and with
            `TapeAdjoint`, rendering is eager all the same. False: the eager reference, in plain torch.
        caster: "embree", "direct", "warp" or "brute"; None picks by device and number of triangles.
        light_choice: how next-event estimation picks one of the emitters. "uniform": by their `sampling_weight`, the same
            everywhere, as Mitsuba. "tree": also by what they contribute to the point that is to be illuminated, by a tree of
            their bounds; what surrounds the scene, comes from far away or is a beam stands beside it. None: "tree" in scenes
            of many emitters, where it is less noisy on diffuse surfaces; on glossy ones compare it with "uniform".
        terms: of derivatives, which to compute: "interior", of radiance where the image is continuous; "primary", of the
            curves at which it jumps: silhouettes, creases, rims of smooth shading, lines of textures, surfaces that cross,
            seen directly or by way of ideal mirrors and glass; and "shadow", of the borders of shadows, direct and indirect,
            sharp and soft.
        share_samples: differentiate the very samples of the image, which saves a pass over the scene. By default the
            derivative has samples of its own, since noise that image and derivative share biases the gradient of every loss
            that is not linear in the image; not where two independent images take each other's part: `rb.losses`. Few
            samples of both are traced together, in the forward pass: an image whose derivative nobody will ask for is
            cheaper under `torch.no_grad()`. Of what the shared paths need, as much is kept until the backward pass as takes
            an eighth of the machine's memory; the rest is traced again.
        light_paths: which light is found by paths that begin at lamps, as many as from the camera, where the camera does not
            see it in mirrors or through glass. "camera": none; "caustics": what comes by way of a mirror or glass beside a
            lamp; "all"; "auto": "caustics" where a light without extent has some, and for derivatives that turn mirrors or
            glass in which surfaces see lamps, whose edges they lack otherwise. None: as the integrator element says.

    Derivatives, backward and forward (`jvp`), reach every parameter of the scene. Those of shapes, poses and cameras lack,
    so far, edges that surfaces, not the camera, see by reflection; a `SilhouetteWarning` says so, once, if edges may be slid
    over by directions that follow a parameter (with attached sampling roughness, index and normals; in hybrid those of ideal
    mirrors and glass). Without the terms of edges they lack what these contribute: it says so if silhouettes or shadows that
    move are in view. The samplings that are not attached miss a jump of GGX rough glass; a `JumpWarning` says so. No warning
    tells of edges that surfaces see move in mirrors that do not.

    Several threads may render with one renderer. Each call takes the parameters as it finds them, and its image keeps the
    geometry that it shows: what moves later changes neither it nor its derivatives. `torch.autocast` and torch's default
    dtype and device change nothing, and inside of `torch.compile` a rendering is an opaque call.

    Raises:
        ValueError: for settings that make no sense.
    """

    def __init__(self, scene: Scene, spp: int | None = None, max_depth: int | None = None, rr_depth: int | None = None,
                 hide_emitters: bool | None = None, adjoint: AdjointStrategy | None = None, sampling: str = "hybrid",
                 nee: bool | None = None, chunk: int | None = None, memory_budget: str | int | None = None,
                 compile: bool = True, caster: str | None = None, light_choice: str | None = None,
                 terms: Collection[str] = TERMS, share_samples: bool = False, light_paths: str | None = None):
        super().__init__()
        self.scene = checked_scene(scene)
        defaults = scene.integrator
        self.chosen_spp, self.chunk, self.memory_budget = spp, chunk, memory_budget
        self.max_depth = defaults.max_depth if max_depth is None else max_depth
        self.rr_depth = defaults.rr_depth if rr_depth is None else rr_depth
        self.hide_emitters = defaults.hide_emitters if hide_emitters is None else hide_emitters
        self.nee = defaults.nee if nee is None else nee
        self.sampling, self.compile_stages, self.caster_name = sampling, compile, caster
        self.light_choice, self.terms, self.share_samples = light_choice, terms, share_samples
        self.light_paths = defaults.light_paths if light_paths is None else light_paths
        self.adjoint, self.adjoint_is_chosen = adjoint or MemoizedAdjoint(), adjoint is not None
        self.casters, self.cache, self.cache_for_aovs = KeptCaster(), PackCache(), PackCache()
        self.jump_watch, self.gradient_watch, self.noise_watch = JumpWatch(), GradientWatch(), NoiseWatch()
        self.planner, self.memory, self.repetitions = MemoryPlanner(), ZeroedMemory(), LearntRepetitions()
        self.presumptions = Presumptions()
        check_settings(self)

    @property
    def spp(self) -> int:
        """Default samples per pixel of a call that renders all sensors."""
        return samples_per_pixel(self.chosen_spp, self.scene.sensors)

    @spp.setter
    def spp(self, value: int | None) -> None:
        self.chosen_spp = value

    def __getattr__(self, name: str):
        scene = self.__dict__.get("_modules", {}).get("scene")
        if scene is not None and name in scene._modules:
            raise AttributeError(f"a renderer has no attribute {name!r}, but its scene has, renderer.scene.{name}: names of "
                                 f"its parameters begin with 'scene.{name}.' in functional_call and in state dicts")
        return super().__getattr__(name)

    if TYPE_CHECKING:  # what nn.Module leaves open
        @overload  # type: ignore[no-overload-impl]
        def __call__(self, seed: int | None = None, sensors: SensorChoice = None, spp: int | None = None,
                     seed_grad: int | None = None, aovs: None = None, window: WindowChoice = None) -> Tensor: ...

        @overload
        def __call__(self, seed: int | None = None, sensors: SensorChoice = None, spp: int | None = None,
                     seed_grad: int | None = None, *, aovs: Sequence[str],
                     window: WindowChoice = None) -> tuple[Tensor, dict[str, Tensor]]: ...

    @public_call
    def forward(self, seed: int | None = None, sensors: SensorChoice = None, spp: int | None = None,
                seed_grad: int | None = None, aovs: Sequence[str] | None = None,
                window: WindowChoice = None) -> Tensor | tuple[Tensor, dict[str, Tensor]]:
        """Renders the scene.

        Args:
            seed: of the random numbers; the same seed gives the same image. None: 0. A loop gives another in each step, such
                as its number; a `RepeatedNoiseWarning` says so if it does not.
            sensors: index or name of the sensor to render, or several of them; None: all.
            spp: samples per pixel of this call; None: as the renderer says.
            seed_grad: of the samples of the derivative, backward or forward. None: one that follows from `seed`, or `seed`
                itself with `share_samples`; the same as `seed` shares samples in this call.
            aovs: names of quantities to return beside the image; see `aovs`.
            window: (x, y, width, height), pixels of the image that a call without it returns: only this part is rendered.
                Or a list of one for each sensor of the call, all of one size; to see several parts of one sensor's image,
                name it as often. Pixels keep their samples, and those beside the window that count there are traced, too:
                it is what one cuts out of the whole image, bit for bit if compiled, and so are derivatives inside of edges,
                up to the order of sums. Edges and shadows have other samples, in proportion to the window; those of shadows
                lie anywhere, so that their derivatives are noisier than in the whole image.

        Returns:
            (B, 3, H, W) linear RGB radiance, row 0 at the top, one image per sensor; if `aovs` are asked for, that and what
            the method `aovs` returns.

        Raises:
            ValueError: for a sensor that does not exist, or sensors of different size or sample count; for a window that is
                not inside of the image; for a parameter that is not in its domain; for more paths than can be traced, or
                more memory than there is.
            NonFiniteError: if the image, or in the backward pass a gradient, is NaN or infinite; a FloatingPointError that
                says of which parameter, at which bounce, on which material and on how many paths.
        """
        if inside_transforms():
            arguments = {"seed": seed, "sensors": sensors, "spp": spp, "seed_grad": seed_grad, "aovs": aovs,
                         "window": window}
            return render_outside_transforms(lambda parameters: functional_call(self, parameters, kwargs=arguments),
                                             dict(self.named_parameters()))
        return self.presumptions.tried(partial(self.rendered, seed, sensors, spp, seed_grad, aovs, window), self.forget)

    def rendered(self, seed: int | None, sensors: SensorChoice, spp: int | None, seed_grad: int | None,
                 aovs: Sequence[str] | None, window: WindowChoice) -> Tensor | tuple[Tensor, dict[str, Tensor]]:
        """Renders as `forward` says; it may presume flags that only the device knows, see `Presumptions`."""
        outputs = None if aovs is None else self.outputs(aovs)
        call = self.prepare(seed, sensors, spp, seed_grad, aovs is not None, window)
        self.noise_watch.look(seed, call.parameters)
        edges = self.look(call, checked_seeds(seed, seed_grad, self.share_samples)[1], aovs is not None)
        if outputs is not None:
            call = call._replace(quantities=beside_image(tuple(dict.fromkeys(outputs.values()))))
        (images, shared), channels = shared_image(self, call, edges), None
        if outputs is not None:
            channels, images = images[:, 3:].detach(), images[:, :3].clone(memory_format=torch.contiguous_format)
        images = self.gradient_watch.watched(edges.added_to(images, shared, INTERIOR in self.terms), call)
        return images if outputs is None else (images, named_quantities(self, call, edges, outputs, channels))

    def forget(self) -> None:
        """Drops the caches of tables packed for the last calls."""
        self.cache, self.cache_for_aovs = PackCache(), PackCache()

    @public_call
    def radiance(self, origins: Tensor, directions: Tensor, seed: int | None = None, spp: int | None = None,
                 seed_grad: int | None = None) -> Tensor:
        """The radiance that arrives along rays: for probes, panoramas, cameras of one's own, irradiance on surfaces.

        Each ray is a pixel of its own, without a filter; all else is as for images. Rays begin at their origins: one that
        leaves a surface must begin a little off it, as by 1e-4 of the scene's size, or it may meet that surface.

        Derivatives, backward and forward, reach origins, directions and the parameters of the scene: those of radiance along
        each ray, with soft shadows and indirect light. Left out are its jumps where an edge, or the border of a sharp shadow
        on the surface that it meets first, passes a ray, which has no area: means over rays lack what these contribute. A
        `SilhouetteWarning` says so if such move among the rays.

        Args:
            origins: (N, 3) world, attached.
            directions: (N, 3) world, of any length, attached across it.
            seed, seed_grad: as for a rendering.
            spp: paths along each ray; None: as the renderer, or what the samplers of all sensors of the scene say. Their
                samples are of low discrepancy.

        Returns:
            (N, 3) linear RGB radiance.

        Raises:
            TypeError: for rays that are no floating-point tensors.
            ValueError: for rays of another shape, none at all, numbers that are not finite, directions of length zero; and
                as a rendering.
            NonFiniteError: as a rendering.
        """
        if inside_transforms():
            return radiance_outside(self, {"origins": origins, "directions": directions}, seed, spp, seed_grad)
        rays = given_rays(origins, directions, self.scene.dtype, self.scene.device)
        call = self.prepared([Shot(rays, OF_NO_SENSOR, rays.film.window())], seed, self.spp if spp is None else spp,
                             seed_grad, beside={"origins": origins, "directions": directions})
        self.noise_watch.look(seed, call.parameters)
        edges = self.look(call, checked_seeds(seed, seed_grad, self.share_samples)[1])
        image = edges.added_to(shared_image(self, call, edges)[0], call, INTERIOR in self.terms)[0, :, :, 0].t()
        return self.gradient_watch.watched(image.clone(memory_format=torch.contiguous_format), call)

    @public_call
    def aovs(self, names: Sequence[str] | None = None, seed: int | None = None, sensors: SensorChoice = None,
             spp: int | None = None, seed_grad: int | None = None, window: WindowChoice = None) -> dict[str, Tensor]:
        """Arbitrary output variables: images of what the camera sees first, by the very camera rays of the image.

        Samples are weighted by the film's filter as those of the image are; where nothing is seen, all quantities are 0.
        Emitters are seen even where the image hides them, as in Mitsuba. Quantities, with their channels:

        `depth` (1): distance along the ray from the near plane. `position`, `geo_normal`, `sh_normal`, `dp_du`, `dp_dv` (3):
        world space; normals as the surface has them, also where it is seen from behind. `uv` (2): surface coordinates, 0 on
        meshes without any. `albedo` (3): linear RGB, diffuse reflectance of the material. `prim_index` (1): number of the
        triangle in its shape, 0 on shapes that Mitsuba does not tessellate; `shape_index` (1): of the shape in the scene,
        from 1. Curved shapes are as they are tessellated here.

        `alpha` (1): 1 where the image shows a surface or the surroundings, as Mitsuba's `path` has it; `hit` (1): where it
        shows a surface. `xyz` (3): the image in CIE XYZ. With m2_ before its name, any quantity's mean square over the
        samples of a pixel: with a box filter, var = (m2 - mean^2) / (spp - 1) is about the variance of a pixel whose samples
        are independent.

        Derivatives, backward and forward, are those with the pixel fixed, of everything but `xyz` and the indices; they
        reach shapes, poses, cameras and textures. `alpha` and `hit` change at edges alone, by shapes, poses and cameras.

        Args:
            names: of quantities; None: what the integrator element lists (`aov`, `moment`).
            seed, sensors, spp, seed_grad, window: as for a rendering; the derivative has samples of its own here, too.

        Returns:
            By name (B, C, H, W), row 0 at the top.

        Raises:
            ValueError: for a quantity that is not known, or if none is named.
        """
        outputs = self.outputs(names)
        call = self.prepare(seed, sensors, spp, seed_grad, aovs=True, window=window)
        edges = self.look(call, checked_seeds(seed, seed_grad, self.share_samples)[1], aovs=True)
        return named_quantities(self, call, edges, outputs)

    def outputs(self, names: Sequence[str] | None) -> dict[str, str]:
        """The quantities of the requested AOVs, by name; errors as for `aovs`."""
        found = self.scene.integrator.outputs() if names is None else {name: name for name in checked_names(names)}
        if not found:
            raise ValueError("the scene's integrator lists no outputs; name some, such as renderer.aovs([\"depth\"])")
        return found

    def look(self, call: RenderCall, seed: int, aovs: bool = False) -> EdgesOfCall:
        """Finds the edges at which a call's images are discontinuous, and warns of what derivatives or image lack."""
        rendering = rendering_of(call, self.scene, self.sampling, self.cache_for_aovs if aovs else self.cache,
                                 PRIMARY in self.terms, SHADOW in self.terms, self.depth_limit, self.light_paths)
        edges = edges_of_call(rendering, seed)
        self.jump_watch.look(rendering)  # casts rays, for which the tree of a large mesh may still be built
        return edges

    def prepare(self, seed: int | None, sensors: SensorChoice, spp: int | None, seed_grad: int | None,
                aovs: bool = False, window: WindowChoice = None) -> RenderCall:
        """Prepares a call that renders some sensors; `aovs`: with the columns that AOVs read."""
        return self.prepared(shots_of(self.scene, sensors, window), seed, spp, seed_grad, aovs)

    def prepared(self, shots: list[Shot], seed: int | None, spp: int | None, seed_grad: int | None,
                 aovs: bool = False, beside: Mapping[str, Tensor] = MappingProxyType({})) -> RenderCall:
        """Prepares a call for some images (sensors and windows): packs the scene, builds the ray caster, plans chunks."""
        check_settings(self)  # they may have been assigned since
        refuse_tracing()
        cache = PackCache(self.cache_for_aovs if aovs else self.cache)
        check_names(self, cache)
        named, seen, windows = self.scene.named_sensors, [shot.sensor for shot in shots], [shot.window for shot in shots]
        spp = samples_per_pixel(self.chosen_spp if spp is None else spp, seen)
        seeds = checked_seeds(seed, seed_grad, self.share_samples)
        device, fused, workers = self.scene.device, self.runs_compiled(), threads() if self.scene.device.type == "cpu" else 1
        parameters = wanted_parameters(self.scene, seen, cache, beside)
        record_bytes = bytes_of_records(device) if seeds[0] == seeds[1] else 0.0
        differentiating = parameters and torch.is_grad_enabled() and self.memory_budget is None
        scene = pack(self.scene, cache, self.light_choice, aovs, [name for name, sensor in named.items() if sensor in seen])
        plan = plan_lanes(windows, self.rr_depth, Request(
            len(shots), windows[0].columns.size, windows[0].rows.size, spp, self.chunk, self.depth_limit, self.scene.dtype,
            device, workers, self.adjoint if differentiating else None, record_bytes, fused,
            bool(scene.layout.media)))
        caster = self.caster_of(scene, cache.made(PLACED))
        views = [view_of(shot, seeds, seeds[0] ^ OF_DERIVATIVE == seeds[1], spp, scene, cache) for shot in shots]
        setattr(self, "cache_for_aovs" if aovs else "cache", cache.close())
        stages = compiled() if fused else EAGER
        settings = settings_of_integrand(self, scene, [view.camera for view in views])

        def make_integrand(tensors: SceneTensors) -> Integrand:
            made = Integrand(tensors, proposal_of(tensors), caster, settings, self.depth_limit, self.rr_depth, stages, {},
                             learnt=self.repetitions)
            return made.for_derivatives(of_image=True) if seeds[0] == seeds[1] else made

        integrand = make_integrand(detached(scene))
        call = RenderCall(scene, caster, make_integrand, integrand, stages, self.adjoint, Cameras(views), Films(),
                          wavefronts_of(views, plan, spp, workers), spp, seeds[0] == seeds[1], record_bytes, plan.together,
                          workers, self.memory, self.repetitions, settings.following, self.scene, parameters)
        if self.memory_budget is None:
            return call
        within = self.plan(call)
        wavefronts = wavefronts_of(views, plan.bounded(within.chunk), spp, workers)
        return call._replace(adjoint=within.adjoint, wavefronts=wavefronts, record_bytes=0.0 if within.retrace else inf)

    @property
    def depth_limit(self) -> int:
        """The greatest number of bounces of a path."""
        return UNLIMITED if self.max_depth == -1 else self.max_depth

    def runs_compiled(self) -> bool:
        """True if calls run compiled loops: on the CPU and CUDA, unless autograd must record operations."""
        return self.compile_stages and self.scene.device.type in COMPILED and not self.adjoint.taped

    @public_call
    def memory_plan(self, sensors: SensorChoice = None, spp: int | None = None, window: WindowChoice = None) -> MemoryPlan:
        """The chunk size and strategy that a call would use, and its predicted memory with the backward pass."""
        return self.plan(self.prepare(0, sensors, spp, None, window=window))

    def plan(self, call: RenderCall) -> MemoryPlan:
        """Plans chunk size and strategy of a call; within the memory budget, if there is one."""
        return self.planner.plan(call, calls_traced(self, call), self.memory_budget, self.adjoint_is_chosen, self.terms)

    def caster_of(self, scene: SceneTensors, placed: Sequence[PlacedShape] = ()) -> RayCaster:
        """The ray caster of a scene's triangles: that of the last call if they are the same, else a new one."""
        return self.casters.of(cast_triangles(scene.triangles, placed), self.caster_name)

    @property
    def last_caster(self) -> RayCaster | None:
        """The ray caster of the last call."""
        return None if self.casters.cached is None else self.casters.cached.caster
