"""The base of all plugins, and of those of each category.

A plugin is an `nn.Module` registered under a category and a Mitsuba type name. The keyword-only signature of its
constructor is its schema: the loader, `radbp info` and the writer read attribute names, annotations and defaults from there.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterable
from typing import Any

from torch import Tensor, nn

from torch_radbp.plugin.domain import Domain
from torch_radbp.plugin.errors import nearest, with_article
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.plugin.schema import attributes, options
from torch_radbp.plugin.values import integer, no_gradient


class Plugin(nn.Module):
    """Base of all plugins; `id` is the name given in the scene description, or None."""

    category: str = ""
    type: str = ""
    object_of_any_name: str | None = None  # the attribute for a nested texture whose name says nothing
    takes_modules = False  # in the place of its textures
    in_scene = False  # made, with all attributes that it will have
    instead_of_objects: str | None = None  # what to do where an object is given that Mitsuba takes and this does not

    def __init__(self) -> None:
        super().__init__()
        self.id: str | None = None
        self.shared: dict[str, Plugin] = {}

    def __getattr__(self, name: str) -> Any:
        shared = self.__dict__.get("shared", {})
        return shared[name] if name in shared else super().__getattr__(name)

    def __setattr__(self, name: str, value: Any) -> None:
        if self.in_scene and isinstance(value, (nn.Parameter, nn.Module)) or name in self.__dict__.get("_modules", ()):
            value = assigned(self, name, value)
        if isinstance(value, nn.Module):
            self.__dict__.get("shared", {}).pop(name, None)
        super().__setattr__(name, value)

    def share(self, name: str) -> None:
        """Keeps the child `name` as a reference only, because it is registered (and named) elsewhere."""
        self.shared[name] = self._modules.pop(name)

    @classmethod
    def of_file(cls, arguments: dict[str, Any], note: Callable[[str], None]) -> dict[str, Any]:
        """Arguments of the constructor as a file gives them, repaired where exporters round; `note` takes what was done."""
        return arguments

    def as_written(self, attribute: str) -> Any:
        """The value of an attribute as a file of the scene has it."""
        return getattr(self, attribute)

    def domains(self) -> dict[str, Domain]:
        """The domains of the plugin's parameters and tables, and of the values of its textures, by attribute."""
        return {}

    def freeze(self, name: str, value: Tensor) -> None:
        """Registers `value` as a parameter: an `nn.Parameter` itself, else one that takes no gradient until the user asks.

        Raises:
            ValueError: if it is not in its domain, or was computed from something that requires a gradient.
        """
        self.domains().get(name, Domain()).check(name, value)
        if value.requires_grad and not isinstance(value, nn.Parameter):
            raise no_gradient(name)
        live = isinstance(value, nn.Parameter)
        self.register_parameter(name, value if live else nn.Parameter(value, requires_grad=False))

    def for_mitsuba(self) -> Plugin:
        """What Mitsuba has in the place of this plugin, with its current values: as a rule itself.

        Raises:
            ValueError: names what Mitsuba lacks.
        """
        return self


class Texture(Plugin):
    category = "texture"
    tabulated = True  # its values are those of a table, `texels`
    entries: str | None = None  # the parameter whose entries these values are; None: they are computed
    of_module: typing.ClassVar[type[Texture]]  # makes a texture of a plain module: `NeuralTexture`

    def sources(self) -> tuple[Tensor, ...]:
        """All tensors that its values are computed from, attached."""
        return tuple(source for part in self.parts() for source in part.sources()) or (self.texels(),)

    def parts(self) -> tuple[Texture, ...]:
        """The textures that its values are taken from; none: they are its own."""
        return ()

    def jumps(self) -> tuple[JumpLines, ...]:
        """The lines along which its values jump, all that it has on surfaces."""
        return tuple(lines for part in self.parts() for lines in part.jumps())

    def resolution(self) -> tuple[int, int]:
        """Height and width of the image, in texels."""
        height, width = self.texels().shape[:2]
        return height, width

    def check(self, name: str, domain: Domain) -> None:
        """Raises ValueError unless its values, which messages call `name`, are in a domain."""
        for part in self.parts():
            part.check(name, domain)
        if not self.parts():
            domain.check(name, self.texels())


class BSDF(Plugin):
    category = "bsdf"
    takes_modules = True


class Emitter(Plugin):
    category = "emitter"

    def up(self) -> Tensor | None:
        """(3,) the world direction of its pole, of any length; None: it has none."""
        return None


class Shape(Plugin):
    category = "shape"
    whole = False  # it is one primitive in Mitsuba, whatever it is tessellated into


class Sensor(Plugin):
    category = "sensor"
    up: tuple[float, float, float] | None = None  # of the world, if the data set that it is of says so

    def views(self) -> dict[str, Sensor]:
        """The sensors that make an image each, by what is added to the name of this one."""
        return {"": self}


class Film(Plugin):
    category = "film"


class ReconstructionFilter(Plugin):
    category = "rfilter"


class Sampler(Plugin):
    """Gives the samples of a pixel their random numbers.

    Args:
        sample_count: default number of samples per pixel.
        seed: added to the seed of a call.
    """

    category = "sampler"
    low_discrepancy: bool  # the samples of a pixel form a low-discrepancy sequence

    def __init__(self, *, sample_count: int = 4, seed: int = 0):
        super().__init__()
        self.sample_count, self.seed = integer("sample_count", sample_count), integer("seed", seed)
        if self.sample_count < 1:
            raise ValueError(f"sample_count must be at least 1, got {sample_count}")


class Integrator(Plugin):
    category = "integrator"

    def check(self, materials: Iterable[BSDF]) -> None:
        """Warns if a scene of these materials is rendered differently from what the name of the integrator promises."""


def plugin_categories(annotation: Any) -> list[str]:
    """The categories of plugins that an attribute accepts; empty if it takes plain values only."""
    members = [(typing.get_args(option) or (option,))[-1] for option in options(annotation)]
    return [member.category for member in members if isinstance(member, type) and issubclass(member, Plugin)]


def assigned(owner: Plugin, name: str, value: Any) -> Any:
    """What the attribute `name` of a plugin becomes when `value` is assigned to it: a texture of a plain module.

    Raises:
        AttributeError: if the plugin has no such attribute.
        TypeError: if the attribute holds a plugin, and the value cannot stand there.
    """
    if not hasattr(owner, name) and name != "parametrizations":
        known = {*attributes(type(owner)), *owner._parameters, *owner._modules, *owner.shared}
        raise AttributeError(f"{owner.type or type(owner).__name__} has no attribute {name!r}; {nearest(name, known)}")
    schema = attributes(type(owner))
    expected = plugin_categories(schema[name].annotation) if name in schema else []
    if not expected or value is None:
        return value
    if isinstance(value, nn.Module) and not isinstance(value, Plugin) and "texture" in expected:
        value = Texture.of_module(value)
    if not isinstance(value, Plugin) or value.category not in expected:
        found = "a texture" if isinstance(value, Texture) else f"a {type(value).__name__}"
        advice = {"bsdf": "; a network or another texture stands in a material, as .bsdf.reflectance",
                  "texture": "; numbers go into its parameter, as .reflectance.value.data"}.get(expected[0], "")
        raise TypeError(f"{name} of {with_article(owner.type)} must be {with_article(expected[0])}, got {found}{advice}")
    if isinstance(value, Texture) and not value.tabulated and not owner.takes_modules:
        raise no_module(owner, name, value)
    return value


def no_module(owner: Plugin, name: str, texture: Texture) -> TypeError:
    """The error about a texture that is no table where only tables can stand."""
    return TypeError(f"{name} of {type(owner).__name__} must be a colour or a bitmap, got a {type(texture).__name__}: a "
                     f"module can stand in the place of every texture of a material, and of a light on a surface, only")
