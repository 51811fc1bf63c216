"""Scattering as Mitsuba 3.9.1 has it (`scalar_rgb`): live, and a few recorded figures.

`python -m tests.bsdf.reference` prints `RECORDED`.
"""

from __future__ import annotations

import math

import numpy as np

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
    description = {name: {"type": "rgb", "value": value} if isinstance(value, list) else value
                   for name, value in description.items()}
    bsdf, context = mi.load_dict(description), mi.BSDFContext()
    value, density = [], []
    for i, o in zip(wi, wo):
        si = mi.SurfaceInteraction3f()
        si.n, si.sh_frame, si.wi = [0, 0, 1], mi.Frame3f([0, 0, 1]), list(i)
        value.append(list(bsdf.eval(context, si, list(o))))
        density.append(bsdf.pdf(context, si, list(o)))
    return np.array(value), np.array(density)


# Material: rows of eval (three channels) and pdf, one for each of PAIRS.
RECORDED = {
    "gold beckmann": (
        (0.986692, 0.818448, 0.333021, 1.02098),
        (1.38, 1.14831, 0.506412, 1.43215),
        (1.27169, 1.12635, 0.690491, 1.33465),
        (0, 0, 0, 0),
        (0, 0, 0, 0),
        (0, 0, 0, 0),
    ),
    "copper ggx": (
        (2.1825, 1.4209, 1.17226, 2.29529),
        (1.97083, 1.2929, 1.08668, 2.09009),
        (1.06984, 0.79066, 0.719068, 1.16431),
        (0, 0, 0, 0),
        (0, 0, 0, 0),
        (0, 0, 0, 0),
    ),
    "glass beckmann": (
        (0.0618485, 0.0618485, 0.0618485, 0.0618485),
        (0.127945, 0.127945, 0.127945, 0.127945),
        (0.264292, 0.264292, 0.264292, 0.264465),
        (15.5107, 15.5107, 15.5107, 35.0941),
        (0.147457, 0.147457, 0.147457, 0.147457),
        (29.1071, 29.1071, 29.1071, 12.8647),
    ),
    "diamond ggx": (
        (0.0971521, 0.0971521, 0.0971521, 0.0984307),
        (0.133478, 0.133478, 0.133478, 0.140673),
        (0.184211, 0.184211, 0.184211, 0.228961),
        (0.527735, 0.527735, 0.527735, 3.10263),
        (0.340625, 0.340625, 0.340625, 0.358986),
        (2.80063, 2.80063, 2.80063, 0.485181),
    ),
}


def record() -> None:
    """Prints `RECORDED`."""
    print("RECORDED = {")
    for name, description in MATERIALS.items():
        value, density = by_mitsuba(description, *([unit(*angles) for angles in side] for side in zip(*PAIRS)))
        print(f'    "{name}": (')
        for row in np.column_stack([value, density]):
            print(f"        ({', '.join(f'{number:.6g}' for number in row)}),")
        print("    ),")
    print("}")


if __name__ == "__main__":
    record()
