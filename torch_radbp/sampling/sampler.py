"""Counter-based random numbers: a pure function of (seed, sensor, pixel, sample, depth, dimension), and of how many samples
a pixel has.

Nothing is stored or restored for a replay, and results do not depend on chunk size, schedule or order of execution. All
arithmetic is in int32, which wraps in torch on every device. float32 and float64 renderings use the same 24 random bits, so
that both follow the same paths.

The samples of a film are points of low discrepancy. At every bounce, four dimensions at a time are the points of one
sequence, in an order that depends on the bounce, moved by a random shift that depends on bounce and dimension. Pixels take
them along a curve that passes through all of a square of 2^k x 2^k pixels before it leaves it, all samples of a pixel at
once: so the samples of a pixel are spread evenly, and those of its surroundings fill the gaps. What sums over pixels, as
gradients of what many of them see and images that are filtered or looked at from afar, is less noisy for it. Of samples
that are the derivative's alone neighbours are blocks of pixels: `call.view.view_of` says why.

The first two dimensions are those of Sobol': every 2^k samples leave no elementary interval of area 2^-k empty. The other
two form a lattice. Each number by itself, and all numbers of a path together, are distributed as if they were independent,
and so are those of different sensors and seeds. Independent samples use a single point, and a shift for each sample.

References: Sobol' 1967; Cranley and Patterson 1976 (shifts); Burley 2020, "Practical Hash-based Owen Scrambling" (orders);
Vegdahl 2021, "Building a Better LK Hash" (constants); Cools, Kuo and Nuyens 2006 (the lattice); Ahmed and Wonka 2020,
"Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error via Hierarchical Ordering of Pixels" (the curve).
"""

from __future__ import annotations

import functools
import hashlib
from typing import NamedTuple

import torch
from torch import Tensor

# Odd, from SHA-256 of "torch_radbp dimension <k>", first four bytes, little-endian, as signed integers.
MULTIPLIERS = tuple(
    int.from_bytes(hashlib.sha256(f"torch_radbp dimension {k}".encode()).digest()[:4], "little", signed=True) | 1
    for k in range(16))
SCRAMBLERS = (0x21F0AAAD, -0x2CA5D269)  # of `hash32`
LATTICE = (182667, 469891)  # of the third and fourth dimension
HALVES = ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF))  # distance and lower one
SPREAD = ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555))
INCREMENT = -0x61C88647  # of seeds, 2^32 over the golden ratio
APART = 1 << 31  # samples of a pixel with which each has a sequence of its own
DIMENSIONS_PER_BOUNCE = len(MULTIPLIERS)
LARGEST_NUMBER = 1.0 - 2.0**-24  # of all random numbers in [0, 1)


class SampleKey(NamedTuple):
    """The key of all random numbers of a call and sensor; () int32 each."""

    seed: Tensor  # from `seed_key`
    shared: Tensor  # -1: the lanes of a group share one low-discrepancy sequence; 0: they are independent


class FilmOrder(NamedTuple):
    """The order in which pixels of a film take points of one low-discrepancy sequence; () int32 each."""

    width: Tensor  # columns by which pixels are numbered
    bits: Tensor  # bits of the index of a sample in its pixel
    side: Tensor  # log2 of the side of a square, in pixels, in which no point is used twice
    inner: Tensor  # bits of the index of a pixel in its block, whose pixels are far apart in the sequence


class LaneKey(NamedTuple):
    """The key of all random numbers of a lane; (N,) int32 each."""

    shift: Tensor  # random shift: the same for all lanes of a group, or another for each
    point: Tensor  # bit-reversed index in the sequence: the first coordinate as a fraction of 2^32


class BounceKey(NamedTuple):
    """The key of the random numbers of a lane at one bounce; (N,) int32 each."""

    shift: Tensor  # random shift
    first: Tensor  # coordinates of the point
    second: Tensor


def hash32(x: Tensor) -> Tensor:
    """Scrambles int32 values so that each input bit flips each output bit with probability about one half.

    Reference: C. Wellons 2018, "Prospecting for Hash Functions" (`lowbias32`: constants 0x21f0aaad, 0xd35a2d97 of the
    later search, shifts 16, 15, 15).
    """
    x = (x ^ ((x >> 16) & 0xFFFF)) * SCRAMBLERS[0]
    x = (x ^ ((x >> 15) & 0x1FFFF)) * SCRAMBLERS[1]
    return x ^ ((x >> 15) & 0x1FFFF)


def seed_key(seed: int, sensor: int) -> int:
    """Folds a 64-bit seed and the index of a sensor into one int32."""
    folded = 0
    for part in (seed, seed >> 32, sensor + 1):
        folded = hash_of(folded + part)
    return folded - (folded >> 31 << 32)


def hash_of(x: int) -> int:
    """`hash32` of a Python number, of which the lowest 32 bits count; unsigned."""
    x &= 0xFFFFFFFF
    x = (x ^ x >> 16) * SCRAMBLERS[0] & 0xFFFFFFFF
    x = (x ^ x >> 15) * SCRAMBLERS[1] & 0xFFFFFFFF
    return x ^ x >> 15


def sample_key(seed: int, sensor: int, low_discrepancy: bool, device: torch.device) -> SampleKey:
    """The key of a call's random numbers for one sensor."""
    return SampleKey(*(torch.full((), value, dtype=torch.int32, device=device)
                       for value in (seed_key(seed, sensor), -int(low_discrepancy))))


@functools.lru_cache(maxsize=64)
def film_order(width: int, samples: int, device: torch.device, block: int = 1) -> FilmOrder:
    """The order in which the pixels of a film take points of a low-discrepancy sequence.

    Args:
        width: columns by which pixels are numbered.
        samples: of a pixel.
        device: of the tensors.
        block: a power of two. Pixels of a block of so many columns and rows are as good as independent of each other; those
            at the same place in neighbouring blocks take points that follow each other.
    """
    bits = max(0, samples - 1).bit_length()
    side = min(15, 16 - (bits + 1) // 2)  # so that no number of a pixel is negative
    with torch.inference_mode(False):  # they are kept, for renderings that are differentiated
        return FilmOrder(*(torch.full((), value, dtype=torch.int32, device=device)
                           for value in (width, bits, side, min(2 * (block.bit_length() - 1), 2 * side))))


def film_lane_key(order: FilmOrder, pixel: Tensor, sample: Tensor, key: SampleKey) -> LaneKey:
    """The random number keys of lanes, from pixel and sample indices.

    Blocks of pixels follow each other along a curve of Morton, so that those of every aligned square of 2^k x 2^k blocks
    take points that follow each other.

    Args:
        order: of the film.
        pixel, sample: (N,) int32, row-major number of the pixel on the film and number of the sample in it.
        key: of the call.
    """
    row = torch.div(pixel, order.width, rounding_mode="floor")
    column = pixel - row * order.width
    square = (row >> order.side << 16) + (column >> order.side)
    inside = (1 << order.side) - 1
    along = spread_bits(column & inside) + (spread_bits(row & inside) << 1)
    in_block = along & ((1 << order.inner) - 1)
    along = (along >> order.inner) + (in_block << (2 * order.side - order.inner))
    return lane_key(key, square, (along << order.bits) + sample)


def spread_bits(x: Tensor) -> Tensor:
    """Spreads the 16 lowest bits of int32 values, with a zero before each, as for Morton codes."""
    for distance, mask in SPREAD:
        x = (x | x << distance) & mask
    return x


def lane_key(key: SampleKey, group: Tensor, number: Tensor) -> LaneKey:
    """The random number keys of lanes, from the index of a point in a group's sequence.

    Args:
        key: of the call.
        group: (N,) int32; the lanes of a group take points of one sequence.
        number: (N,) int32, of the point in that.
    """
    ours = hash32(group) + key.seed
    return LaneKey(hash32(hash32(ours) + (hash32(number ^ 0x5BD1E995) & ~key.shared)), reversed_bits(number) & key.shared)


def reversed_bits(x: Tensor) -> Tensor:
    """Reverses the 32 bits of int32 values."""
    for distance, mask in HALVES:
        x = ((x >> distance) & mask) | ((x & mask) << distance)
    return x


def reordered(point: Tensor, order: Tensor) -> Tensor:
    """Scrambles the order of a sequence's points; any 2^k successive points from a multiple of 2^k on remain distinct.

    Each bit is flipped depending on all less significant bits, which belong to greater indices.

    Args:
        point: (N,) int32, bit-reversed indices.
        order: (N,) int32, random.
    """
    point = (point ^ (point * 0x3D20ADEA)) + order
    point = point * ((order >> 16) | 1)
    point = point ^ (point * 0x05526C56)
    return point ^ (point * 0x53A22864)


def second_coordinate(first: Tensor) -> Tensor:
    """The second coordinate of points of the Sobol' sequence, by Pascal's triangle modulo 2; fractions of 2^32."""
    for distance, mask in HALVES:
        first = first ^ ((first & mask) << distance)
    return first


def depth_counter(depth: int, device: torch.device) -> Tensor:
    """The counter of the random numbers at bounce `depth`, () int32."""
    return hash32(torch.tensor(depth + 1, dtype=torch.int32, device=device) ^ 0x3C6EF35F)


CAMERA_COUNTER = int(depth_counter(-1, torch.device("cpu")))  # the address of the random numbers that the camera draws


def bounce_key(key: LaneKey, counter: Tensor | int) -> BounceKey:
    """The random number keys of lanes at one bounce.

    Args:
        key: from `lane_key`.
        counter: () int32, from `depth_counter`, or `CAMERA_COUNTER`.
    """
    shift = hash32(key.shift + counter)
    first = reordered(key.point, shift)
    return BounceKey(shift, first, second_coordinate(first))


def random_bits(key: BounceKey, dimension: int) -> Tensor:
    """32 random bits per lane, int32; `unit` and `fine_unit` turn them into numbers in [0, 1).

    Four dimensions from a multiple of four on are the coordinates of one point. Their shifts are the coordinates of a point
    of a lattice of 2^32 points (a hash times odd multipliers, modulo 2^32): far finer than any number of samples resolves,
    at a quarter of the cost of a hash for each.

    Args:
        key: from `bounce_key`.
        dimension: less than `DIMENSIONS_PER_BOUNCE`.
    """
    shift, coordinate = key.shift * MULTIPLIERS[dimension], dimension % 4
    if coordinate < 2:
        return shift ^ (key.first, key.second)[coordinate]
    return torch.add(shift, key.first, alpha=LATTICE[coordinate - 2])


def unit(bits: Tensor, dtype: torch.dtype) -> Tensor:
    """Uniform numbers in [0, 1) from the 24 highest of the 32 random `bits`, the same in float32 and float64."""
    return torch.rsub((bits >> 8).to(dtype), 0.5, alpha=-1.0 / (1 << 24))  # 0.5 + (-2^23 to 2^23 - 1) / 2^24, exact


def fine_unit(bits: Tensor) -> Tensor:
    """Uniform float64 numbers in [0, 1) from all 32 random `bits`, fine enough to pick one of many entries."""
    return torch.rsub(bits.to(torch.float64), 0.5, alpha=-1.0 / (1 << 32))


def uniform(key: BounceKey, dimension: int, dtype: torch.dtype) -> Tensor:
    """Uniform numbers in [0, 1), one per lane: `unit` of `random_bits`."""
    return unit(random_bits(key, dimension), dtype)


def next_number(seed: Tensor, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """The next seeds of lanes, int32, and uniform numbers in [0, 1), (N,) each, for loops that take any number of them."""
    seed = hash32(seed + INCREMENT)
    return seed, unit(seed, dtype)
