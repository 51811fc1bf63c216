"""Renders the target images of the asset scenes with Mitsuba, which this project did not write.

    python assets/make_targets.py            # needs mitsuba==3.9.1; LLVM for speed, else minutes in scalar_rgb

Each target is the scene file as it stands, true reflectances included, averaged over independent passes.
"""

import argparse
from pathlib import Path

import mitsuba as mi
import numpy as np

ASSETS = Path(__file__).parent
# file -> (scene, resolution, samples per pixel[, sensor]); the noise is far below the 0.01 that a recovery may be off.
TARGETS = {
    "cornell_box/target_128.exr": ("cornell_box/scene.xml", 128, 4096),
    "textured_room/target.exr": ("textured_room/scene.xml", 128, 4096),
    "poster/target.exr": ("poster/scene.xml", 96, 4096),
    "round_room/target.exr": ("round_room/scene.xml", 64, 8192),
    "glass_slab/target.exr": ("glass_slab/scene.xml", 64, 4096),
    "metal_plate/target.exr": ("metal_plate/scene.xml", 64, 8192),
    "point_light/target.exr": ("point_light/scene.xml", 64, 8192),
    "shadow/target.exr": ("shadow/scene.xml", 64, 8192),
    "lit_balls/front.exr": ("lit_balls/scene.xml", 64, 4096, 0),
    "lit_balls/back.exr": ("lit_balls/scene.xml", 64, 4096, 1),
    "relief/target.exr": ("relief/scene.xml", 64, 1024),
    "figurine/on_floor.exr": ("figurine/on_floor.xml", 64, 4096),
    "mirror/target.exr": ("mirror/scene.xml", 64, 8192),
    "lamp_place/target.exr": ("lamp_place/scene.xml", 64, 1024),
    "three_shadows/on_floor.exr": ("three_shadows/scene.xml", 48, 1024, 0),
    "three_shadows/on_back.exr": ("three_shadows/scene.xml", 48, 1024, 1),
    "three_shadows/on_left.exr": ("three_shadows/scene.xml", 48, 1024, 2),
    **{f"smoke/view_{view}.exr": ("smoke/scene.xml", 64, 1024, view) for view in range(5)},
    **{f"smoke/around_{view}.exr": ("smoke/all_around.xml", 48, 1024, view) for view in range(8)},
    **{f"cloud/view_{view}.exr": ("cloud/scene.xml", 48, 2048, view) for view in range(9)},
    "translucent_ball/target.exr": ("translucent_ball/scene.xml", 64, 4096),
    "caustic/target.exr": ("caustic/scene.xml", 40, 8192),
    "lens/target.exr": ("lens/scene.xml", 40, 8192),
    "mirror_dish/target.exr": ("mirror_dish/scene.xml", 40, 8192),
}
PASS_SPP = 128


def render(scene_file: str, resolution: int, spp: int, sensor: int = 0) -> np.ndarray:
    """Mean of ``spp / PASS_SPP`` renders with different seeds, linear RGB of shape (H, W, 3)."""
    scene = mi.load_file(str(ASSETS / scene_file), resolution=resolution)
    passes = spp // PASS_SPP
    total = np.zeros((resolution, resolution, 3))
    for seed in range(passes):
        total += np.asarray(mi.render(scene, sensor=sensor, spp=PASS_SPP, seed=seed))
    return (total / passes).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant (llvm_ad_rgb, scalar_rgb)")
    parser.add_argument("--only", choices=sorted(TARGETS), help="make this file only")
    options = parser.parse_args()
    mi.set_variant(options.variant)
    for name, (scene_file, resolution, spp, *sensor) in TARGETS.items():
        if options.only in (None, name):
            image = mi.Bitmap(render(scene_file, resolution, spp, *sensor))
            # Half floats: the rounding of at most 0.05% is below the noise, the file half as large.
            image.convert(component_format=mi.Struct.Type.Float16).write(str(ASSETS / name))
            print(f"{name}: {resolution} x {resolution}, {spp} spp", flush=True)


if __name__ == "__main__":
    main()
