"""The base of all plugins: their registry, their schemas, and the errors of a scene description.

A plugin is an `nn.Module` registered under a category and a Mitsuba type name. The keyword-only signature of its
constructor is its schema: the loader, `radbp info` and the writer read attribute names, annotations and defaults from there.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import operator
import typing
from collections.abc import Iterable, Iterator, MutableMapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from torch_radbp.domain import Domain

PACKAGES = ("bsdf", "emitter", "film", "integrator", "sensor", "shape", "texture")  # their import registers plugins


class PluginTypes(MutableMapping):
    """The plugin classes of one category by type name; the package's own are imported when they are first asked for."""

    def __init__(self) -> None:
        self.registered: dict[str, type[Plugin]] = {}

    def all(self) -> dict[str, type[Plugin]]:
        """All registered classes by name; imports the package's plugins first."""
        for package in PACKAGES:
            importlib.import_module(f"torch_radbp.{package}")
        return self.registered

    def __getitem__(self, name: str) -> type[Plugin]:
        return self.all()[name]

    def __setitem__(self, name: str, cls: type[Plugin]) -> None:
        self.registered[name] = cls

    def __delitem__(self, name: str) -> None:
        del self.registered[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.all())

    def __len__(self) -> int:
        return len(self.all())


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
    instead_of_objects: str | None = None  # what to do where an object is given that Mitsuba takes and this does not

    def __init__(self) -> None:
        super().__init__()
        self.id: str | None = None
        self.shared: dict[str, Plugin] = {}

    def __getattr__(self, name: str):
        shared = self.__dict__.get("shared", {})
        return shared[name] if name in shared else super().__getattr__(name)

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


class Texture(Plugin):
    category = "texture"
    tabulated = True  # its values are those of a table, `texels`
    entries: str | None = None  # the parameter whose entries these values are; None: they are computed

    def sources(self) -> tuple[Tensor, ...]:
        """All tensors that its values are computed from, attached."""
        return tuple(source for part in self.parts() for source in part.sources()) or (self.texels(),)

    def parts(self) -> tuple[Texture, ...]:
        """The textures that its values are taken from; none: they are its own."""
        return ()

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


class Shape(Plugin):
    category = "shape"
    whole = False  # it is one primitive in Mitsuba, whatever it is tessellated into


class Sensor(Plugin):
    category = "sensor"

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
    """
    if isinstance(value, Tensor) and value.requires_grad and not isinstance(value, nn.Parameter):
        raise no_gradient(name)
    if isinstance(value, nn.Parameter):
        tensor = value
    else:
        tensor = value.detach().clone() if isinstance(value, Tensor) else torch.as_tensor(value, device="cpu")
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
