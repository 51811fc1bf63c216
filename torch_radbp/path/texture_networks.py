"""Values that are computed outside of the functions of a bounce, and handed to them: those of modules."""

from __future__ import annotations

from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.texture.reader import Place, TextureValue


def texture_values_at(scene: SceneTensors, scatterer: Appearance | None,
                      places: tuple[Place, ...]) -> tuple[TextureValue, ...]:
    """The values of the textures that are read outside, as autograd records them if it does.

    Args:
        scene: the whole scene; attached or detached.
        scatterer: what the lanes are scattered by; None: they end.
        places: one for each of these textures, attached or detached.
    """
    banks = banks_outside(scene, scatterer) if places else ()
    return tuple(TextureValue(bank.values(place.row, place.at)) for bank, place in zip(banks, places))


def banks_outside(scene: SceneTensors, scatterer: Appearance | None) -> list:
    """The banks of the textures that are read outside, in the order of `path.bounce.places_of`.

    `scene` may be any record of a scene's structure.
    """
    readers = () if scatterer is None else scatterer.outside
    return [*(scene.textures[scene.layout.readers.index(reader)] for reader in readers), *scene.lit, *scene.lit]
