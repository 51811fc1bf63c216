"""The base of all plugins: their registry, their schemas, and the errors of a scene description.

A plugin is an `nn.Module` registered under a category and a Mitsuba type name. The keyword-only signature of its
constructor is its schema: the loader, `radbp info` and the writer read attribute names, annotations and defaults from there.
"""

from __future__ import annotations

import difflib
import inspect
import operator
import types
import typing
from collections.abc import Iterable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from torch_radbp.domain import Domain
from torch_radbp.jump_lines import JumpLines
from torch_radbp.plugin_types import PluginTypes

REGISTRY: dict[str, PluginTypes] = {
    name: PluginTypes()
    for name in ("shape", "bsdf", "texture", "emitter", "sensor", "film", "rfilter", "sampler", "integrator")
}


ABSENT: dict[tuple[str, str], str] = {}  # plugins of Mitsuba that are not there: why, and what to use


class SceneError(ValueError):
    """A scene description that cannot be used; the message names the place, what is there, and what is supported.

    The place is a file and a line in it (XML, meshes), or the path of keys (dicts, glTF).
    """


class SceneWarning(UserWarning):
    """A scene description that is read in another way than its author may have meant."""


class Matrix4(Tensor):
    """Annotation of a (4, 4) transform, world from local."""


class Point3(Tensor):
    """Annotation of three floats."""


class Filename(str):
    """Annotation of a path to a file, relative to the scene description."""


class Attribute(NamedTuple):
    """One row of a plugin's schema."""

    annotation: Any
    default: Any
    required: bool


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


def register(category: str, name: str):
    """Class decorator that makes a plugin known to the loader as `category` / `name`."""

    def add(cls: type[Plugin]) -> type[Plugin]:
        cls.category, cls.type = category, name
        REGISTRY[category][name] = cls
        return cls

    return add


def absent(category: str, name: str, reason: str) -> None:
    """Lets the loader say why it does not know a plugin of Mitsuba, and what to use in its place."""
    ABSENT[category, name] = reason


@cache
def attributes(cls: type[Plugin]) -> dict[str, Attribute]:
    """The schema of a plugin class: attribute name to annotation, default and whether it is required; not to be changed."""
    hints = typing.get_type_hints(cls.__init__)
    schema = {}
    for name, parameter in inspect.signature(cls.__init__).parameters.items():
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
            required = parameter.default is inspect.Parameter.empty
            schema[name] = Attribute(hints[name], None if required else parameter.default, required)
    return schema


def options(annotation: Any) -> tuple[Any, ...]:
    """The members of a union, or the annotation alone."""
    is_union = typing.get_origin(annotation) in (types.UnionType, typing.Union)
    return typing.get_args(annotation) if is_union else (annotation,)


def plugin_categories(annotation: Any) -> list[str]:
    """The categories of plugins that an attribute accepts; empty if it takes plain values only."""
    members = [(typing.get_args(option) or (option,))[-1] for option in options(annotation)]
    return [member.category for member in members if isinstance(member, type) and issubclass(member, Plugin)]


def with_article(noun: str) -> str:
    """"an emitter", "a bsdf"."""
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


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


def nearest(name: str, known: typing.Iterable[str]) -> str:
    """A sentence that lists the known names, the most similar first."""
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(repr(c) for c in close)}? " if close else ""
    return f"{hint}known: {', '.join(known) or 'none'}"


def finite(name: str, value: Any, shape: tuple[int, ...] | None = None) -> Tensor:
    """`value` as a float tensor, checked for shape and for NaN or infinity: an `nn.Parameter` itself, else a copy.

    Raises:
        ValueError: if the shape differs, a value is complex or not finite, or the copy of a tensor would lose its gradient.
        TypeError: if it is no dense array of numbers.
    """
    if isinstance(value, Tensor) and value.requires_grad and not isinstance(value, nn.Parameter):
        raise no_gradient(name)
    if isinstance(value, nn.Parameter):
        tensor = value
    else:
        try:
            tensor = value.detach().clone() if isinstance(value, Tensor) else torch.as_tensor(value, device="cpu")
        except (TypeError, ValueError, RuntimeError):
            raise TypeError(f"{name} must be a tensor or an array of numbers, got {type(value).__name__}") from None
    if tensor.layout != torch.strided:
        raise TypeError(f"{name} must be a dense tensor, got {tensor.layout}: convert it with .to_dense()")
    if tensor.dtype == torch.bool:
        raise TypeError(f"{name} must be numbers, got {tensor.dtype}: convert it with .float()")
    if tensor.is_meta:
        raise ValueError(f"{name} is on the device meta, which holds no numbers: give it on the CPU")
    if tensor.is_complex():
        raise ValueError(f"{name} must be real numbers, got {tensor.dtype}; take its real part")
    if not tensor.is_floating_point():
        tensor = tensor.to(torch.get_default_dtype())
    if shape is not None and tuple(tensor.shape) != shape:
        raise ValueError(f"{name} must have shape {shape}, got {tuple(tensor.shape)}")
    bad = int((~torch.isfinite(tensor.to(torch.get_default_dtype()))).sum())
    if bad:
        raise ValueError(f"{name} must be finite, got {bad} of {tensor.numel()} values that are NaN or infinite in "
                         f"{str(torch.get_default_dtype()).removeprefix('torch.')}")
    return tensor


def no_gradient(name: str) -> ValueError:
    """The error about a tensor that cannot become a parameter and would leave its gradient behind."""
    return ValueError(f"{name} requires a gradient, which would not reach it: only an nn.Parameter, of the dtype, shape and "
                      f"space in which the scene keeps it, becomes the scene's own parameter. Give one; or load the scene "
                      f"first and hand the tensor over by torch.func.functional_call or torch.nn.utils.parametrize")


def integer(name: str, value: Any, least: int | None = None) -> int:
    """`value` as an int: numpy's integers and tensors of one integer are accepted, truth values are not.

    Raises:
        ValueError: if it is of another type, or less than `least`.
    """
    try:
        number = None if isinstance(value, (bool, np.bool_)) else operator.index(value)
    except TypeError:
        number = None
    if number is None or (least is not None and number < least):
        raise ValueError(f"{name} must be an integer{'' if least is None else f' of at least {least}'}, got {value!r}")
    return number


def boolean(name: str, value: Any) -> bool:
    """`value` as a bool.

    Raises:
        ValueError: if it is anything but a truth value; 0 and 1 are numbers.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def positive(name: str, value: float) -> float:
    """`value`, checked to be greater than zero and finite."""
    if not (value > 0 and value < float("inf")):
        raise ValueError(f"{name} must be greater than 0 and finite, got {value}")
    return float(value)
