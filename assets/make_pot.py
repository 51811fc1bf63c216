"""Makes a glTF asset, a lidded pot with maps of everything, and the images of it that Mitsuba renders.

    python assets/make_pot.py              # pot/pot.glb, by the writer of this project
    python assets/make_pot.py --targets    # pot/view_0.exr to view_7.exr; needs mitsuba==3.9.1
    python assets/make_pot.py --figure runs/pot_maps    # pictures/pot_maps.png, of a run of the recipe

Mitsuba cannot read glTF: it renders the XML that `rb.save` makes of the loaded asset. Mesh and maps are formulas of this
file.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import torch_radbp as rb
from torch_radbp.formats.image import srgb_to_linear

POT = Path(__file__).parent / "pot"
COLUMNS, ROWS = 40, 24  # of the mesh
WIDTH, HEIGHT = 32, 16  # texels of the maps
VIEWS, RESOLUTION, SPP, PASS_SPP = 8, 64, 2048, 256
GAP = 6  # pixels between the pictures of the figure
OPTIONS = {"light": 0.15, "max_depth": 3}  # as in the recipe


def lathe() -> dict[str, torch.Tensor]:
    """A pot from the knob of its lid down to its foot: u runs around it, v down along its profile."""
    t = np.linspace(0, 1, ROWS + 1)
    radius = 0.01 + 0.99 * np.sin(np.pi * np.clip(t, 0, 1) ** 0.8) ** 0.8 * (1 - 0.25 * t)
    radius += 0.05 * np.exp(-((t - 0.3) / 0.04) ** 2)  # the rim of the lid
    height = 0.9 - 1.8 * t + 0.2 * np.sin(2 * np.pi * t)
    turn = np.linspace(0, 1, COLUMNS + 1)
    u, v = np.meshgrid(turn, t)
    angle = 2 * np.pi * u
    positions = np.stack([radius[:, None] * np.sin(angle), np.broadcast_to(height[:, None], u.shape),
                          radius[:, None] * np.cos(angle)], axis=-1)
    along, down = np.gradient(positions, axis=1), np.gradient(positions, axis=0)
    along[:, [0, -1]] = positions[:, [1]] - positions[:, [-2]]  # over the seam
    normals = np.cross(down, along)
    corner = (np.arange(ROWS)[:, None] * (COLUMNS + 1) + np.arange(COLUMNS)).reshape(-1)
    below = corner + COLUMNS + 1
    faces = np.concatenate([np.stack([corner, below, below + 1], 1), np.stack([corner, below + 1, corner + 1], 1)])
    tensors = {"vertex_positions": positions.reshape(-1, 3), "vertex_normals": normals.reshape(-1, 3),
               "vertex_texcoords": np.stack([u, v], -1).reshape(-1, 2), "faces": faces}
    return {name: torch.from_numpy(np.ascontiguousarray(values)) for name, values in tensors.items()}


def maps() -> dict[str, torch.Tensor]:
    """Base colour, roughness, metallic and normal map, (H, W, C), in the levels of 8 bits."""
    u, v = np.meshgrid((np.arange(WIDTH) + 0.5) / WIDTH, (np.arange(HEIGHT) + 0.5) / HEIGHT)
    vine = np.exp(-((v - 0.55 - 0.1 * np.sin(8 * np.pi * u)) / 0.05) ** 2)
    leaves = np.exp(-(np.sin(8 * np.pi * u + 1.2) ** 2 / 0.25 + ((v - 0.78) / 0.06) ** 2))
    band = (1 / (1 + np.exp(-120 * (v - 0.24)))) * (1 / (1 + np.exp(120 * (v - 0.34))))
    metallic = np.clip(1.1 * np.maximum.reduce([vine, leaves, band]), 0, 1)
    glaze = 0.5 + 0.5 * np.sin(6 * np.pi * u + 3 * np.sin(2 * np.pi * v))
    roughness = (0.35 + 0.3 * glaze) * (1 - metallic) + (0.2 + 0.25 * v) * metallic
    clay = np.stack([0.3 + 0.2 * glaze, 0.4 - 0.1 * glaze, 0.5 - 0.2 * glaze], -1)
    colour = clay * (1 - metallic[..., None]) + np.array([0.95, 0.8, 0.5]) * metallic[..., None]
    slope_u, slope_v = 0.18 * np.cos(16 * np.pi * u) * np.sin(np.pi * v), 0.12 * np.sin(12 * np.pi * v)
    normal = np.stack([slope_u, slope_v, np.ones_like(u)], -1)
    normal = 0.5 + 0.5 * normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    found = {"base_color": colour, "roughness": roughness[..., None], "metallic": metallic[..., None], "normal": normal}
    levels = {name: torch.from_numpy(np.round(values.clip(0, 1) * 255) / 255) for name, values in found.items()}
    return levels | {"base_color": srgb_to_linear(levels["base_color"])}


def bitmap(data: torch.Tensor) -> dict:
    return {"type": "bitmap", "data": data}


def pot() -> rb.Scene:
    """The pot, panels of light all around it, and eight cameras that look at it from above and below in turn."""
    drawn = maps()
    glaze = {"type": "principled", **{name: bitmap(drawn[name]) for name in ("base_color", "roughness", "metallic")}}
    scene = {"type": "scene", "glaze": glaze, "panel": {"type": "diffuse", "reflectance": 0.0},
             "glaze_normalmap": {"type": "normalmap", "normalmap": bitmap(drawn["normal"]),
                                 "nested": {"type": "ref", "id": "glaze"}},
             "pot": {"type": "mesh", **lathe(), "bsdf": {"type": "ref", "id": "glaze_normalmap"}}}
    for number in range(VIEWS):
        angle, raised = 2 * np.pi * number / VIEWS, number % 2
        eye = [3.6 * np.sin(angle), 1.7 if raised else -1.5, 3.6 * np.cos(angle)]
        film = {"type": "hdrfilm", "width": RESOLUTION, "height": RESOLUTION, "rfilter": {"type": "box"}}
        scene[f"view_{number}"] = {"type": "perspective", "fov": 36, "film": film,
                                   "to_world": rb.look_at(eye, [0, -0.02, 0], [0, 1, 0])}
        panel = angle + np.pi / VIEWS
        place = rb.look_at([6 * np.sin(panel), 3.5 - 7 * raised, 6 * np.cos(panel)], [0, 0, 0], [0, 1, 0]).numpy()
        light = [5.0, 4.0, 3.2] if raised else [3.2, 4.0, 5.0]
        scene[f"panel_{number}"] = lamp(place @ np.diag([1.1, 1.6, 1, 1]), light)
    for name, height in (("panel_above", 6), ("panel_below", -6)):
        place = rb.look_at([0, height, 0], [0, 0, 0], [0, 0, 1]).numpy()
        scene[name] = lamp(place @ np.diag([1.2, 1.2, 1, 1]), [5.0, 5.0, 5.0])
    return rb.load_dict(scene)


def lamp(to_world: np.ndarray, radiance: list[float]) -> dict:
    return {"type": "rectangle", "to_world": to_world, "bsdf": {"type": "ref", "id": "panel"},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}}}


def render_targets(variant: str) -> None:
    """Renders every view of the asset, as it is loaded, with Mitsuba."""
    import mitsuba as mi

    mi.set_variant(variant)
    with tempfile.TemporaryDirectory() as folder:
        rb.save(rb.load(POT / "pot.glb", **OPTIONS), Path(folder) / "pot.xml")
        scene = mi.load_file(str(Path(folder) / "pot.xml"))
        for number in range(VIEWS):
            passes = [np.array(mi.render(scene, sensor=number, spp=PASS_SPP, seed=seed))
                      for seed in range(SPP // PASS_SPP)]
            image = mi.Bitmap(np.mean(passes, axis=0).astype(np.float32))
            image.convert(component_format=mi.Struct.Type.Float16).write(str(POT / f"view_{number}.exr"))
            print(f"view_{number}.exr: {RESOLUTION} x {RESOLUTION}, {SPP} spp", flush=True)


def draw_figure(run: Path) -> None:
    """Two views before, as Mitsuba sees them, after; below them both maps, as recovered and as they are."""
    def row(paths: list[Path], width: int) -> Image.Image:
        pictures = [Image.open(path).convert("RGB") for path in paths]
        height = width * pictures[0].height // pictures[0].width
        canvas = Image.new("RGB", (len(paths) * (width + GAP) - GAP, height), "white")
        for number, picture in enumerate(pictures):
            canvas.paste(picture.resize((width, height), Image.Resampling.NEAREST), (number * (width + GAP), 0))
        return canvas

    views = [run / "images" / f"view_{view}_{kind}.png" for view in (0, 1) for kind in ("before", "target", "after")]
    maps = [run / "textures" / f"glaze.{name}.data_{kind}.png" for name in ("roughness", "metallic")
            for kind in ("recovered", "true")]
    rows = [row(views, 128), row(maps, 193)]
    figure = Image.new("RGB", (rows[0].width, rows[0].height + GAP + rows[1].height), "white")
    figure.paste(rows[0], (0, 0))
    figure.paste(rows[1], (0, rows[0].height + GAP))
    figure.save(POT.parent / "pictures" / "pot_maps.png", optimize=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", action="store_true", help="render the images with Mitsuba")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant (llvm_ad_rgb, scalar_rgb)")
    parser.add_argument("--figure", type=Path, metavar="RUN", help="draw the figure of a run of the recipe")
    options = parser.parse_args()
    if options.figure:
        draw_figure(options.figure)
    elif options.targets:
        render_targets(options.variant)
    else:
        POT.mkdir(exist_ok=True)
        rb.save(pot(), POT / "pot.glb", strict=True)
