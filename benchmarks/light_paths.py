"""Images by paths from the lamps beside Mitsuba 3.9.1's `ptracer`: ``python -m benchmarks.light_paths``.

Needs mitsuba==3.9.1. Every kind of lamp, materials and cameras: a ball hangs over the camera, which looks down at the floor.
So all that is in view is diffuse, and lacks nothing in `ptracer`, which shows no glass and no mirrors; the light of the ball
is on the floor. Each side renders independent batches from the same description, Mitsuba in `llvm_ad_rgb`, both without
Russian roulette. The third image is that of paths from the camera, ours, where these find all light.

    z        difference of the image's mean in standard errors of both sides, of the colour where it is greatest
    bias     the same, relative, with its standard error
    blocks   greatest difference of a block of 4 x 4 pixels in standard errors
    verdict  equal: |z| < 4 and blocks < 5, against both, but for what `ptracer` is known to lack

At orthographic cameras Mitsuba's paths cannot end (its issue 198). At a principal point off the axis its image lacks what is
beyond the film around the axis: its own path tracer shows what we do, so that there paths from the camera judge alone. A
thin lens has its focus at 1, as Mitsuba puts points in a wrong place at any other distance (its issue 1508). Images that
differ are rendered once more, by 8 times the paths.

    python -m benchmarks.light_paths --only "area,glass;bumps"
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any, NamedTuple

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.media_derivatives import translated
from benchmarks.parity import PEER_SEED
from benchmarks.peers import mitsuba_for
from benchmarks.scenes.description import NO_ROULETTE
from tests.light_paths.scenes import LAMPS
from tests.peer.agreement import pool
from tests.scenes import diffuse, overhead, rectangle, rgb, sensor, texels

AGAIN = 8  # times the paths, where images differ: rare bright paths follow no normal law
SIZE, DEPTH, BATCHES, PATHS, SEEDS_OF_A_ROW = 16, 5, 16, 4e6, 100
BLOCK = 4  # pixels a side
FARTHEST, FARTHEST_BLOCK = 4.0, 5.0  # standard errors
GLASS = {"type": "dielectric"}
FLAT = np.full((4, 4, 3), 0.5, np.float32) + np.array([0.1, 0.05, 0.4], np.float32)  # a tangent frame's normal, as a colour
MATERIALS: dict[str, dict[str, Any]] = {
    "diffuse": diffuse(0.7, 0.6, 0.8),
    "glass": GLASS,
    "mirror": {"type": "conductor", "material": "Au"},
    "plastic": {"type": "plastic"},
    "rough glass": {"type": "roughdielectric", "alpha": 0.2},
    "rough mirror": {"type": "roughconductor", "alpha": 0.2},
    "rough plastic": {"type": "roughplastic", "alpha": 0.2},
    "thin glass": {"type": "thindielectric"},
    "half glass": {"type": "principled", "base_color": rgb(0.6, 0.3, 0.2), "roughness": 0.4, "spec_trans": 0.5},
    "bumps": {"type": "bumpmap", "arbitrary": {"type": "bitmap", "data": texels(8, 8), "raw": True}, "scale": 0.2,
              "bsdf": diffuse(0.5, 0.6, 0.7)},
    "normal map": {"type": "normalmap", "normalmap": {"type": "bitmap", "data": FLAT, "raw": True},
                   "bsdf": {"type": "roughconductor", "alpha": 0.3}},
    "blend": {"type": "blendbsdf", "weight": 0.4, "bsdf_0": GLASS, "bsdf_1": diffuse(0.5, 0.6, 0.7)},
    "mask": {"type": "mask", "opacity": 0.5, "bsdf": {"type": "conductor"}},
    "two sides": {"type": "twosided", "bsdf": {"type": "roughconductor", "alpha": 0.3}},
}
LIGHTS = LAMPS | {"sunsky": {"type": "sunsky", "sun_direction": [0.3, 0.2, 0.9]}}
OFF_AXIS, ORTHOGRAPHIC = "off its axis", "orthographic"  # `ptracer` is wrong for one, and lacks the other
CAMERAS: dict[str, dict[str, Any]] = {
    "perspective": {},
    OFF_AXIS: {"principal_point_offset_x": 0.1, "principal_point_offset_y": -0.05},
    "thinlens": {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 1.0},
    ORTHOGRAPHIC: {},
}
PLAIN = ("diffuse", "glass", "mirror", "plastic", "rough mirror")  # under each lamp
SMALL = ("point", "spot", "projector", "directional", "directionalarea", "sunsky")  # have caustics of their own
IDEAL = {"glass", "mirror", "plastic", "thin glass", "blend", "mask"}


class Row(NamedTuple):
    """What an image is made of."""

    lamp: str
    material: str
    camera: str

    def __str__(self) -> str:
        return ", ".join(self)

    @property
    def found_from_the_camera(self) -> bool:
        """True if paths from the camera find all light."""
        return self.lamp != "directionalarea" and not (self.lamp in SMALL and self.material in IDEAL)


def rows() -> list[Row]:
    """Each lamp with plain materials, the cameras in turn; the other materials under two lamps; each camera once more."""
    cameras = [camera for camera in CAMERAS if camera not in (OFF_AXIS, ORTHOGRAPHIC)]
    pairs = [(lamp, material) for lamp in LIGHTS for material in PLAIN]
    pairs += [(lamp, material) for material in MATERIALS if material not in PLAIN for lamp in ("point", "area")]
    found = [Row(*pair, cameras[number % len(cameras)]) for number, pair in enumerate(pairs)]
    return found + [Row(lamp, "rough mirror", camera) for camera in (OFF_AXIS, ORTHOGRAPHIC)
                    for lamp in ("point", "area", "envmap")]



def described(row: Row) -> dict[str, Any]:
    """The scene of a row, for both sides."""
    camera = overhead(SIZE, 1.0, 0.9) if row.camera == ORTHOGRAPHIC else sensor(SIZE, (0, 0, 1), (0, 0, 0), 80)
    ball = {"type": "sphere", "center": [0.1, 0.0, 1.7], "radius": 0.4, "bsdf": MATERIALS[row.material]}
    return {"type": "scene", "camera": camera | CAMERAS[row.camera], "ball": ball, "lamp": LIGHTS[row.lamp],
            "floor": rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4))}


def of_mitsuba(value: Any) -> Any:
    """A description in which texels have Mitsuba's name."""
    if not isinstance(value, dict):
        return value
    return {"bitmap" if key == "data" else key: of_mitsuba(part) for key, part in value.items()}


def images(row: Row, spp: int, seed: int) -> dict[str, list[np.ndarray]]:
    """Batches of images, (H, W, 3), by who has rendered them."""
    scene = rb.load_dict(described(row) | {"integrator": {"type": "path", "max_depth": DEPTH, "rr_depth": NO_ROULETTE}})
    found = {}
    for light_paths in ("all", "camera") if row.found_from_the_camera else ("all",):
        renderer = rb.Renderer(scene, spp=spp, light_paths=light_paths)
        with torch.no_grad():
            found[light_paths] = [renderer(seed=seed + BATCHES * len(found) + batch)[0].permute(1, 2, 0).numpy()
                                  for batch in range(BATCHES)]
    if row.camera == ORTHOGRAPHIC:
        return found
    mi = mitsuba_for("cpu")
    theirs = mi.load_dict(translated(mi, of_mitsuba(described(row))))
    integrator = mi.load_dict({"type": "ptracer", "max_depth": DEPTH, "rr_depth": NO_ROULETTE})
    found["ptracer"] = [np.array(mi.render(theirs, integrator=integrator, spp=spp, seed=PEER_SEED + seed + batch))[..., :3]
                        for batch in range(BATCHES)]
    return found


def compared(ours: list[np.ndarray], others: list[np.ndarray]) -> tuple[list[str], bool]:
    """Cells of the table, and whether two sets of images agree."""
    def means(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of blocks: difference, its standard error, and the others' mean."""
        parts = [np.stack([pool(image.astype(np.float64), size) for image in side]) for side in (ours, others)]
        error = np.sqrt(sum(part.var(0, ddof=1) for part in parts) / BATCHES)
        return parts[0].mean(0) - parts[1].mean(0), np.maximum(error, 1e-5 * parts[1].mean(0) + 1e-12), parts[1].mean(0)

    difference, error, mean = (each[0, 0] for each in means(SIZE))
    worst = int(abs(difference / error).argmax())
    z, bias, bias_error = (each[worst] for each in (difference / error, difference / mean, error / mean))
    blocks, errors, _ = means(BLOCK)
    farthest = float(abs(blocks / errors).max())
    return ([f"{z:+.1f}", f"{100 * bias:+.2f}% +- {100 * bias_error:.2f}%", f"{farthest:.1f}"],
            bool(abs(z) < FARTHEST and farthest < FARTHEST_BLOCK))


def measured(row: Row, spp: int, seed: int) -> tuple[str, bool]:
    """A line of the table, and whether all agree."""
    sides, cells, agree = images(row, spp, seed), [], True
    for other in ("ptracer", "camera"):
        shown, equal = compared(sides["all"], sides[other]) if other in sides else (["-"] * 3, True)
        cells, agree = cells + shown, agree and (equal or (other == "ptracer" and row.camera == OFF_AXIS))
    return f"| {' | '.join([str(row), *cells, 'equal' if agree else '**differs**'])} |", agree


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="parts of names, with semicolons between")
    parser.add_argument("--paths", type=float, default=PATHS, help="of each side, for each image")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    chosen = [row for row in rows() if any(part in str(row) for part in options.only.split(";"))]
    spp, agree = max(1, round(options.paths / (BATCHES * SIZE**2))), 0
    print("| lamp, material, camera | z, ptracer | bias | blocks | z, paths from the camera | bias | blocks | verdict |\n"
          "|---|---|---|---|---|---|---|---|", flush=True)
    for number, row in enumerate(chosen):
        line, equal = measured(row, spp, options.seed + SEEDS_OF_A_ROW * number)
        print(line, flush=True)
        if not equal:
            line, equal = measured(row, AGAIN * spp, options.seed + SEEDS_OF_A_ROW * number + 2 * BATCHES)
            print(f"{line} {AGAIN} times the paths", flush=True)
        agree += equal
    print(f"{agree} of {len(chosen)} agree")


if __name__ == "__main__":
    main()
