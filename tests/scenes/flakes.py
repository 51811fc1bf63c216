"""A ball of flakes under a sky that is brighter above, simulated by other means than those of the package.

    D(m) = 1 / (pi sqrt(det S) (m . S^-1 m)^2),    a(w) = sqrt(w . S w)

A path goes on by lengths of extinction a, and turns at a flake that reflects it: the flake's normal m is drawn from even
directions, and kept with a probability proportional to D(m) max(0, m . wi). Neither the listings of Heitz, Dupuy, Crassin
and Dachsbacher 2015, "The SGGX Microflake Distribution", nor a density of directions is used.
"""

from __future__ import annotations

import math

import numpy as np

import torch_radbp as rb

FLAKES = [0.9, 0.3, 0.5, 0.2, -0.1, 0.15]  # xx, yy, zz, xy, xz, yz of a positive definite matrix
EXTINCTION, ALBEDO, SLOPE = 2.0, 0.8, 0.9
DISTANCE, FOV = 4.0, 20.0  # of the camera
SKY_ROWS = 512  # between whose centres the sky is interpolated
MATRIX = np.array(FLAKES)[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]


def sky(up: np.ndarray) -> np.ndarray:
    """The radiance by the upward component of a direction."""
    return 1.0 + SLOPE * up


def sky_pixels() -> np.ndarray:
    """The same as an image, (H, W, 3), float32, that spans the sphere."""
    rows = sky(np.cos((np.arange(SKY_ROWS) + 0.5) / SKY_ROWS * math.pi))
    return np.repeat(rows[:, None, None], 2 * SKY_ROWS, 1).repeat(3, 2).astype(np.float32)


def ball(width: int, depth: int) -> dict:
    """The scene without its sky, for `rb.load_dict`, and, but for `S`, for Mitsuba."""
    medium = {"type": "homogeneous", "sigma_t": 1.0, "scale": EXTINCTION, "albedo": ALBEDO,
              "phase": {"type": "sggx", "S": FLAKES}}
    film = {"type": "hdrfilm", "width": width, "height": width, "rfilter": {"type": "box"}}
    return {"type": "scene", "integrator": {"type": "volpath", "max_depth": depth, "rr_depth": 1000},
            "camera": {"type": "perspective", "fov": FOV, "film": film,
                       "to_world": rb.look_at((0, 0, DISTANCE), (0, 0, 0), up=(0, 1, 0))},
            "ball": {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}}


def area(directions: np.ndarray) -> np.ndarray:
    """(N,) of (N, 3): the area of the flakes as seen along each."""
    return np.sqrt(np.einsum("ni,ij,nj->n", directions, MATRIX, directions))


def reflected(wi: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Directions, (N, 3), after a flake's reflection of `wi`, which point away from it, as the result does."""
    inverse, wo, left = np.linalg.inv(MATRIX), np.empty_like(wi), np.arange(len(wi))
    least = np.linalg.eigvalsh(inverse)[0]
    while len(left):
        normal = random.normal(size=(len(left), 3))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        cosine = (normal * wi[left]).sum(1)
        # D over the greatest D.
        relative = (least / np.einsum("ni,ij,nj->n", normal, inverse, normal))**2
        kept = random.random(len(left)) < relative * np.maximum(cosine, 0.0)
        wo[left[kept]] = (2.0 * cosine[:, None] * normal - wi[left])[kept]
        left = left[~kept]
    return wo


def simulated(paths: int, depth: int, seed: int) -> tuple[float, float]:
    """The mean of the image, and its standard error."""
    random = np.random.default_rng(seed)
    across = (2.0 * random.random((paths, 2)) - 1.0) * math.tan(math.radians(FOV / 2))
    d = np.concatenate([across, -np.ones((paths, 1))], 1)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    p = np.tile([0.0, 0.0, DISTANCE], (paths, 1))
    along = (p * d).sum(1)
    inside = along**2 - (DISTANCE**2 - 1.0)
    radiance = np.where(inside > 0.0, 0.0, sky(d[:, 1]))
    path, weight = np.nonzero(inside > 0.0)[0], 1.0
    p, d = p[path] - (along + np.sqrt(np.maximum(inside, 0.0)))[path, None] * d[path], d[path]
    for segment in range(1, depth + 1):
        along = (p * d).sum(1)
        left = np.sqrt(np.maximum(along**2 - (p * p).sum(1) + 1.0, 0.0)) - along
        length = random.exponential(size=len(path)) / (EXTINCTION * area(d))
        leaves = length >= left
        radiance[path[leaves]] = weight * sky(d[leaves, 1])
        p, d, path = (p + length[:, None] * d)[~leaves], d[~leaves], path[~leaves]
        if segment < depth:
            d, weight = reflected(-d, random), weight * ALBEDO
    return float(radiance.mean()), float(radiance.std() / math.sqrt(paths))
