"""Materials evaluated and sampled outside of any scene."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.contract import CheckedKind
from torch_radbp.interface.bsdf import Kind, LobeChoice, Values
from torch_radbp.interface.texture import TexturePoint, TriangleEdges
from torch_radbp.plugin import BSDF, Texture
from torch_radbp.tensors.vec import Vec2, Vec3, dot, normalize
from torch_radbp.texture.bitmap import reader_of

ATTRIBUTE = 0.5  # what attributes of meshes are, since there is no mesh
FINE = -30.0  # logarithm of a footprint without extent


class LaneNumbers(NamedTuple):
    """The random numbers of a BSDF sample."""

    choice: Tensor
    u: Tensor
    v: Tensor


def random_numbers(count: int, seed: int = 7, dtype: torch.dtype = torch.float64) -> LaneNumbers:
    """Random numbers of BSDF samples: uniform in [0, 1), multiples of 2^-24 as in the path tracer."""
    generator = torch.Generator().manual_seed(seed)
    return LaneNumbers(*(torch.randint(2**24, (3, count), generator=generator).to(dtype) / 2**24).unbind())


def directions(count: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Vec3:
    """Random directions, uniform on the sphere."""
    generator = torch.Generator().manual_seed(seed)
    return normalize(Vec3.of(torch.randn(count, 3, generator=generator, dtype=torch.float64))).map(lambda c: c.to(dtype))


def direction(z: float, phi: float, count: int, dtype: torch.dtype = torch.float64) -> Vec3:
    """One direction, by its cosine and azimuth, repeated on every lane."""
    r = math.sqrt(max(1.0 - z * z, 0.0))
    return Vec3(*(torch.full((count,), float(c), dtype=dtype) for c in (r * math.cos(phi), r * math.sin(phi), z)))


class SampledDirection(NamedTuple):
    """A sampled BSDF lobe and direction."""

    choice: LobeChoice
    wo: Vec3


def sampled(kind: Kind | CheckedKind, values: Values, wi: Vec3, random: LaneNumbers) -> SampledDirection:
    """Samples a lobe and a direction."""
    choice = kind.choose(values, wi, *random)
    return SampledDirection(choice, kind.sample(values, wi, choice, random.u, random.v))


def choices(kind: Kind | CheckedKind, values: Values, wi: Vec3, random: LaneNumbers, most: int = 64) -> list[LobeChoice]:
    """The lobes that random numbers choose on some lane, one after the other, with their probabilities, which may be zero.

    `most`: the number of lobes after which it ends, should their probabilities not add up to 1.
    """
    chosen, last = [], torch.zeros_like(random.choice)
    while (open_ := last < 1 - 1e-9).any() and len(chosen) < most:
        choice = kind.choose(values, wi, last + 1e-12, random.u, random.v)
        chosen.append(choice._replace(probability=torch.where(open_, choice.probability, 0.0)))
        last = last + chosen[-1].probability
    return chosen


def weight_of(kind: Kind | CheckedKind, values: Values, wi: Vec3, sample: SampledDirection) -> Vec3:
    """The path throughput factor of a sampled direction; 0 where the direction is invalid.

    That is eval / pdf, or of delta lobes specular / probability.
    """
    weight = Vec3.full(wi.z, 0.0)
    if kind.smooth:
        value, pdf = kind.eval_pdf(values, wi, sample.wo)
        weight = value * torch.where(pdf > 0, 1.0 / torch.where(pdf > 0, pdf, 1.0), 0.0)
    if kind.delta:
        ideal = kind.specular(values, wi, sample.choice) * (1.0 / sample.choice.probability)
        delta = sample.choice.is_delta(kind)
        weight = Vec3(*(torch.where(delta, a, b) for a, b in zip(ideal, weight)))
    return weight


def values_at(bsdf: BSDF, place: tuple[float, float, float], like: Tensor) -> Values:
    """The parameters of a material at one surface point, on every lane; attached.

    Args:
        bsdf: its parameters have the dtype and the device of `like`.
        place: surface coordinates u and v, and for textures of positions x, y and z.
        like: (N,) gives the number of lanes.
    """
    return tuple(texture_at(texture, Vec3(*(torch.full_like(like, c) for c in place))) for texture in bsdf.textures())


def texture_at(texture: Texture, p: Vec3) -> Vec3:
    """A texture on a plane with u = x and v = y; attached to the point as well.

    Attributes of meshes are 0.5 there.
    """
    reader, dtype, device = reader_of(texture), p.x.dtype, p.x.device
    zero, one = torch.zeros_like(p.x), torch.ones_like(p.x)
    uv, across, along = Vec2(p.x, p.y), Vec3(one, zero, zero), Vec3(zero, one, zero)
    of_mesh = {name: Vec3.full(p.x, ATTRIBUTE) for name in reader.attributes}
    level = {name: (Vec3.full(p.x, 0.0),) * 2 for name in reader.attributes}
    point = TexturePoint(uv, of_mesh, TriangleEdges((across, along), (Vec2(one, zero), Vec2(zero, one)), level,
                                                    (across, along)), torch.full_like(p.x, FINE), p)
    if reader.outside:
        return reader.value(Vec3.of(texture.function()(reader.place(p, uv).stack())), point)
    return reader.read(reader.bank([texture], dtype, device), torch.zeros_like(p.x, dtype=torch.int32), point)


def unit_length_error(w: Vec3) -> float:
    """The largest deviation of squared lengths from one; 0 if there is no vector."""
    return float((dot(w, w) - 1.0).abs().max()) if len(w.x) else 0.0
