"""Scattering as Mitsuba 3.9.1 has it (`scalar_rgb`): live, and a few recorded figures.

`python -m tests.bsdf.reference` writes `recorded.json`.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from tests.scenes.materials import as_dict

FILE = Path(__file__).with_name("recorded.json")

# Materials under names of their own, and pairs of directions (wi, wo) as polar angle and azimuth in degrees.
MATERIALS = {
    "gold beckmann": {"type": "roughconductor", "material": "Au", "alpha": 0.3},
    "copper ggx": {"type": "roughconductor", "material": "Cu", "distribution": "ggx", "alpha_u": 0.1, "alpha_v": 0.4},
    "glass beckmann": {"type": "roughdielectric", "alpha": 0.25},
    "diamond ggx": {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.4, "int_ior": "diamond"},
}
PAIRS = (((30, 0), (30, 180)), ((60, 20), (50, 190)), ((85, 0), (70, 170)), ((30, 0), (160, 180)), ((150, 40), (130, 200)),
         ((160, 0), (30, 185)))


def unit(polar: float, azimuth: float) -> list[float]:
    """A direction from angles in degrees."""
    polar, azimuth = math.radians(polar), math.radians(azimuth)
    return [math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar)]


def by_mitsuba(description: dict, wi, wo) -> tuple[np.ndarray, np.ndarray]:
    """eval (N, 3) and pdf (N,) of a material for pairs of directions (N, 3)."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    bsdf, context = mi.load_dict(as_dict(description)), mi.BSDFContext()
    value, density = [], []
    for i, o in zip(wi, wo):
        si = mi.SurfaceInteraction3f()
        si.n, si.sh_frame, si.wi = [0, 0, 1], mi.Frame3f([0, 0, 1]), list(i)
        value.append(list(bsdf.eval(context, si, list(o))))
        density.append(bsdf.pdf(context, si, list(o)))
    return np.array(value), np.array(density)


def recorded() -> dict[str, np.ndarray]:
    """By material, rows of eval (three channels) and pdf, one for each of PAIRS."""
    return {name: np.array(rows) for name, rows in json.loads(FILE.read_text()).items()}


def record() -> None:
    """Writes what `recorded` reads."""
    figures = {}
    for name, description in MATERIALS.items():
        value, density = by_mitsuba(description, *([unit(*angles) for angles in side] for side in zip(*PAIRS)))
        figures[name] = [[float(f"{number:.6g}") for number in row] for row in np.column_stack([value, density])]
    materials = [f"  {json.dumps(name)}: [\n" + ",\n".join(f"    {row}" for row in rows) + "\n  ]"
                 for name, rows in figures.items()]
    FILE.write_text("{\n" + ",\n".join(materials) + "\n}\n")


if __name__ == "__main__":
    record()

# Their quadrature of what a rough coat lets through is right to 5e-4 for GGX, and enters twice.
ROUGH_COAT = 2e-3
