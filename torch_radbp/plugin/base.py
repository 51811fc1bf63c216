"""The base class of all plugins, and the base class of each category.

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
    """Base class of all plugins; `id` is the name given in the scene description, or None."""

    category: str = ""
    type: str = ""
    object_of_any_name: str | None = None  # attribute for a nested texture under any other name
    takes_modules = False  # plain modules may be given for its textures
    in_scene = False  # True once it is part of a scene, with all its attributes
    instead_of_objects: str | None = None  # advice for an object that Mitsuba takes here and this plugin does not

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
        """Holds the submodule `name` without registering it as a child: it is registered, and named, elsewhere."""
        self.shared[name] = self._modules.pop(name)

    @classmethod
    def of_file(cls, arguments: dict[str, Any], note: Callable[[str], None]) -> dict[str, Any]:
        """Constructor arguments as a file gives them, with exporters' rounding repaired; `note` is told what was done."""
        return arguments

    def as_written(self, attribute: str) -> Any:
        """The value of an attribute as it is written to a scene file."""
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
        """The plugin with current values that Mitsuba has in place of this one: as a rule itself.

        Raises:
            ValueError: names what Mitsuba lacks.
        """
        return self


class Texture(Plugin):
    category = "texture"
    tabulated = True  # its values are entries of a table, `texels`
    on_lights = True  # an emitter may read it
    entries: str | None = None  # the parameter that has these entries; None: they are computed
    of_module: typing.ClassVar[type[Texture]]  # class that makes a texture of a plain module: `NeuralTexture`

    def sources(self) -> tuple[Tensor, ...]:
        """All tensors that the texture's values are computed from, attached."""
        return tuple(source for part in self.parts() for source in part.sources()) or (self.texels(),)

    def parts(self) -> tuple[Texture, ...]:
        """The textures from which the texture's values are read; empty if it has values of its own."""
        return ()

    def jumps(self) -> tuple[JumpLines, ...]:
        """The lines in surface coordinates (u, v) along which the texture's values are discontinuous."""
        return tuple(lines for part in self.parts() for lines in part.jumps())

    def resolution(self) -> tuple[int, int]:
        """Height and width of the texture's image, in texels."""
        height, width = self.texels().shape[:2]
        return height, width

    def check(self, name: str, domain: Domain) -> None:
        """Raises ValueError unless the texture's values, which messages call `name`, are in a domain."""
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
        """(3,) the world direction of the emitter's pole, of any length; None: it has none."""
        return None


class Shape(Plugin):
    category = "shape"
    whole = False  # one primitive in Mitsuba, whatever it is tessellated into


class Sensor(Plugin):
    category = "sensor"
    up: tuple[float, float, float] | None = None  # up direction of the world, if its data set says so

    def __init__(self) -> None:
        super().__init__()
        self.medium: Medium | None = None  # in which it stands

    def views(self) -> dict[str, Sensor]:
        """The sensors that make one image each, by the suffix that is added to the name of this one."""
        return {"": self}


class Medium(Plugin):
    category = "medium"

    def kind(self) -> Any:
        """The functions of the medium, an `interface.medium.MediumKind`."""
        raise TypeError(f"{type(self).__name__} does not define its kind")

    def row(self) -> Any:
        """The parameters that the medium's functions read: a record of () tensors, attached."""
        raise TypeError(f"{type(self).__name__} does not define its row")


class Phase(Plugin):
    category = "phase"


class Volume(Plugin):
    category = "volume"


class Film(Plugin):
    category = "film"


class ReconstructionFilter(Plugin):
    category = "rfilter"


class Sampler(Plugin):
    """A sampler plugin: how the samples of a pixel get their random numbers.

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
        """Warns if a scene with these materials is rendered otherwise than the integrator's name promises."""


def plugin_categories(annotation: Any) -> list[str]:
    """The categories of plugins that an attribute accepts; empty if it takes plain values only."""
    members = [(typing.get_args(option) or (option,))[-1] for option in options(annotation)]
    return [member.category for member in members if isinstance(member, type) and issubclass(member, Plugin)]


def assigned(owner: Plugin, name: str, value: Any) -> Any:
    """Converts a value that is assigned to a plugin's attribute: a plain module becomes a texture.

    Raises:
        AttributeError: if the plugin has no such attribute.
        TypeError: if the attribute holds a plugin, and the value cannot stand there.
    """
    if not hasattr(owner, name) and name != "parametrizations":
        names = {*attributes(type(owner)), *owner._parameters, *owner._modules, *owner.shared}
        raise AttributeError(f"{owner.type or type(owner).__name__} has no attribute {name!r}; {nearest(name, names)}")
    schema = attributes(type(owner))
    expected = plugin_categories(schema[name].annotation) if name in schema else []
    if not expected or value is None:
        return value
    if isinstance(value, nn.Module) and not isinstance(value, Plugin) and "texture" in expected:
        value = Texture.of_module(value)
    if not isinstance(value, Plugin) or value.category not in expected:
        got = "a texture" if isinstance(value, Texture) else f"a {type(value).__name__}"
        advice = {"bsdf": "; a network or another texture stands in a material, as .bsdf.reflectance",
                  "texture": "; numbers go into its parameter, as .reflectance.value.data"}.get(expected[0], "")
        raise TypeError(f"{name} of {with_article(owner.type)} must be {with_article(expected[0])}, got {got}{advice}")
    if isinstance(value, Texture) and not value.tabulated and not owner.takes_modules:
        raise no_module(owner, name, value)
    return value


def no_module(owner: Plugin, name: str, texture: Texture) -> TypeError:
    """The error about a texture with computed values where only tables can be used."""
    return TypeError(f"{name} of {type(owner).__name__} must be a colour or a bitmap, got a {type(texture).__name__}: a "
                     f"module can stand in the place of every texture of a material, and of a light on a surface, only")
