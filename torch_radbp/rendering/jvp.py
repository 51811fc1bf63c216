"""`jvp`: the derivative image along a direction in the space of parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, overload

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.func import functional_call
from typing_extensions import Unpack

from torch_radbp.plugin import finite
from torch_radbp.public_call import passing_on, public_call
from torch_radbp.rendering.radiance import RadianceOf
from torch_radbp.rendering.renderer import Renderer
from torch_radbp.rendering.settings import RendererSettings, SensorChoice
from torch_radbp.rendering.shots import WindowChoice
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.tensors.torch_internals import tree_map


@overload
def jvp(scene: Scene, tangents: Mapping[str, Tensor], *, spp: int | None = None, seed: int = 0, sensors: SensorChoice = None,
        aovs: None = None, window: WindowChoice = None, rays: tuple[Tensor, Tensor] | None = None,
        **settings: Unpack[RendererSettings]) -> Tensor: ...


@overload
def jvp(scene: Scene, tangents: Mapping[str, Tensor], *, spp: int | None = None, seed: int = 0, sensors: SensorChoice = None,
        aovs: Sequence[str], window: WindowChoice = None,
        **settings: Unpack[RendererSettings]) -> tuple[Tensor, dict[str, Tensor]]: ...


@overload
def jvp(scene: Scene, tangents: Mapping[str, Tensor], *, spp: int | None = None, seed: int = 0, sensors: SensorChoice = None,
        aovs: Sequence[str] | None, window: WindowChoice = None,
        **settings: Unpack[RendererSettings]) -> Tensor | tuple[Tensor, dict[str, Tensor]]: ...


@public_call
@passing_on(RendererSettings.__annotations__, Renderer.__init__)
def jvp(scene: Scene, tangents: Mapping[str, Tensor], *, spp: int | None = None, seed: int = 0, sensors: SensorChoice = None,
        aovs: Sequence[str] | None = None, window: WindowChoice = None, rays: tuple[Tensor, Tensor] | None = None,
        **settings: Unpack[RendererSettings]) -> Tensor | tuple[Tensor, dict[str, Tensor]]:
    """The derivative of the image along `tangents`, a direction in the space of parameters; by forward mode.

    It gives the derivative of every pixel along one direction, for about the cost of two renderings; the backward pass gives
    the derivative of one number with respect to every parameter. With the same seed they are transposes of each other: for
    any image w, <w, jvp(tangents)> is the sum over parameters of <tangent, gradient of <w, image>>.

    `torch.func.jvp` and dual tensors of `torch.autograd.forward_ad` work through `torch.func.functional_call(renderer, ...)`
    too, with the same result; the other transforms of `torch.func` raise. In a loop that is faster: one renderer keeps what
    has not changed since its last call.

    Args:
        scene: left as it is; no parameter needs `requires_grad`.
        tangents: by the names of `scene.get_parameter`; each of its parameter's shape, any floating dtype.
        spp, **settings: of `Renderer`: `max_depth`, `nee`, ... `adjoint` has no effect here.
        seed: of the random numbers, as in `Renderer`.
        sensors: index or name of the sensor to render, or several of them; None: all.
        aovs: names of quantities whose derivatives to return beside that of the image; see `Renderer.aovs`.
        window: the part of the image to render; see `Renderer.forward`.
        rays: origins and directions, (N, 3) each, to take the derivative of `Renderer.radiance` along them, in the place of
            images; then `sensors`, `aovs` and `window` must be left out.

    Returns:
        (B, 3, H, W), detached, linear RGB per unit of `tangents`; if `aovs` are asked for, that and the derivatives of these
        quantities by name. Along rays (N, 3).

    Raises:
        AttributeError: if the scene has no such parameter; the message lists the nearest names.
        ValueError: if a tangent has another shape than its parameter or is not finite, or the parameter has no derivative.
        TypeError: if `tangents` is no mapping.

    Reference: Griewank and Walther 2008, "Evaluating Derivatives", chapter 3.
    """
    renderer = Renderer(scene, spp, **settings)
    tangents = checked_tangents(scene, tangents)
    of_images = {"sensors": sensors, "aovs": aovs, "window": window}
    if rays is not None:
        if any(value is not None for value in of_images.values()):
            raise ValueError(f"along rays there are no sensors, windows and aovs, got {of_images}: leave them out")
        return render_with_tangents(renderer, tangents, {"origins": rays[0], "directions": rays[1], "seed": seed}).tangent
    found = render_with_tangents(renderer, tangents, {"seed": seed, **of_images})
    if aovs is None:
        return found.tangent
    image, quantities = found
    return image.tangent, {name: quantity.tangent for name, quantity in quantities.items()}


class DualImage(NamedTuple):
    """A rendering and its derivative, (B, 3, H, W) each, detached."""

    image: Tensor
    tangent: Tensor


def checked_tangents(scene: Scene, tangents: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Checks tangents, and converts them to the dtype and device of their parameters; raises as `jvp` says."""
    if not isinstance(tangents, Mapping):
        raise TypeError(f"tangents must map names of parameters to tensors, got {type(tangents).__name__}; "
                        f"for instance {{\"white.reflectance.value\": torch.ones(3)}}")
    if not tangents:
        raise ValueError("tangents must name at least one parameter, got none")
    checked = {}
    for name, tangent in tangents.items():
        parameter = scene.get_parameter(name)
        tangent = tangent.detach() if isinstance(tangent, Tensor) else tangent
        checked[name] = finite(f"the tangent of {name!r}", tangent, tuple(parameter.shape)).to(parameter)
    return checked


def rendering_with_tangent(renderer: Renderer, tangents: Mapping[str, Tensor], seed: int,
                           sensors: SensorChoice = None, spp: int | None = None) -> DualImage:
    """A rendering and its derivative along `tangents`, as `checked_tangents` returns them."""
    return render_with_tangents(renderer, tangents, {"seed": seed, "sensors": sensors, "spp": spp})


def render_with_tangents(renderer: Renderer, tangents: Mapping[str, Tensor], arguments: dict):
    """Calls the renderer on dual numbers: each image with its derivative along `tangents`; or, given rays, `radiance`."""
    module, scene = (RadianceOf(renderer), "renderer.scene") if "origins" in arguments else (renderer, "scene")

    def unpacked(image: Tensor) -> DualImage:
        image, tangent = forward_ad.unpack_dual(image)
        return DualImage(image.detach(), torch.zeros_like(image) if tangent is None else tangent.detach())

    with torch.no_grad(), forward_ad.dual_level():
        parameters = {f"{scene}.{name}": parameter.detach() for name, parameter in renderer.scene.named_parameters()}
        for name, tangent in tangents.items():
            parameters[f"{scene}.{name}"] = forward_ad.make_dual(parameters[f"{scene}.{name}"], tangent)
        return tree_map(unpacked, functional_call(module, parameters, kwargs=arguments))
