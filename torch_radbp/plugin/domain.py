"""`Domain`: the set of valid values of a parameter.

Every plugin says for each of its parameters which they are (`Plugin.domains`). Its constructor checks them, and every
rendering does (`torch_radbp.scene.modules.parameters`).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

LARGEST_AMOUNT = 1e18  # beyond it, squares overflow in float32
LARGEST_REFLECTANCE = 1e6  # of one bounce; the products of several are finite in float32
LARGEST_COORDINATE = 1e12  # beyond it, squared areas overflow in float32, and shapes vanish
LEEWAY = 0.02  # how far a value may leave its range, as steps of optimizers and of finite differences do
FLATTEST = 1e-6  # least volume of a pose's axes, relative to a box with the same edges; rounding of float32 alone makes 1e-7
SMALLEST_VOLUME = 1e-30  # least volume of a pose's axes; areas of smaller objects underflow in float32
SHORTEST_AXIS = 1e-11  # of a pose; `vec.normalize` leaves vectors shorter than 1e-12 as they are


class Domain(NamedTuple):
    """The set of valid values of a parameter. Constructors check it, and so does every rendering, see
    `scene.modules.parameters`.
    """

    shapes: tuple[tuple[int | str, ...], ...] | None = None  # letters: any length of at least 1; None: any shape
    low: float = -math.inf
    high: float = math.inf
    low_is_in: bool = True
    high_is_in: bool = True
    limit: float = math.inf  # of the magnitude, so that float32 does not overflow
    floor: float = -math.inf  # smaller values may count as this, with its derivative: optimizers can leave the end again
    is_reflectance: bool = False  # fractions of light; values above 1 make more light than arrives, and are warned of
    unit: str = ""
    is_index: bool = False  # indices of rows of a table, int64
    is_pose: bool = False  # an invertible affine transform

    def check(self, name: str, value: Tensor) -> None:
        """Raises ValueError unless `value` is in the domain; NaN and infinity never are."""
        self.check_shape(name, value)
        value = value.detach()
        self.check_range(name, value, *torch.stack(value.aminmax()).tolist())
        if self.is_pose:
            self.check_pose(name, value.tolist())

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
        if max(abs(least), abs(greatest)) > self.limit:
            raise ValueError(f"{name} must be at most {self.limit:g} in magnitude, got {max(greatest, least, key=abs):g}: "
                             f"float32 overflows beyond that")
        leeway *= max(abs(least), abs(greatest), self.high if self.high < math.inf else 0.0)
        if (least < self.low - leeway) if self.low_is_in else (least <= self.low):
            raise ValueError(f"{name} must be {self.words}, got {float(least):g}{advice}")
        if (greatest > self.high + leeway) if self.high_is_in else (greatest >= self.high):
            raise ValueError(f"{name} must be {self.words}, got {float(greatest):g}{advice}")

    def warn(self, name: str, greatest: float) -> None:
        """Warns of a reflectance above 1."""
        if self.is_reflectance and greatest > 1.0 + LEEWAY:
            warnings.warn(f"{name} has values above 1: the surface reflects more light than it gets, and paths that meet it "
                          f"often may grow without bound", UserWarning, stacklevel=2)

    @staticmethod
    def check_pose(name: str, matrix: Sequence[Sequence[float]]) -> None:
        """Raises ValueError unless a (4, 4) matrix is an invertible affine transform, in float32 too.

        Args:
            name: for messages.
            matrix: its rows; a scene may have thousands: numbers are faster than tensors of 16.
        """
        *rows, last = matrix
        if max(abs(entry - wanted) for entry, wanted in zip(last, (0, 0, 0, 1))) > 1e-5:
            raise ValueError(f"{name} must be affine: its last row must be 0 0 0 1, got {last}")
        (a, b, c), (d, e, f), (g, h, i) = linear = [row[:3] for row in rows]
        volume = abs(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))
        axes = [math.hypot(*axis) for axis in zip(*linear)]
        # A pose may be thin along its own axes or along the world's, but not in every frame.
        box = min(math.prod(axes), math.prod(math.hypot(*row) for row in linear))
        if volume < max(SMALLEST_VOLUME, FLATTEST * box):
            raise ValueError(f"{name} must be invertible, got a matrix with determinant {volume:g}")
        if min(axes) < SHORTEST_AXIS:
            raise ValueError(f"{name} must have axes of length at least {SHORTEST_AXIS:g}, got one of {min(axes):g}: "
                             f"directions along it underflow in float32")

    @property
    def words(self) -> str:
        """The range as words that follow "must be" in a message."""
        if self.high == math.inf:
            return f"{'at least' if self.low_is_in else 'greater than'} {self.low:g}{self.unit}"
        if self.low_is_in and self.high_is_in:
            return f"in [{self.low:g}, {self.high:g}]{self.unit}"
        if not self.low_is_in and not self.high_is_in:
            return f"between {self.low:g} and {self.high:g}{self.unit}"
        return (f"{'at least' if self.low_is_in else 'more than'} {self.low:g} and "
                f"{'at most' if self.high_is_in else 'less than'} {self.high:g}{self.unit}")


def fits(shape: tuple[int, ...], pattern: tuple[int | str, ...]) -> bool:
    """True if a shape matches a pattern of lengths and letters, equal letters for equal lengths."""
    return len(shape) == len(pattern) and all(length == wanted if isinstance(wanted, int) else length > 0
                                              for length, wanted in zip(shape, pattern))


NUMBER = Domain(shapes=((),))
AMOUNT = Domain(low=0.0, limit=LARGEST_AMOUNT)  # such as of light or of roughness
FRACTION = Domain(low=0.0, high=1.0)
REFLECTANCE = Domain(low=0.0, limit=LARGEST_REFLECTANCE, is_reflectance=True)
POINT = Domain(shapes=((3,),), limit=LARGEST_COORDINATE)
POSE = Domain(shapes=((4, 4),), is_pose=True)
