"""Images of AOVs: means over each pixel's samples, by the same camera rays as the image."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.aov import material, path, surface
from torch_radbp.aov.quantity import OF_PATHS, QUANTITIES, SQUARED, UNDIFFERENTIATED, plain
from torch_radbp.aov.surface import surface_values
from torch_radbp.call.render_call import RenderCall, camera_samples, integrand_of_wavefront, started
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.sorting import first_hit
from torch_radbp.path.state import PathState
from torch_radbp.public_call import public_call
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.differentiated import detached, differentiable, with_derivative_of
from torch_radbp.tensors.lookup import summed
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Vec3


def beside_image(names: tuple[str, ...]) -> Callable[[Integrand, PathState, Hit | None, Vec3], list[Tensor]]:
    """A function, for `RenderCall.quantities`, that computes the channels of AOVs of an image's camera paths."""
    def values(integrand: Integrand, start: PathState, hit: Hit | None, L: Vec3) -> list[Tensor]:
        return channels_of(names, lane_values(integrand, start, tuple(dict.fromkeys(map(plain, names))), hit, L))

    return values


def render_aovs(call: RenderCall, names: tuple[str, ...], channels: Tensor | None = None) -> dict[str, Tensor]:
    """Renders AOVs: (B, C, H, W) images, by name.

    Attached to scene and cameras, in forward and backward mode; derivatives have samples of their own unless `call` shares
    them.

    Args:
        call: the rendering, prepared for AOVs.
        names: of the AOVs.
        channels: the AOVs that the call has rendered beside its image; None: it has rendered no image.
    """
    images = by_name(names, channels) if channels is not None else quantities_of(call.still(), names)
    record = call.scene, call.source.tensors
    moving = tuple(name for name in names if plain(name) not in UNDIFFERENTIATED)
    if not moving or not (has_tangents(record) or (torch.is_grad_enabled() and differentiable(record))):
        return images
    attached = quantities_of(call.of_derivative(), moving, attached=True)
    return images | {name: with_derivative_of(images[name], image) for name, image in attached.items()}


def quantities_of(call: RenderCall, names: tuple[str, ...], attached: bool = False) -> dict[str, Tensor]:
    """Renders AOVs by the camera samples of a call: (B, C, H, W) images, by name.

    Only pixel sums are kept. Where these are attached, AOVs are computed again in the backward pass, so that one wavefront
    (batch of paths) bounds the memory.
    """
    if attached:
        call = call._replace(stages=EAGER)
    integrand = call.make_integrand(call.scene).with_stages(call.stages)
    quantities = tuple(dict.fromkeys(map(plain, names)))

    @public_call
    def sums(wavefront: Wavefront) -> tuple[list[Tensor], None]:
        samples, seen = camera_samples(call, wavefront, 0), integrand_of_wavefront(call, integrand, wavefront)
        start, weight = started(call, samples), samples.weight
        channels = channels_of(names, lane_values(seen, start, quantities))
        return call.sink.deposit(
            call, wavefront, channels if weight is None else [channel * weight for channel in channels], samples), None

    def sums_kept(wavefront: Wavefront) -> tuple[list[Tensor], None]:
        return checkpoint(sums, wavefront, use_reentrant=False, preserve_rng_state=False) if attached else sums(wavefront)

    return by_name(names, call.sink.gather(call, sums_kept).values)


def by_name(names: tuple[str, ...], channels: Tensor) -> dict[str, Tensor]:
    """Splits (B, C, H, W) channels of all AOVs to images by name."""
    counts = [len(QUANTITIES[plain(name)]) for name in names]
    return {name: image.clone(memory_format=torch.contiguous_format)  # no view, which could not be changed in place
            for name, image in zip(names, channels.split(counts, 1))}


def channels_of(names: tuple[str, ...], values: dict[str, surface.Values]) -> list[Tensor]:
    """Lists the channels of AOVs, one after the other, from the values of their quantities."""
    return [channel for name in names for channel in moments(name, values[plain(name)])]


def moments(name: str, values: surface.Values) -> surface.Values:
    """The values of an AOV, squared if its name has the prefix of second moments."""
    return tuple(value * value for value in values) if name.startswith(SQUARED) else values


def lane_values(integrand: Integrand, start: PathState, names: tuple[str, ...], hit: Hit | None = None,
                L: Vec3 | None = None) -> dict[str, surface.Values]:
    """AOVs of camera paths by name, (N,) for each channel; attached but for those of whole paths.

    Args:
        integrand: of the image.
        start: (N,) camera paths.
        names: of the AOVs.
        hit: the first hits of the camera rays in the image, if already computed.
        L: the radiance along the camera rays, if already computed.
    """
    fixed, fixed_start = integrand.still(), detached(start)
    quantities = {}
    with torch.no_grad():
        hit = first_hit(fixed, fixed_start.ray, 0) if hit is None else hit
        for name in names:
            if name in OF_PATHS:
                quantities[name] = path.FUNCTIONS[name](fixed, fixed_start, hit, L)
        if fixed.settings.hide_emitters:  # as in Mitsuba they are hidden in the image alone
            hit = first_hit(fixed._replace(settings=fixed.settings._replace(hide_emitters=False)), fixed_start.ray, 0)
    geometric = tuple(name for name in names if name in surface.FUNCTIONS)
    moving = integrand.settings.moving
    if geometric:
        scene = summed(surface.without_materials(integrand.scene))
        quantities.update(zip(geometric, integrand.stages(surface_values)(scene, start.ray, hit, geometric, moving)))
    material_names = tuple(name for name in names if name == "albedo" or (
        name == "sh_normal" and material.turns_normals(integrand.scene)))
    if material_names:
        quantities.update(zip(material_names, material.material_values(integrand, start, hit, material_names,
                                                                       quantities.get("sh_normal"))))
    return quantities
