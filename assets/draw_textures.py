"""Draws the textures of the scenes with numpy: ``python assets/draw_textures.py``.

Every picture is a formula of this file, so it has no other origin; colours are evaluated on a 4 x 4 finer grid and
averaged.
"""

from pathlib import Path

import numpy as np
import torch
from PIL import Image

import torch_radbp as rb

ASSETS = Path(__file__).parent
SUPERSAMPLING = 4


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Sample points (u, v) in [0, 1]^2 of a picture with ``size`` pixels a side, v = 0 at the bottom."""
    n = size * SUPERSAMPLING
    line = (np.arange(n) + 0.5) / n
    return np.broadcast_to(line, (n, n)), np.broadcast_to(1 - line[:, None], (n, n))


def smooth_noise(size: int, cells: int, seed: int) -> np.ndarray:
    """Bicubically enlarged random numbers of about [-1, 1], tileable neither way, at the supersampled resolution."""
    coarse = np.random.default_rng(seed).uniform(-1, 1, (cells, cells)).astype(np.float32)
    n = size * SUPERSAMPLING
    return np.asarray(Image.fromarray(coarse).resize((n, n), Image.Resampling.BICUBIC))


def save(name: str, srgb: np.ndarray) -> None:
    """Averages the supersampled picture down and writes it as an 8 bit sRGB PNG."""
    s = SUPERSAMPLING
    n = srgb.shape[0] // s
    small = srgb.reshape(n, s, n, s, 3).mean(axis=(1, 3))
    Image.fromarray((small.clip(0, 1) * 255 + 0.5).astype(np.uint8)).save(ASSETS / name, optimize=True)


def painting(size: int = 64) -> np.ndarray:
    """An evening by the sea: banded sky, sun, hills, a sail and the sun's path on the water."""
    u, v = grid(size)
    sky = np.stack([0.95 - 0.55 * v, 0.62 - 0.25 * v + 0.1 * np.sin(14 * v + 2 * u), 0.30 + 0.45 * v], -1)
    sun = np.hypot(u - 0.66, v - 0.62)
    sky = np.where((sun < 0.13)[..., None], [1.0, 0.93, 0.55], sky + 0.25 * np.exp(-10 * sun)[..., None])
    hills = [
        (0.50 + 0.10 * np.sin(5.0 * u + 0.6) + 0.02 * np.sin(23 * u), [0.42, 0.30, 0.48]),
        (0.42 + 0.09 * np.sin(7.5 * u + 3.4) + 0.015 * np.sin(31 * u), [0.22, 0.34, 0.36]),
    ]
    picture = sky
    for ridge, colour in hills:
        picture = np.where((v < ridge)[..., None], np.asarray(colour) + 0.12 * (ridge - v)[..., None], picture)
    glitter = np.exp(-(((u - 0.66) / (0.05 + 0.25 * (0.36 - v).clip(0))) ** 2)) * (np.sin(90 * v) > 0)
    sea = np.stack([0.10 + 0.85 * glitter, 0.26 + 0.25 * v + 0.55 * glitter, 0.40 + 0.4 * v + 0.1 * glitter], -1)
    picture = np.where((v < 0.36)[..., None], sea, picture)
    sail = (v > 0.20) & (v < 0.56) & (u > 0.24) & (u < 0.24 + 0.40 * (0.56 - v))
    hull = (v > 0.13) & (v < 0.185) & (abs(u - 0.30) < 0.13 - 0.6 * (0.185 - v))
    picture = np.where(sail[..., None], [0.96, 0.95, 0.90], picture)
    picture = np.where(hull[..., None], [0.55, 0.13, 0.10], picture)
    frame = np.maximum(abs(u - 0.5), abs(v - 0.5)) > 0.46
    return np.where(frame[..., None], [0.52, 0.38, 0.16], picture)


def plaster(size: int = 64) -> np.ndarray:
    """Warm plaster: three octaves of smooth noise and a faint stripe."""
    u, _ = grid(size)
    tone = sum(0.05 / 2**k * smooth_noise(size, 4 * 2**k, seed=k) for k in range(3)) + 0.03 * np.sin(40 * u)
    return np.asarray([0.86, 0.82, 0.74]) + tone[..., None]


def parquet(size: int = 64) -> np.ndarray:
    """Two by two fields of four boards each, alternately across and along; tileable."""
    u, v = grid(size)
    column, row = (2 * u).astype(int), (2 * v).astype(int)
    across = (column + row) % 2 == 0
    along_board, over_board = np.where(across, 2 * u % 1, 2 * v % 1), np.where(across, 2 * v % 1, 2 * u % 1)
    board = (4 * over_board).astype(int)
    shade = np.random.default_rng(9).uniform(0.75, 1.1, (2, 2, 4))[row, column, board]
    grain = 0.05 * np.sin(6 * along_board + 60 * over_board)
    joint = (4 * over_board % 1 < 0.06) | (along_board < 0.015)
    wood = np.asarray([0.62, 0.42, 0.25]) * (shade + grain)[..., None]
    return np.where(joint[..., None], [0.16, 0.10, 0.06], wood)


def patches(size: int = 64) -> np.ndarray:
    """Soft patches of all colours, coarse and fine, without an edge: what a pose can be found by from afar and from near."""
    u, v = grid(size)
    waves = [
        np.sin(9 * u + 4 * v + 1) * np.sin(7 * v - 3 * u),
        np.sin(8 * v + 2) * np.cos(10 * u - 5 * v),
        np.sin(12 * u * v + 9 * u),
    ]
    noise = [smooth_noise(size, 7, seed=20 + k) + 0.5 * smooth_noise(size, 14, seed=30 + k) for k in range(3)]
    return np.stack([0.55 + 0.2 * wave + 0.22 * rough for wave, rough in zip(waves, noise)], -1)


def sky(height: int = 16) -> torch.Tensor:
    """Radiance by latitude and longitude: a dusk with a broad sun, a lit window, clouds, and ground below."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    up = np.cos(np.pi * v)[..., None]
    air = np.where(up > 0, [0.25, 0.4, 0.75] + 0.5 * np.exp(-4 * up) * np.array([1.4, 0.6, 0.0]), [0.16, 0.12, 0.08])
    cloud = 0.3 * np.sin(4 * np.pi * u + 9 * v).clip(0) * np.sin(np.pi * v) ** 2 * (v < 0.5)
    sun = 6 * np.exp(-((u - 0.3) / 0.035) ** 2 - ((v - 0.3) / 0.07) ** 2)
    window = (abs(u - 0.77) < 0.06) & (abs(v - 0.55) < 0.13)
    colours = air + cloud[..., None] + sun[..., None] * [1.0, 0.8, 0.5] + window[..., None] * [0.4, 1.2, 0.9]
    return torch.from_numpy(colours.astype(np.float32))


def relief(size: int = 32) -> torch.Tensor:
    """Normals n of a shield with a rim, bosses and ripples, as colours (n + 1) / 2, the slopes of a smooth height."""
    x, y = np.meshgrid((np.arange(size) + 0.5) / size * 2 - 1, 1 - (np.arange(size) + 0.5) / size * 2)
    radius = np.hypot(x, y)
    height = 0.1 * np.exp(-((radius - 0.75) / 0.12) ** 2) + 0.025 * np.sin(9 * x + 4 * y) * np.exp(-2 * radius**2)
    for turn in range(5):
        angle = 2 * np.pi * turn / 5 + 0.3
        height += 0.09 * np.exp(-((x - 0.4 * np.cos(angle)) ** 2 + (y - 0.4 * np.sin(angle)) ** 2) / 0.02)
    rows, columns = np.gradient(height, 2 / size)
    normals = np.stack([-columns, rows, np.ones_like(x)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return torch.from_numpy((0.5 + 0.5 * normals).astype(np.float32))


def water(size: int = 32) -> torch.Tensor:
    """Heights of a plate of glass as of water, flatter towards its corners, that add to zero."""
    x, y = np.meshgrid((np.arange(size) + 0.5) / size * 2 - 1, (np.arange(size) + 0.5) / size * 2 - 1)
    waves = np.sin(4 * x + 2 * y + 1) * np.sin(5 * y - 3 * x) + 0.5 * np.sin(9 * x * y + 3 * x) + 0.3 * np.cos(7 * y + 4 * x)
    heights = 0.004 * waves * (1 - 0.5 * (x**2 + y**2))
    return torch.from_numpy((heights - heights.mean()).astype(np.float32))


if __name__ == "__main__":
    for picture in (painting, plaster, parquet):
        save(f"textured_room/{picture.__name__}.png", picture())
    save("patches.png", patches())
    rb.save_image(ASSETS / "lit_balls" / "sky.exr", sky().movedim(-1, 0))
    rb.save_image(ASSETS / "relief" / "normals.exr", relief().movedim(-1, 0))
    rb.save_image(ASSETS / "relief" / "flat.exr", torch.tensor([0.5, 0.5, 1.0])[:, None, None].expand(3, 32, 32))
    rb.save_image(ASSETS / "caustic" / "heights.exr", water()[None])
