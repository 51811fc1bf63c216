"""The base of all plugins: their registry, their schemas, and the errors of a scene description.

A plugin is an `nn.Module` registered under a category and a Mitsuba type name. The keyword-only signature of its
constructor is its schema: the loader, `radbp info` and the writer read attribute names, annotations and defaults from there.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import math
import operator
import typing
from collections.abc import Iterator, MutableMapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

PACKAGES = ("bsdf", "emitter", "film", "scene", "sensor", "shape", "texture")  # their import registers plugins


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


class SceneError(ValueError):
    """A scene description that cannot be used; the message names the place and what is supported."""


class Matrix4(Tensor):
    """Annotation of a (4, 4) transform, world from local."""


class Point3(Tensor):
    """Annotation of three floats."""


class Filename(str):
    """Annotation of a path to a file, relative to the scene description."""


FLATTEST = 1e-6  # least volume of a pose's axes, relative to a box with the same edges; rounding of float32 alone makes 1e-7
SMALLEST_VOLUME = 1e-30  # least volume of a pose's axes; areas of smaller objects underflow in float32


class Domain(NamedTuple):
    """The values that a parameter may have. Constructors check them, and so does every rendering (`scene.parameters`)."""

    shapes: tuple[tuple[int | str, ...], ...] | None = None  # letters: any length of at least 1; None: any shape
    low: float = -math.inf
    high: float = math.inf
    low_is_in: bool = True
    high_is_in: bool = True
    unit: str = ""
    is_index: bool = False  # rows of a table, int64
    is_pose: bool = False  # an affine transform that can be inverted

    def check(self, name: str, value: Tensor) -> None:
        """Raises ValueError unless `value` is in the domain; NaN and infinity are in none."""
        self.check_shape(name, value)
        value = value.detach()
        self.check_range(name, value, *value.aminmax())
        if self.is_pose:
            self.check_pose(name, value)

    def check_shape(self, name: str, value: Tensor) -> None:
        """Raises ValueError unless the shape is one of `shapes`."""
        if self.shapes is None or any(fits(tuple(value.shape), shape) for shape in self.shapes):
            return
        possible = " or ".join(f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})" for shape in self.shapes)
        raise ValueError(f"{name} must have shape {possible}, got {tuple(value.shape)}")

    def check_range(self, name: str, value: Tensor, least: float, greatest: float, leeway: float = 0.0,
                    advice: str = "") -> None:
        """Raises ValueError unless the extremes of `value`, NaN if it contains one, are in the range.

        `leeway`: how far they may lie outside, as a share of the greatest magnitude present or allowed; an open end of the
        range has none.
        """
        if not (math.isfinite(least) and math.isfinite(greatest)):
            bad = value.numel() - int(torch.isfinite(value).sum())
            raise ValueError(f"{name} has {bad} of {value.numel()} values that are NaN or infinite{advice}")
        leeway *= max(abs(least), abs(greatest), self.high if self.high < math.inf else 0.0)
        if (least < self.low - leeway) if self.low_is_in else (least <= self.low):
            raise ValueError(f"{name} must be {self.words}, got {float(least):g}{advice}")
        if (greatest > self.high + leeway) if self.high_is_in else (greatest >= self.high):
            raise ValueError(f"{name} must be {self.words}, got {float(greatest):g}{advice}")

    @staticmethod
    def check_pose(name: str, matrix: Tensor) -> None:
        """Raises ValueError unless a (4, 4) matrix is affine and can be inverted."""
        matrix = matrix.detach().to("cpu", torch.float64)
        if (matrix[3] - matrix.new_tensor([0.0, 0, 0, 1])).abs().max() > 1e-5:
            raise ValueError(f"{name} must be affine: its last row must be 0 0 0 1, got {matrix[3].tolist()}")
        linear = matrix[:3, :3]
        volume = torch.linalg.det(linear).abs()
        # A pose may be thin along its own axes or along the world's, but not in every frame.
        box = min(linear.norm(dim=0).prod(), linear.norm(dim=1).prod())
        if volume < max(SMALLEST_VOLUME, FLATTEST * box):
            raise ValueError(f"{name} must be invertible, got a matrix with determinant {float(volume):g}")

    @property
    def words(self) -> str:
        """The range in words that follow "must be"."""
        if self.high == math.inf:
            return f"{'at least' if self.low_is_in else 'greater than'} {self.low:g}{self.unit}"
        if self.low_is_in and self.high_is_in:
            return f"in [{self.low:g}, {self.high:g}]{self.unit}"
        if not self.low_is_in and not self.high_is_in:
            return f"between {self.low:g} and {self.high:g}{self.unit}"
        return (f"{'at least' if self.low_is_in else 'more than'} {self.low:g} and "
                f"{'at most' if self.high_is_in else 'less than'} {self.high:g}{self.unit}")


def fits(shape: tuple[int, ...], pattern: tuple[int | str, ...]) -> bool:
    """True if a shape matches a pattern of lengths and letters."""
    return len(shape) == len(pattern) and all(length == wanted if isinstance(wanted, int) else length > 0
                                              for length, wanted in zip(shape, pattern))


LARGEST_COORDINATE = 1e12  # beyond it, squared areas overflow in float32, and shapes vanish
NUMBER = Domain(shapes=((),))
AMOUNT = Domain(low=0.0)  # such as of light or of roughness
FRACTION = Domain(low=0.0, high=1.0)
POSE = Domain(shapes=((4, 4),), is_pose=True)


class Attribute(NamedTuple):
    """One row of a plugin's schema."""

    annotation: Any
    default: Any
    required: bool


class Plugin(nn.Module):
    """Base of all plugins; `id` is the name given in the scene description, or None."""

    category: str = ""
    type: str = ""

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


class BSDF(Plugin):
    category = "bsdf"


class Emitter(Plugin):
    category = "emitter"


class Shape(Plugin):
    category = "shape"


class Sensor(Plugin):
    category = "sensor"


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


def register(category: str, name: str):
    """Class decorator that makes a plugin known to the loader as `category` / `name`."""

    def add(cls: type[Plugin]) -> type[Plugin]:
        cls.category, cls.type = category, name
        REGISTRY[category][name] = cls
        return cls

    return add


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
