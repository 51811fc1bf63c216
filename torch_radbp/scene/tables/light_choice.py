"""Light selection in scenes with many lights: by a tree, given the point to be illuminated.

An emitter is picked first, then one of its elements (triangles) by area. Emitters without a place of their own, or whose
light does not fall with distance (the surround, directional light, beams), stand beside the tree, and all that is in the
tree together counts as one of them.

The choice is a decision like the hit of a ray: it is made once, before the functions of the bounce run, and recorded. Its
probabilities carry no derivative, nor need they, in attached sampling either: where a surface point moves, they change for
next-event estimation and for the weight of what the BSDF finds alike, and whatever they are, the two add up to the same. So
it is enough that the derivative takes the same constants in both. (Inside of an emitter they do not depend on the point that
is met, which may move, too.)
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.emitter import EmittingTriangles, LightKind, Table
from torch_radbp.interface.emitter_bounds import LightBounds, bounds_of_groups
from torch_radbp.interface.texture import LUMINANCE, OutsideReader, TableReader, TexturePoint
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sampling.sampler import fine_unit
from torch_radbp.scene.tables.light_tree import LightTree, Vantage, chance_of_leaf, drawn_leaf, light_tree
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import leaves_of, tensors_in, with_leaves
from torch_radbp.tensors.vec import Vec2, Vec3, interpolated, where

CHOICES = ("uniform", "tree")
# Emitters with bounds from which on the tree is the default. With 8, noise times time is less than with a uniform choice, as
# the mean over pixels and as the median; with 4, the median is more (shadows of near lamps). See `benchmarks.lamps`, where
# surfaces are diffuse and samples independent. Importance knows nothing of the BSDF: on glossy surfaces it may do harm.
MANY = 8
LEAST_INTENSITY = 1e-2  # of the mean: a lamp that is dark has derivatives all the same
GRID = 4  # points along each side of a texture, and of a triangle, at which radiance is looked up for bounds
ALMOST_ONE = 1.0 - 2.0**-33


class Beside(NamedTuple):
    """The emitters that are not in the light tree, such as the environment, and the probabilities of selecting them."""

    share: Tensor  # () float64, probability of selecting one of them rather than the tree
    cumulative: Tensor  # (B,) float64
    pmf: Tensor  # (B,) of each among them
    emitter: Tensor  # (B,) int32


class TreeChoice(NamedTuple):
    """The distribution of E light elements, given the point to be illuminated, in scenes with a light tree."""

    pmf: Tensor  # (E,) probability of each element among those of its emitter
    cumulative: Tensor  # (E,) float64, number of the emitter plus the probability of its elements up to and with this one
    last: Tensor  # () int64, E - 1
    leaf: Tensor  # (E,) int32, leaf of the element's emitter
    tree: LightTree
    beside: Beside | None


class LightPick(NamedTuple):
    """The light selected at a bounce, and the probabilities of selection; (N,), detached."""

    element: Tensor  # int32, the element selected by next-event estimation
    pmf: Tensor  # the probability of its selection
    chance: Tensor  # the probability of selecting the emitter hit by the path, at the vertex before; 0: it has hit none


class LightNumbers(NamedTuple):
    """The random numbers of a light sample, (N,) int32 random bits each."""

    choice: Tensor  # selects an element
    split: Tensor  # decides between the element and its alias, or which element of an emitter it is
    u: Tensor  # the point on it
    v: Tensor


def drawn_element(choice: TreeChoice, seen: Vantage, numbers: LightNumbers) -> tuple[Tensor, Tensor]:
    """Samples a light element for each illuminated point by the tree, (N,) int32, with its probability."""
    u, beside = fine_unit(numbers.choice), choice.beside
    if beside is None:
        leaf, chance = drawn_leaf(choice.tree, seen, u)
        emitter = lookup(choice.tree.emitter, leaf)
    else:
        off, rest = u < beside.share, 1.0 - beside.share
        leaf, chance = drawn_leaf(choice.tree, seen, torch.where(off, 0.5, (u - beside.share) / rest))
        other = torch.searchsorted(beside.cumulative, torch.where(off, u / beside.share, 0.5).clamp_max(ALMOST_ONE),
                                   right=True)
        emitter = torch.where(off, lookup(beside.emitter, other), lookup(choice.tree.emitter, leaf))
        chance = torch.where(off, lookup(beside.pmf, other) * beside.share.to(chance.dtype), chance * rest.to(chance.dtype))
    element = torch.searchsorted(choice.cumulative, emitter + fine_unit(numbers.split), right=True)
    element = torch.minimum(element, choice.last).to(torch.int32)
    return element, chance * lookup(choice.pmf, element)


def chance_of_emitter(choice: TreeChoice, seen: Vantage, element: Tensor) -> Tensor:
    """The probability with which `drawn_element` selects the emitter of an element, (N,).

    Args:
        element: (N,) int32, any element of an emitter in the tree.
    """
    chance = chance_of_leaf(choice.tree, seen, lookup(choice.leaf, element))
    return chance if choice.beside is None else chance * (1.0 - choice.beside.share).to(chance.dtype)


def tree_choice(bounds: list[LightBounds | None], repeats: Tensor, sampling_weight: Tensor, within: Tensor,
                elements: list[Tensor]) -> TreeChoice:
    """Builds the distribution of a scene's light elements.

    Args:
        bounds: for each kind of light those of its elements, float64; None: not in the tree.
        repeats: (K,) int64, the number of elements of each emitter.
        sampling_weight: (K,) of the emitters, float64.
        within: (E,) weights of elements relative to others of their emitter; gives the dtype.
        elements: for each kind its elements, int64.
    """
    owner = torch.arange(len(repeats), device=repeats.device).repeat_interleave(repeats)
    in_tree = owner[torch.cat([element for each, element in zip(bounds, elements) if each is not None])]
    grouped = bounds_of_groups(_concatenated([each for each in bounds if each is not None]), in_tree, len(repeats))
    local = torch.zeros_like(sampling_weight, dtype=torch.bool)
    local[in_tree] = True
    intensity = grouped.intensity[local]
    floor = LEAST_INTENSITY * intensity.mean()
    intensity = torch.where(floor > 0, torch.maximum(intensity, floor), 1.0) * sampling_weight[local]
    inside = [part[local] if isinstance(part, Tensor) else part.map(lambda c: c[local]) for part in grouped]
    tree, place = light_tree(LightBounds(*inside)._replace(intensity=intensity / intensity.mean().clamp_min(1e-300)), within)
    number = local.nonzero().squeeze(1)
    leaf = torch.zeros(len(repeats), dtype=torch.int32, device=repeats.device)
    leaf[number] = place
    tree = tree._replace(emitter=number.to(torch.int32)[tree.emitter.long()])
    pmf, cumulative = within_emitters(within.double(), owner, repeats)
    return TreeChoice(pmf.to(within), cumulative, torch.tensor(len(owner) - 1, device=owner.device), leaf[owner], tree,
                      beside_tree(sampling_weight, local, within))


def within_emitters(weights: Tensor, owner: Tensor, repeats: Tensor) -> tuple[Tensor, Tensor]:
    """The probability of each element within its emitter, and its running sum plus the emitter's number; float64."""
    total = weights.new_zeros(len(repeats)).index_add_(0, owner, weights)
    pmf = torch.where(total[owner] > 0, weights / total[owner].clamp_min(1e-300), (1.0 / repeats.double())[owner])
    summed = running_sum(pmf)
    ends = repeats.cumsum(0)
    before = torch.cat([summed.new_zeros(1), summed[ends[:-1] - 1]])
    inside = (summed - before[owner]).clamp(0.0, 1.0)
    inside[ends - 1] = 1.0
    return pmf, owner + inside


def beside_tree(sampling_weight: Tensor, local: Tensor, like: Tensor) -> Beside | None:
    """The distribution of the emitters that are not in the tree; None: all are."""
    weights = sampling_weight[~local]
    if not bool(weights.any()):
        return None
    of_tree = sampling_weight[local]
    of_tree = of_tree[of_tree > 0].mean() if bool(of_tree.any()) else of_tree.new_zeros(())
    pmf = weights / weights.sum()
    cumulative = running_sum(pmf)
    cumulative[pmf.nonzero().max():] = 1.0
    return Beside(weights.sum() / (weights.sum() + of_tree), cumulative, pmf.to(like),
                  (~local).nonzero().squeeze(1).to(torch.int32))


def _concatenated(parts: list[LightBounds]) -> LightBounds:
    """Joins the bounds of several kinds of light."""
    columns = [torch.cat(column) for column in zip(*(leaves_of(part) for part in parts))]
    return with_leaves(parts[0], columns)


class EmitterTextures(NamedTuple):
    """The textures of all emitters of a scene, and how to read them."""

    reader: TableReader
    bank: Any
    outside: tuple[OutsideReader, ...]  # of those that are read outside of the functions of a bounce
    banks: tuple[Any, ...]


def bounds_of_kind(kind: LightKind, table: Table, textures: EmitterTextures, texture: Tensor,
                   outside: tuple[Tensor, ...]) -> LightBounds:
    """The bounds (position, direction, power) of the lights of one kind, float64, detached.

    Args:
        table: the lights of the kind.
        textures: of all emitters.
        texture: (rows,) int32, the texture of each light.
        outside: (rows,) int32 each, as `LightTable.outside`.
    """
    table, textures = (with_leaves(record, [leaf.detach() if isinstance(leaf, Tensor) else leaf
                                            for leaf in leaves_of(record)]) for record in (table, textures))
    return kind.bounds(table, mean_luminance(kind, table, textures, texture, outside))


def mean_luminance(kind: LightKind, table: Table, textures: EmitterTextures, texture: Tensor,
                   outside: tuple[Tensor, ...]) -> Tensor:
    """The luminance of each light's texture, float64: the mean over some points of the light."""
    places, reader = [(i + 0.5) / GRID for i in range(GRID)], textures.reader
    points = [(u, v) for u in places for v in places if not kind.on_surface or u + v < 1.0]
    if not reader.needs_uv and not reader.attributes and not outside:
        points = points[:1]
    row = torch.arange(len(texture), dtype=torch.int32, device=texture.device)
    total = torch.zeros(len(texture), dtype=torch.float64, device=texture.device)
    for u, v in points:
        p, point = point_on(table, row, u, v, reader)
        light = reader.read(textures.bank, texture, point)
        for other, bank, rows in zip(textures.outside, textures.banks, outside):
            with torch.no_grad():
                values = bank.values(rows, other.place(p, point.uv))
            light = where(rows >= 0, values, light)
        total += sum(factor * channel.double() for factor, channel in zip(LUMINANCE, light))
    return total / len(points)


def point_on(table: Table, row: Tensor, u: float, v: float, reader: TableReader) -> tuple[Vec3, TexturePoint]:
    """The points at the same u and v on each light, as world positions and as texture points.

    For lights that are not on surfaces the position is 0.
    """
    if isinstance(table, EmittingTriangles):
        like = table.inverse_area
        u, v = torch.full_like(like, u), torch.full_like(like, v)
        uv = None if table.uv is None else interpolated(lookup(table.uv, row), u, v)
        return interpolated(table.p, u, v), TexturePoint(uv, dict(zip(reader.attributes, table.attributes_at(row, u, v))))
    like = tensors_in(table)[0]
    like = like.new_zeros(len(row))
    zero = Vec3(like, like, like)
    return zero, TexturePoint(Vec2(like + u, like + v), {name: zero for name in reader.attributes})
