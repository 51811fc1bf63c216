"""Values that are computed outside of the functions of a bounce, and handed to them: those of modules."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from torch import Tensor

from torch_radbp.jit.recording import outside
from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.tensors import Layout, SceneTensors
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.texture.reader import Place, TextureValue


def texture_values_at(scene: SceneTensors, scatterer: Appearance | None,
                      places: tuple[Place, ...]) -> tuple[TextureValue, ...]:
    """The values of the textures that are read outside, as autograd records them if it does.

    Args:
        scene: the whole scene; attached or detached.
        scatterer: what the lanes are scattered by; None: they end.
        places: one for each of these textures, attached or detached.
    """
    return tuple(TextureValue(Vec3(*outside(partial(values_of, scatterer, number), scene, (place.row, *place.at), 3)))
                 for number, place in enumerate(places))


def values_of(scatterer: Appearance | None, number: int, scene: SceneTensors, row: Tensor, *at: Tensor) -> Vec3:
    """The values of one of the textures that are read outside; args as for `texture_values_at`."""
    return banks_outside(scene, scatterer)[number].values(row, coordinates(at))


def coordinates(at: Sequence[Tensor]) -> Vec2 | Vec3:
    """`Place.at` of its components."""
    return Vec2(*at) if len(at) == 2 else Vec3(*at)


def number_outside(layout: Layout, scatterer: Appearance | None, nee: bool) -> int:
    """The number of values that lanes read outside, which are scattered by something or end; see `path.bounce.places_of`."""
    if scatterer is None:
        return len(layout.lit)
    return len(scatterer.outside) + (2 if nee else 1) * len(layout.lit)


def banks_outside(scene: SceneTensors, scatterer: Appearance | None) -> list:
    """The banks of the textures that are read outside, in the order of `path.bounce.places_of`.

    `scene` may be any record of a scene's structure.
    """
    readers = () if scatterer is None else scatterer.outside
    return [*(scene.textures[scene.layout.readers.index(reader)] for reader in readers), *scene.lit, *scene.lit]
