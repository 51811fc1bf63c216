"""Vectors as records of flat tensors, rays, and the local shading frame.

Everything per lane is a struct of arrays: a `Vec3` holds three tensors of one shape, so that a compiler sees independent
streams and fuses them. At the borders (parameters, images) tensors keep the shapes users expect; `Vec3.of` and `Vec3.stack`
go between the two.
"""

from __future__ import annotations

import operator
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.differentiated import linear, with_derivative_of
from torch_radbp.tensors.stage import stage

SMALLEST_TANGENT = 1e-8  # squared
TINY = 1e-24  # keeps a division finite where the quotient is not used; the derivative of rsqrt here is finite in float32


class Vec2(NamedTuple):
    """A vector of two components per lane."""

    x: Tensor
    y: Tensor

    def __add__(self, other: Vec2) -> Vec2:
        return Vec2(self.x + other.x, self.y + other.y)

    def map(self, function) -> Vec2:
        """Applies `function` to each component."""
        return Vec2(function(self.x), function(self.y))

    def __mul__(self, scale: Tensor | float) -> Vec2:
        return Vec2(self.x * scale, self.y * scale)

    def stack(self, dim: int = -1) -> Tensor:
        """The components as one tensor, (..., 2) by default."""
        return torch.stack(tuple(self), dim)

    @staticmethod
    def of(tensor: Tensor) -> Vec2:
        """Splits the last axis of a (..., 2) tensor."""
        return Vec2(*(component.contiguous() for component in tensor.unbind(-1)))


class Vec3(NamedTuple):
    """A 3-vector or an RGB colour per lane. `*` and `/` are component-wise."""

    x: Tensor
    y: Tensor
    z: Tensor

    def __add__(self, other: Vec3) -> Vec3:
        return Vec3(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Vec3) -> Vec3:
        return Vec3(self.x - other.x, self.y - other.y, self.z - other.z)

    def __mul__(self, other: Vec3 | Tensor | float) -> Vec3:
        if isinstance(other, Vec3):
            return Vec3(self.x * other.x, self.y * other.y, self.z * other.z)
        return self.map(partial(linear, operator.mul, still=other))

    def __truediv__(self, scale: Tensor | float) -> Vec3:
        return self * (1.0 / scale)

    def __neg__(self) -> Vec3:
        return Vec3(-self.x, -self.y, -self.z)

    def map(self, function) -> Vec3:
        """Applies `function` to each component."""
        return Vec3(function(self.x), function(self.y), function(self.z))

    def detach(self) -> Vec3:
        return self.map(torch.Tensor.detach)

    def stack(self, dim: int = -1) -> Tensor:
        """The components as one tensor, (..., 3) by default."""
        return torch.stack(tuple(self), dim)

    @staticmethod
    def of(tensor: Tensor, dim: int = -1) -> Vec3:
        """Splits the axis `dim`, of length 3, into contiguous components."""
        return Vec3(*(component.contiguous() for component in tensor.unbind(dim)))

    @staticmethod
    def full(like: Tensor, value: float) -> Vec3:
        """A vector whose components share one constant tensor: do not write into it."""
        component = torch.full_like(like, value)
        return Vec3(component, component, component)

    @staticmethod
    def buffer(like: Tensor) -> Vec3:
        """A vector of zeros to write into: each component is a tensor of its own."""
        return Vec3(torch.zeros_like(like), torch.zeros_like(like), torch.zeros_like(like))


def dot(a: Vec3, b: Vec3) -> Tensor:
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vec3, b: Vec3) -> Vec3:
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def angle_between(a: Vec3, b: Vec3) -> Tensor:
    """(N,) the angle between unit vectors, in [0, pi]; accurate also for nearly equal or opposite vectors."""
    return 2.0 * torch.atan2(*(torch.sqrt(dot(chord, chord)) for chord in (a - b, a + b)))


def normalize(a: Vec3) -> Vec3:
    """The unit vector along `a`; a vector of length zero stays zero."""
    return a * torch.rsqrt(dot(a, a).clamp_min(TINY))


def where(condition: Tensor, a: Vec3, b: Vec3) -> Vec3:
    return Vec3(torch.where(condition, a.x, b.x), torch.where(condition, a.y, b.y), torch.where(condition, a.z, b.z))


def masked(condition: Tensor, a: Vec3) -> Vec3:
    """`a` where the condition holds, else zero; `a` is finite. A product: `torch.where` is ten times slower on a CPU."""
    return a * condition.to(a.x.dtype)


def gather(table: Tensor, index: Tensor) -> Tensor:
    """Gathers entries of a table at integer `index` (N,)."""
    return table.index_select(0, index)


@stage("record")
def rows(record, index: Tensor):
    """Gathers the rows `index` of every tensor of a record, in nested tuples; None stays None."""
    if record is None:
        return None
    if isinstance(record, Tensor):
        return record.index_select(0, index)
    parts = [rows(part, index) for part in record]
    return type(record)(*parts) if hasattr(record, "_fields") else tuple(parts)


def attached(value: Tensor | Vec3, source: Tensor | Vec3) -> Tensor | Vec3:
    """`value` with the derivative of `source`, which has the same value up to rounding."""
    if isinstance(value, Vec3):
        return Vec3(*(attached(v, s) for v, s in zip(value, source)))
    return with_derivative_of(value.detach(), source)


def interpolated(corners: tuple[Vec2 | Vec3, ...], u: Tensor, v: Tensor) -> Vec2 | Vec3:
    """Interpolates between the three vertices of triangles, by the second and third barycentric coordinate."""
    first, second, third = corners
    return first * (1.0 - u - v) + second * u + third * v


def max_component(a: Vec3) -> Tensor:
    return torch.maximum(a.x, torch.maximum(a.y, a.z))


def unit_normal(e1: Vec3, e2: Vec3) -> Vec3:
    """The unit normal of triangles with these edges, safe from underflow where triangles are tiny."""
    return normalize(cross(scaled(e1), scaled(e2)))


def scaled(a: Vec3) -> Vec3:
    """`a` divided by its largest component, a constant for derivatives; a vector of length zero stays zero."""
    size = max_component(a.detach().map(torch.abs))
    return a * torch.where(size > 0, size, 1.0).reciprocal()


class Ray(NamedTuple):
    """Rays o + t d with t > 0, world space."""

    o: Vec3  # origin
    d: Vec3  # direction; unit length in the tracer


def crossing(ray: Ray, p0: Vec3, e1: Vec3, e2: Vec3) -> tuple[Tensor, Tensor, Tensor]:
    """Triple products from which the intersection of a line and a triangle's plane follows; attached to all arguments.

    Args:
        ray: gives the line.
        p0: the first vertex.
        e1, e2: the edges from there to the second and the third.

    Returns:
        The triple product of d, e1 and e2, which is 0 if the plane is seen edge-on; and two volumes whose ratios to it are
        the barycentric coordinates of the second and of the third vertex.

    Reference: Moeller and Trumbore 1997, "Fast, Minimum Storage Ray/Triangle Intersection".
    """
    across, offset = cross(ray.d, e2), ray.o - p0
    return dot(e1, across), dot(offset, across), dot(ray.d, cross(offset, e1))


def both(first: Tensor, second: Tensor | None) -> Tensor:
    """True where two conditions hold, bool; a second one of None holds everywhere."""
    return first if second is None else first & second


class Frame(NamedTuple):
    """An orthonormal basis; local directions have z along `n`."""

    s: Vec3
    t: Vec3
    n: Vec3

    def to_local(self, v: Vec3) -> Vec3:
        return Vec3(dot(v, self.s), dot(v, self.t), dot(v, self.n))

    def to_world(self, v: Vec3) -> Vec3:
        return self.s * v.x + self.t * v.y + self.n * v.z

    def coordinates(self, v: Vec3) -> Vec3:
        """The linear combination of the axes by `v`, as `to_world`; attached to the axes, which need not be orthonormal."""
        across = cross(self.t, self.n), cross(self.n, self.s), cross(self.s, self.t)
        return Vec3(*(dot(v, axis) for axis in across)) / dot(self.s, across[0])

    @staticmethod
    def of(n: Vec3) -> Frame:
        """Completes the unit vector `n` to an orthonormal basis.

        Reference: Duff et al. 2017, "Building an Orthonormal Basis, Revisited", listing 3.
        """
        sign = torch.copysign(torch.ones_like(n.z), n.z)
        a = -1.0 / (sign + n.z)
        b = n.x * n.y * a
        s = Vec3(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x)
        t = Vec3(b, sign + n.y * n.y * a, -n.y)
        return Frame(s, t, n)

    @staticmethod
    def along(n: Vec3, direction: Vec3) -> Frame:
        """Completes the unit vector `n` to a basis with s as close to `direction` as possible; `Frame.of` if parallel."""
        across = direction - n * dot(n, direction)
        squared = dot(across, across)
        fine = squared > SMALLEST_TANGENT
        s = where(fine, across * torch.rsqrt(torch.where(fine, squared, 1.0)), Frame.of(n).s)
        return Frame(s, cross(n, s), n)


class LocalVec3:
    """A vector in a shading frame with lazily computed components: a diffuse surface only reads z.

    Has the operators of `Vec3`.
    """

    def __init__(self, frame: ShadingFrame, v: Vec3, backwards: bool = False, z: Tensor | None = None):
        """Transforms `v` (or -v if `backwards`) to the frame; `z`: its z component, if already computed."""
        self.frame, self.v, self.backwards = frame, v, backwards
        self.parts: dict[str, Tensor] = {} if z is None else {"z": z}

    def part(self, name: str) -> Tensor:
        if name not in self.parts:
            along = dot(self.v, getattr(self.frame, {"x": "s", "y": "t", "z": "n"}[name]))
            self.parts[name] = -along if self.backwards else along
        return self.parts[name]

    @property
    def x(self) -> Tensor:
        return self.part("x")

    @property
    def y(self) -> Tensor:
        return self.part("y")

    @property
    def z(self) -> Tensor:
        return self.part("z")

    def __iter__(self):
        return iter((self.x, self.y, self.z))

    def _replace(self, **parts: Tensor) -> Vec3:
        return Vec3(*self)._replace(**parts)

    __add__, __sub__, __mul__, __truediv__, __neg__ = (
        Vec3.__add__, Vec3.__sub__, Vec3.__mul__, Vec3.__truediv__, Vec3.__neg__)
    map, detach = Vec3.map, Vec3.detach


class ShadingFrame:
    """The shading frame around a unit normal, with lazily computed tangents.

    Args:
        n: the normal.
        along: direction of the first tangent, before it is made orthogonal to the normal. Where it is zero or parallel to
            the normal, or if it is None, the tangents are those of `Frame.of`.
        side: (N,) -1 where `n` has been turned round, else 1: of a frame with `along` only the normal turns, and both
            tangents stay. None: nowhere.
    """

    def __init__(self, n: Vec3, along: Vec3 | None = None, side: Tensor | None = None):
        self.n, self.along, self.side = n, along, side
        self.tangents: Frame | None = None

    @property
    def s(self) -> Vec3:
        return self.whole().s

    @property
    def t(self) -> Vec3:
        return self.whole().t

    def whole(self) -> Frame:
        if self.tangents is None:
            self.tangents = Frame.of(self.n) if self.along is None else Frame.along(self.n, self.along)
            if self.along is not None and self.side is not None:
                self.tangents = self.tangents._replace(t=self.tangents.t * self.side)
        return self.tangents

    def to_local(self, v: Vec3) -> LocalVec3:
        return LocalVec3(self, v)

    def to_world(self, v: Vec3) -> Vec3:
        return self.whole().to_world(v)
