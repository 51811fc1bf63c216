"""Materials with many optional parameters, of which absent ones cost nothing: neither a value nor code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor, nn

from torch_radbp.interface.bsdf import Kind, Values
from torch_radbp.plugin import Texture
from torch_radbp.tensors.differentiated import differentiated
from torch_radbp.texture.rgb import RGB

Number = Tensor | float  # of a parameter that a material does not have: its value, zero


@dataclass(frozen=True)
class FeaturedKind(Kind):
    """A BSDF with optional parameters. Parameter values: `always` fixed ones, then one scalar for each of the `features`."""

    features: tuple[str, ...]

    always: ClassVar[int]
    discrete: ClassVar[bool] = True

    @property
    def oriented(self) -> bool:
        return self.has("anisotropic")

    @property
    def slots(self) -> int:
        return self.always + len(self.features)

    def has(self, name: str) -> bool:
        """True if the material has the optional parameter `name`."""
        return name in self.features

    def number(self, values: Values, name: str) -> Number:
        """The value of an optional parameter; 0 if the material lacks it."""
        return values[self.always + self.features.index(name)].x if self.has(name) else 0.0

    def places(self, *names: str) -> tuple[int, ...]:
        """The indices of optional parameters among all parameter values; absent ones are skipped."""
        return tuple(self.always + place for place, name in enumerate(self.features) if name in names)


def is_needed(texture: Texture) -> bool:
    """False if an optional parameter has no effect: zero everywhere, and not differentiated."""
    return not isinstance(texture, RGB) or differentiated(texture.value) or bool((texture.value != 0).any())


def features_of(material: nn.Module, names: Iterable[str], part_of: Mapping[str, str]) -> tuple[str, ...]:
    """The names of the optional parameters that have an effect now, in order.

    Args:
        material: has a texture for each.
        names: of the parameters.
        part_of: for some of them another one, without which they do not matter.
    """
    there = {name for name in names if is_needed(getattr(material, name))}
    return tuple(name for name in names if name in there and part_of.get(name, name) in there)
