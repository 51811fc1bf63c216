"""Counter-based random numbers: a pure function of (seed, sensor, pixel, sample, depth, dimension).

Nothing is stored or restored for a replay, and results do not depend on chunk size, schedule or order of execution. The
generator is an integer hash in int32 arithmetic, which wraps in torch on every device. float32 and float64 renderings use
the same 24 random bits, so that both follow the same paths.
"""

from __future__ import annotations

import hashlib

import torch
from torch import Tensor

# Odd, from SHA-256 of "torch_radbp dimension <k>", first four bytes, little-endian, as signed integers.
MULTIPLIERS = tuple(
    int.from_bytes(hashlib.sha256(f"torch_radbp dimension {k}".encode()).digest()[:4], "little", signed=True) | 1
    for k in range(16))
DIMENSIONS_PER_BOUNCE = len(MULTIPLIERS)
CAMERA_DEPTH = -1  # the depth under which the camera draws its numbers


def hash32(x: Tensor) -> Tensor:
    """Scrambles int32 values so that each input bit flips each output bit with probability about one half.

    Reference: C. Wellons 2018, "Prospecting for Hash Functions" (`lowbias32`: constants 0x21f0aaad, 0xd35a2d97 of the
    later search, shifts 16, 15, 15).
    """
    x = (x ^ ((x >> 16) & 0xFFFF)) * 0x21F0AAAD
    x = (x ^ ((x >> 15) & 0x1FFFF)) * -0x2CA5D269
    return x ^ ((x >> 15) & 0x1FFFF)


def seed_key(seed: int, sensor: int) -> int:
    """Folds a 64-bit seed and the index of a sensor into one int32."""
    folded = torch.tensor([seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF, sensor + 1], dtype=torch.int64)
    low, high, sensor_key = folded.to(torch.int32)
    return int(hash32(hash32(hash32(low) + high) + sensor_key))


def lane_key(seed: Tensor, pixel: Tensor, sample: Tensor) -> Tensor:
    """The int32 key of each lane's random numbers."""
    return hash32(hash32(hash32(pixel) + seed) + hash32(sample ^ 0x5BD1E995))


def depth_counter(depth: int, device: torch.device) -> Tensor:
    """() int32: the address of the random numbers that bounce `depth` draws."""
    return hash32(torch.tensor(depth + 1, dtype=torch.int32, device=device) ^ 0x3C6EF35F)


def bounce_key(key: Tensor, counter: Tensor) -> Tensor:
    """The int32 key of each lane's random numbers at one bounce.

    Args:
        key: (N,) int32, from `lane_key`.
        counter: () int32, from `depth_counter`.
    """
    return hash32(key + counter)


def uniform(key: Tensor, dimension: int, dtype: torch.dtype) -> Tensor:
    """Uniform numbers in [0, 1), one per lane.

    The dimensions of a bounce are the coordinates of one point of a lattice of 2^32 points (key times an odd multiplier,
    modulo 2^32), picked by a hash: far finer than any number of samples resolves, and a quarter of the work of a hash each.

    Args:
        key: (N,) int32, from `bounce_key`.
        dimension: less than `DIMENSIONS_PER_BOUNCE`.
        dtype: of the result.
    """
    bits = ((key * MULTIPLIERS[dimension]) >> 8).to(dtype)  # -2^23 to 2^23 - 1
    return torch.rsub(bits, 0.5, alpha=-1.0 / (1 << 24))  # 0.5 + bits / 2^24, exact
