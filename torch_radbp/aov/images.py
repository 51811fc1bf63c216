"""Images of quantities: the mean over the samples of each pixel, by the very camera rays of the image."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.aov import material, path, surface
from torch_radbp.aov.quantity import OF_PATHS, QUANTITIES, SQUARED, TURNING, UNDIFFERENTIATED, plain
from torch_radbp.boundary.outline import Jumps
from torch_radbp.boundary.primary import Seen, jumps_of_views
from torch_radbp.differentiated import detached, differentiable, with_derivative_of
from torch_radbp.lookup import summed
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import first_hit
from torch_radbp.public_call import public_call
from torch_radbp.raycast.protocol import Hit
from torch_radbp.rendering.call.chunks import Chunk
from torch_radbp.rendering.call.pixels import deposit, developed
from torch_radbp.rendering.call.render_call import RenderCall, camera_samples, integrand_of, started
from torch_radbp.scene.tensors import SceneTensors


def render_aovs(call: RenderCall, names: tuple[str, ...]) -> dict[str, Tensor]:
    """(B, C, H, W) images of quantities, by name.

    Attached to scene and cameras, in either mode; the derivative has samples of its own, unless the call shares them.
    """
    record = call.scene, [view.camera for view in call.views]
    if not (has_tangents(record) or (torch.is_grad_enabled() and differentiable(record))):
        return quantities_of(call.still(), names)
    if call.shares_samples:
        return quantities_of(call, names, attached=True)
    images = quantities_of(call.still(), names)
    moving = tuple(name for name in names if plain(name) not in UNDIFFERENTIATED)
    attached = quantities_of(call.of_derivative(), moving, attached=True) if moving else {}
    return images | {name: with_derivative_of(images[name], image) for name, image in attached.items()}


def quantities_of(call: RenderCall, names: tuple[str, ...], attached: bool = False) -> dict[str, Tensor]:
    """The images of quantities by the samples of a call.

    Of a chunk only its sums are kept. Where they are attached, quantities are computed again in the backward pass, so that
    the chunk bounds the memory.
    """
    if attached:
        call = call._replace(stages=call.stages.eager())
    integrand = call.make_integrand(call.scene).with_stages(call.stages)
    quantities = tuple(dict.fromkeys(map(plain, names)))

    @public_call
    def sums(chunk: Chunk) -> tuple[Tensor, None]:
        samples = camera_samples(call, chunk, call.views[chunk.sensor].sample_keys[0])
        start, weight = started(call, samples), samples.weight
        values = lane_values(integrand_of(call, integrand, chunk), start, quantities)
        channels = [channel for name in names for channel in moments(name, values[plain(name)])]
        return deposit(call, chunk, channels if weight is None else [channel * weight for channel in channels],
                       samples.place), None

    def sums_kept(chunk: Chunk) -> tuple[Tensor, None]:
        return checkpoint(sums, chunk, use_reentrant=False, preserve_rng_state=False) if attached else sums(chunk)

    images = developed(call, sums_kept).pixels
    counts = [len(QUANTITIES[plain(name)]) for name in names]
    return dict(zip(names, (image.contiguous() for image in images.split(counts, 1))))


def aov_jumps(call: RenderCall, jumps: list[Jumps], names: tuple[str, ...]) -> dict[str, Tensor]:
    """By name, zeros whose derivative is what the edges of surfaces contribute to images of quantities; see `image_jumps`.

    Args:
        call: of which something moves.
        jumps: of each view.
        names: of quantities; those that have no derivative are left out.
    """
    names = tuple(name for name in names if plain(name) not in UNDIFFERENTIATED)

    def values(integrand: Integrand, start: PathState, hit: Hit) -> tuple[Tensor, ...]:
        found = lane_values(integrand, start, tuple(dict.fromkeys(map(plain, group))), hit)
        return tuple(channel for name in group for channel in moments(name, found[plain(name)]))

    found: dict[str, Tensor] = {}
    for of_paths in (False, True):
        group = tuple(name for name in names if (plain(name) in OF_PATHS) == of_paths)
        counts = [len(QUANTITIES[plain(name)]) for name in group]
        if group:
            seen = call if of_paths else call._replace(make_integrand=partial(with_emitters, call.make_integrand))
            turns = tuple(plain(name) in TURNING for name, count in zip(group, counts) for _ in range(count))
            found |= zip(group, jumps_of_views(seen, jumps, Seen(turns, values)).split(counts, 1))
    return found


def with_emitters(make_integrand: Callable[[SceneTensors], Integrand], scene: SceneTensors) -> Integrand:
    """The integrand of a scene in which nothing is hidden."""
    integrand = make_integrand(scene)
    return integrand._replace(settings=integrand.settings._replace(hide_emitters=False))


def moments(name: str, values: surface.Values) -> surface.Values:
    """The values of a quantity, or of one whose name asks for it their squares."""
    return tuple(value * value for value in values) if name.startswith(SQUARED) else values


def lane_values(integrand: Integrand, start: PathState, names: tuple[str, ...],
                hit: Hit | None = None) -> dict[str, surface.Values]:
    """Quantities of camera paths by name, (N,) for each channel; attached but for those of whole paths.

    Args:
        hit: of the camera rays, if it is known; hidden emitters are hit.
    """
    fixed, fixed_start = integrand._replace(scene=integrand.proposal, parts={}), detached(start)
    found = {}
    with torch.no_grad():
        # As in Mitsuba, what hides emitters hides them in the image alone.
        seen = fixed._replace(settings=fixed.settings._replace(hide_emitters=False))
        hit = first_hit(seen, fixed_start.ray, 0) if hit is None else hit
        for name in names:
            if name in OF_PATHS:
                found[name] = path.FUNCTIONS[name](fixed, fixed_start)
    geometric = tuple(name for name in names if name in surface.FUNCTIONS)
    moving = integrand.settings.moving
    if geometric:
        scene = summed(surface.without_materials(integrand.scene))
        found.update(zip(geometric, integrand.stages.surface_values(scene, start.ray, hit, geometric, moving)))
    material_names = tuple(name for name in names if name == "albedo" or (
        name == "sh_normal" and material.turns_normals(integrand.scene)))
    if material_names:
        found.update(zip(material_names, material.material_values(integrand, start, hit, material_names,
                                                                   found.get("sh_normal"))))
    return found
