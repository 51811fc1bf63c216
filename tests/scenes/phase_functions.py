"""Phase functions by name, as the attributes of their plugins; the first word of a name is the type."""

from __future__ import annotations

import torch

FLAKES = [0.9, 0.3, 0.5, 0.2, -0.1, 0.15]  # xx, yy, zz, xy, xz, yz of a positive definite matrix
SHEET = [0.04, 0.02, 1.0, 0.0, 0.03, 0.0]
TABLE = [0.2, 0.1, 0.0, 0.4, 1.5]
# With the mean of the cosine and of its square; of Henyey and Greenstein g, and 1/3 + 2/3 g^2.
BY_COSINE = {
    "isotropic": ({}, 0.0, 1 / 3), "rayleigh": ({}, 0.0, 0.4), "hg": ({}, 0.8, (1 + 2 * 0.64) / 3),
    "hg backwards": ({"g": -0.4}, -0.4, (1 + 2 * 0.16) / 3), "hg even": ({"g": 0.0}, 0.0, 1 / 3),
    "hg nearly even": ({"g": 9e-4}, 9e-4, 1 / 3), "hg sharp": ({"g": 0.9}, 0.9, (1 + 2 * 0.81) / 3),
    "tabphase of two": ({"values": "1, 3"}, 1 / 6, 1 / 3), "tabphase of three": ({"values": "0 1 0"}, 0.0, 1 / 6),
}
OTHERS = {
    "tabphase": {"values": TABLE}, "sggx": {"S": FLAKES}, "sggx of a sheet": {"S": SHEET},
    "sggx of a ball": {"S": [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]},
    "blendphase": {"weight": 0.3, "phase_0": {"type": "hg", "g": 0.5}, "phase_1": {"type": "sggx", "S": FLAKES}},
    "blendphase of a grid": {"weight": {"type": "gridvolume", "data": torch.linspace(0, 1, 8).reshape(2, 2, 2)},
                             "phase_0": {"type": "tabphase", "values": TABLE}, "phase_1": {"type": "isotropic"}},
    "blendphase of none": {"weight": 0.0, "phase_0": {"type": "isotropic"}, "phase_1": {"type": "hg"}},
}
CASES = {name: settings for name, (settings, *_) in BY_COSINE.items()} | OTHERS
