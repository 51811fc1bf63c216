"""The mesh attributes that textures read: which mesh must have which, with what range of values."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from torch_radbp.plugin import Plugin, Shape, Texture, nearest
from torch_radbp.plugin.domain import LEEWAY, Domain
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.tensors.differentiated import differentiated
from torch_radbp.texture.bitmap import reader_of


def attributes_read(owner: Plugin) -> Iterator[tuple[str, Domain, Texture]]:
    """Yields the mesh attributes that a material's or emitter's textures read: name, domain of values, and texture."""
    for domain, texture in textures_of(owner):
        for leaf in _leaves(texture):
            yield from ((attribute, domain, leaf) for attribute in reader_of(leaf).attributes)


def textures_of(owner: Plugin) -> Iterator[tuple[Domain, Texture]]:
    """Yields the textures of a material (nested ones included) or an emitter, with the domains of their values."""
    for part in with_nested(owner):
        for name, domain in part.domains().items():
            texture = getattr(part, name, None)
            if isinstance(texture, Texture):
                yield domain, texture


def with_nested(owner: Plugin) -> Iterator[Plugin]:
    """Yields a material or an emitter, and the materials nested in it."""
    yield owner
    for child in (*owner._modules.values(), *owner.shared.values()):
        if isinstance(child, Plugin) and not isinstance(child, Texture):
            yield from with_nested(child)


def _leaves(texture: Texture) -> Iterator[Texture]:
    """Yields the texture itself, or the textures that it is composed of."""
    for part in texture.parts():
        yield from _leaves(part)
    if not texture.parts():
        yield texture


def check_attributes(scene: Scene, cache: PackCache, leeway: float = LEEWAY) -> None:
    """Checks the mesh attributes that textures read; `leeway`: how far values may be out of range, see `Domain.check_range`.

    Raises:
        ValueError: if a shape lacks one, or one has values that the texture must not have there.
    """
    for shape in scene.shapes:
        for owner in filter(None, (shape.bsdf, shape.emitter)):
            for name, domain, texture in attributes_read(owner):
                values = attribute(scene, shape, name).detach()
                values = values * texture.scale.detach().to(values)
                least, greatest = cache(extremes, cache.frozen((id(shape), id(texture), name), values))
                domain.check_range(f"{scene.name_of(shape)}.{name}", values, least, greatest, leeway)
                domain.warn(f"{scene.name_of(shape)}.{name}", greatest)


def extremes(values: Tensor) -> tuple[float, float]:
    """The least and the greatest value of a tensor."""
    return tuple(torch.stack(values.aminmax()).tolist())


def attribute(scene: Scene, shape: Shape, name: str) -> Tensor:
    """An attribute of a shape's mesh, attached.

    Raises:
        ValueError: if it has none of that name.
    """
    names = getattr(shape, "attribute_names", ())
    if name not in names:
        raise ValueError(f"the shape {scene.name_of(shape)!r} has no attribute {name!r}, which a mesh_attribute of its "
                         f"material or emitter reads; {nearest(name, names)}. Add it, shape.add_attribute({name!r}, values)")
    return getattr(shape, name)


def any_attribute_differentiated(scene: Scene, names: tuple[str, ...]) -> bool:
    """True if an attribute with one of these names carries derivatives."""
    return any(differentiated(getattr(shape, name)) for shape in scene.shapes for name in names
               if name in getattr(shape, "attribute_names", ()))
