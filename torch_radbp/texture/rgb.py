"""A constant colour."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torch_radbp.plugin import Emitter, Plugin, Texture, finite, no_module, register, with_article
from torch_radbp.plugin.domain import Domain
from torch_radbp.texture.colour import Colour
from torch_radbp.texture.neural import NeuralTexture
from torch_radbp.texture.spectrum import Samples, Spectrum, role_of


@register("texture", "rgb")
class RGB(Colour):
    """A constant linear RGB value.

    Parameters: `value`, (3,) or () for grey. Derivatives: with respect to `value`.

    Args:
        value: linear RGB, or one number for grey.

    Raises:
        ValueError: if `value` is neither one nor three finite numbers.
    """

    entries = "value"

    def __init__(self, *, value: Tensor):
        super().__init__()
        value = finite("value", value).to(torch.get_default_dtype())
        if value.shape not in ((), (3,)):
            value = value.squeeze()
        if value.shape not in ((), (3,)):
            raise ValueError(f"value must be one number or three (linear RGB), got shape {tuple(value.shape)}")
        self.freeze("value", value)

    def domains(self) -> dict[str, Domain]:
        return {"value": Domain(shapes=((), (3,)))}

    def colour(self) -> Tensor:
        """The parameter `value`, attached."""
        return self.value


def on_lights(texture: Texture) -> bool:
    """True if emitters can be given a texture, and all textures that it is made of."""
    return texture.on_lights and all(map(on_lights, texture.parts()))


def as_texture(owner: Plugin, name: str, value: Texture | nn.Module | Samples | Tensor | float) -> Texture:
    """Makes the texture for the attribute `name` of a plugin, from a texture, a module, a spectrum, one number or three.

    Raises:
        TypeError: if the value is of another type, or a module where only tables can stand; or if the owner's `domains`
            lack it.
        ValueError: if a texel is not in the attribute's domain, or a spectrum cannot stand here.
    """
    if isinstance(value, (str, bytes, dict)):
        raise TypeError(f"{name} must be a number, three numbers or a texture, got {value!r}")
    if isinstance(value, nn.Module) and not isinstance(value, Texture):
        value = NeuralTexture(value)
    domain = owner.domains().get(name)
    if domain is None:
        raise TypeError(f"domains() of {with_article(owner.type or type(owner).__name__)} must say which values {name!r} "
                        f"may have, got {sorted(owner.domains())}: add {name!r} with a torch_radbp.plugin.domain.Domain")
    if isinstance(value, Samples):
        value = value.check().colour(role_of(owner, domain))
    texture = value if isinstance(value, Texture) else RGB(value=value)
    if isinstance(texture, Spectrum):
        texture.assign(role_of(owner, domain))
    if isinstance(owner, Emitter) and not on_lights(texture):
        raise ValueError(f"{name} of {with_article(owner.type)} must not vary in space, got a {texture.type}")
    if texture.tabulated:
        filename = getattr(texture, "filename", None)
        texture.check(name if filename is None else f"{name}, read from {filename},", domain)
    elif not owner.takes_modules:
        raise no_module(owner, name, texture)
    return texture
