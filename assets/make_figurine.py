"""Makes a figurine, a round body with knobs and furrows: its meshes, maps and skies, and the images of it by Mitsuba.

    python assets/make_figurine.py               # meshes, maps, skies and scenes, by formulas of this file
    python assets/make_figurine.py --targets     # the images that recipes start from; needs mitsuba==3.9.1

Scenes hold the true figurine; their variable `body` takes the ball that recipes start from in its place.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
import trimesh
from PIL import Image

import torch_radbp as rb
from torch_radbp.formats.mesh_arrays import MeshArrays
from torch_radbp.formats.ply import write_ply

FIGURINE = Path(__file__).parent / "figurine"
PASS_SPP = 128
ALL_ROUND, ON_BOARD = 12, 16  # views of the two scenes
# Of the views of `on_board.xml`, in the order of their numbers: what each photograph was exposed by.
GAINS = [1.0, 0.83, 1.12, 0.95, 1.27, 0.78, 1.05, 0.9, 1.18, 0.87, 1.08, 0.97, 0.81, 1.22, 0.93, 1.14]
SKIES = ("studio", "dusk", "noon", "window")  # the first is the one that the photographs were taken under
KNOBS = [((0.75, 0.35, 0.55), 0.3, 0.33), ((-0.6, 0.55, 0.5), 0.26, 0.3), ((0.1, -0.8, 0.45), 0.32, 0.28),
         ((0.2, 0.9, -0.3), 0.2, 0.35), ((-0.3, -0.2, 1.0), 0.3, 0.3), ((-0.9, -0.3, -0.2), -0.22, 0.4)]


def radius(directions: np.ndarray) -> np.ndarray:
    """(...) how far the surface is from the middle in unit directions (..., 3): knobs, a dent and furrows."""
    angle = np.arctan2(directions[..., 1], directions[..., 0])
    found = 0.72 + 0.035 * np.cos(9 * angle) * (1 - directions[..., 2] ** 2) ** 2
    for middle, height, width in KNOBS:
        cosine = (directions * (np.array(middle) / np.linalg.norm(middle))).sum(-1)
        found = found + height * np.exp((cosine - 1) / width**2 * 2)
    return found


def globe(columns: int, rows: int) -> MeshArrays:
    """The unit sphere by longitude and latitude, with surface coordinates: u runs around it, v up."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    up, around = np.pi * (v - 0.5), 2 * np.pi * u
    places = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], -1)
    places[:, -1] = places[:, 0]  # the seam, to the last bit
    places[0], places[-1] = (0, 0, -1), (0, 0, 1)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    above = corner + columns + 1
    lower, upper = np.stack([corner, corner + 1, above + 1], 1), np.stack([corner, above + 1, above], 1)
    faces = np.concatenate([lower[columns:], upper[:-columns]])  # without those that a pole shrinks to nothing
    return MeshArrays(places.reshape(-1, 3), faces, None, np.stack([u, v], -1).reshape(-1, 2))


def write(name: str, mesh: MeshArrays) -> None:
    """A PLY file of float32."""
    write_ply(FIGURINE / name, mesh._replace(vertices=mesh.vertices.astype(np.float32)))


def write_meshes() -> None:
    """The figurine, and a ball in its place: one by longitude and latitude, one of even triangles."""
    fine, coarse = globe(72, 36), globe(40, 20)
    write("body.ply", fine._replace(vertices=radius(fine.vertices)[:, None] * fine.vertices))
    write("globe.ply", coarse._replace(vertices=0.75 * coarse.vertices))
    ball = trimesh.creation.icosphere(4, radius=0.75)
    write("ball.ply", MeshArrays(np.asarray(ball.vertices), np.asarray(ball.faces), None, None))


def write_maps() -> None:
    """Base colour, 32 x 16 texels, and roughness, 16 x 8, of the figurine."""
    u, v = np.meshgrid((np.arange(32) + 0.5) / 32, (np.arange(16) + 0.5) / 16)
    bands = 0.5 + 0.5 * np.sin(6 * np.pi * u + 4 * np.sin(2 * np.pi * v))
    clay, glaze = np.array([0.75, 0.45, 0.3]), np.array([0.2, 0.5, 0.62])
    colour = clay + bands[..., None] * (glaze - clay)
    colour[np.hypot(np.minimum(abs(u - 0.55), 1 - abs(u - 0.55)) * 2, v - 0.6) < 0.15] = (0.9, 0.8, 0.35)
    Image.fromarray((colour * 255 + 0.5).astype(np.uint8)).save(FIGURINE / "colour.png", optimize=True)
    u, v = np.meshgrid((np.arange(16) + 0.5) / 16, (np.arange(8) + 0.5) / 8)
    rough = 0.35 + 0.2 * np.sin(2 * np.pi * u) * np.cos(2 * np.pi * v)
    Image.fromarray((rough * 255 + 0.5).astype(np.uint8)).save(FIGURINE / "roughness.png", optimize=True)


def write_skies() -> None:
    """Environment maps, 32 x 16 texels of radiance: a studio with two soft boxes, and three others to relight by."""
    u, v = np.meshgrid((np.arange(32) + 0.5) / 32, (np.arange(16) + 0.5) / 16)

    def lamp(at: tuple[float, float], size: float, colour: tuple[float, ...]) -> np.ndarray:
        across = np.minimum(abs(u - at[0]), 1 - abs(u - at[0])) * 2
        return np.exp(-(((across**2 + (v - at[1]) ** 2) / size**2) ** 2))[..., None] * np.array(colour)

    def gradient(above: tuple[float, ...], below: tuple[float, ...]) -> np.ndarray:
        return np.array(above) + v[..., None] * (np.array(below) - np.array(above))

    skies = {
        "studio": gradient((0.35, 0.4, 0.5), (0.2, 0.18, 0.16)) + lamp((0.2, 0.3), 0.17, (3.2, 2.9, 2.4))
        + lamp((0.7, 0.35), 0.14, (1.6, 2.0, 2.6)),
        "dusk": gradient((0.12, 0.14, 0.3), (0.25, 0.16, 0.1)) + lamp((0.9, 0.45), 0.2, (4.0, 1.7, 0.7)),
        "noon": gradient((0.5, 0.65, 0.9), (0.3, 0.28, 0.25)) + lamp((0.4, 0.2), 0.12, (9.0, 8.6, 8.0)),
        "window": gradient((0.1, 0.1, 0.1), (0.08, 0.08, 0.08)) + lamp((0.05, 0.4), 0.22, (2.4, 2.7, 3.0)),
    }
    for name, sky in skies.items():
        rb.save_image(FIGURINE / f"{name}.exr", torch.from_numpy(sky.astype(np.float32)).movedim(-1, 0))


HEAD = """<?xml version="1.0" encoding="utf-8"?>
<!-- {about} Written by ../make_figurine.py; z up. -->
<scene version="3.0.0">
    <default name="resolution" value="{resolution}"/>
    <default name="spp" value="16"/>
    <default name="max_depth" value="{max_depth}"/>
    <default name="body" value="body.ply"/>
"""
CAMERA = """
    <sensor type="perspective" id="view_{number}">
        <string name="fov_axis" value="x"/>
        <float name="fov" value="{fov}"/>
        <float name="near_clip" value="0.01"/>
        <float name="far_clip" value="100"/>
        <transform name="to_world">
            <lookat origin="{x:.4f}, {y:.4f}, {z:.4f}" target="{target}" up="0, 0, 1"/>
        </transform>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width" value="$resolution"/>
            <integer name="height" value="$resolution"/>
            <string name="pixel_format" value="rgb"/>
            <string name="component_format" value="float32"/>
            <rfilter type="box"/>
        </film>
    </sensor>
"""
INTEGRATOR = """
    <integrator type="path">
        <integer name="max_depth" value="$max_depth"/>
        <integer name="rr_depth" value="100"/>
    </integrator>
"""
PLASTER = """
    <shape type="ply" id="body">
        <string name="filename" value="$body"/>
        <bsdf type="diffuse">
            <rgb name="reflectance" value="0.6, 0.58, 0.55"/>
        </bsdf>
    </shape>
    <emitter type="constant" id="sky">
        <rgb name="radiance" value="0.25"/>
    </emitter>
"""
SUN = """    <emitter type="directional" id="{name}">
        <vector name="direction" value="{direction}"/>
        <rgb name="irradiance" value="{irradiance}"/>
    </emitter>
"""
BOARD = """
    <default name="sky" value="studio.exr"/>
    <shape type="ply" id="body">
        <string name="filename" value="$body"/>
        <transform name="to_world">
            <translate z="1.05"/>
        </transform>
        <bsdf type="principled">
            <texture type="bitmap" name="base_color">
                <string name="filename" value="colour.png"/>
            </texture>
            <texture type="bitmap" name="roughness">
                <string name="filename" value="roughness.png"/>
                <boolean name="raw" value="true"/>
            </texture>
            <float name="specular" value="0.6"/>
        </bsdf>
    </shape>
    <shape type="rectangle" id="board">
        <transform name="to_world">
            <scale x="1.8" y="1.8"/>
        </transform>
        <bsdf type="twosided">
            <bsdf type="diffuse">
                <texture type="bitmap" name="reflectance">
                    <string name="filename" value="../patches.png"/>
                    <string name="wrap_mode" value="clamp"/>
                </texture>
            </bsdf>
        </bsdf>
    </shape>
    <emitter type="envmap" id="sky">
        <string name="filename" value="$sky"/>
        <transform name="to_world">
            <rotate x="1" angle="90"/>
        </transform>
    </emitter>
"""


def cameras(count: int, raised: tuple[float, ...], distance: float, fov: float, height: float) -> str:
    """Cameras all around, whose elevations in degrees take turns."""
    found = ""
    for number in range(count):
        up, around = np.radians(raised[number % len(raised)]), 2 * np.pi * number / count
        x, y, z = distance * np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
        found += CAMERA.format(number=number, fov=fov, x=x, y=y, z=z + height, target=f"0, 0, {height}")
    return found


def write_scenes() -> None:
    """Plaster under three lamps of different colours, and painted on a board under a sky."""
    suns = [("warm", "-1, -0.5, -0.9", "1.5, 1.1, 0.8"), ("cold", "0.9, -0.7, -0.4", "0.5, 0.8, 1.3"),
            ("below", "0.1, 1, 0.6", "0.6, 0.9, 0.6")]
    lamps = "".join(SUN.format(name=name, direction=direction, irradiance=colour) for name, direction, colour in suns)
    about = "A figurine of plaster, seen from all sides under lamps that are known."
    head = HEAD.format(about=about, resolution=64, max_depth=2)
    (FIGURINE / "plaster.xml").write_text(
        head + INTEGRATOR + cameras(ALL_ROUND, (15, 55, -35), 4.0, 30, 0.0) + PLASTER + lamps + "</scene>\n")
    head = HEAD.format(about="A painted figurine over a board, photographed under a sky.", resolution=96, max_depth=3)
    (FIGURINE / "on_board.xml").write_text(
        head + INTEGRATOR + cameras(ON_BOARD, (12, 48, 28), 5.2, 36, 0.75) + BOARD + "</scene>\n")


def rendered(mi, scene, sensor: int, spp: int) -> np.ndarray:
    """(H, W, 3) linear, the mean of passes with seeds of their own."""
    passes = [np.array(mi.render(scene, sensor=sensor, spp=PASS_SPP, seed=seed)) for seed in range(spp // PASS_SPP)]
    return np.mean(passes, axis=0)


def save_photograph(name: str, linear: np.ndarray) -> None:
    """8 bits in sRGB, with the least of noise that turns steps of brightness into grain; and a mask if it is overexposed."""
    values = linear.clip(0, 1)
    srgb = np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)
    levels = np.floor(srgb * 255 + np.random.default_rng(0).random(srgb.shape)).clip(0, 255).astype(np.uint8)
    Image.fromarray(levels).save(FIGURINE / f"{name}.png", optimize=True)
    saturated = (levels == 255).any(-1)
    if saturated.any():
        Image.fromarray(np.where(saturated, 0, 255).astype(np.uint8)).save(FIGURINE / f"{name}_mask.png", optimize=True)
        print(f"{name}: {saturated.sum()} pixels are saturated, and masked", flush=True)


def render_targets(variant: str) -> None:
    """Renders every view of both scenes with Mitsuba, and a view of the figurine under each of the other skies."""
    import mitsuba as mi

    mi.set_variant(variant)
    scene = mi.load_file(str(FIGURINE / "plaster.xml"))
    for number in range(ALL_ROUND):
        save_photograph(f"plaster_{number}", rendered(mi, scene, number, 512))
    scene = mi.load_file(str(FIGURINE / "on_board.xml"))
    for number, gain in enumerate(GAINS):
        save_photograph(f"on_board_{number}", gain * rendered(mi, scene, number, 1024))
    for sky in SKIES[1:]:
        scene = mi.load_file(str(FIGURINE / "on_board.xml"), sky=f"{sky}.exr")
        image = mi.Bitmap(rendered(mi, scene, 1, 1024).astype(np.float32))
        image.convert(component_format=mi.Struct.Type.Float16).write(str(FIGURINE / f"under_{sky}.exr"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", action="store_true", help="render the images with Mitsuba")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant (llvm_ad_rgb, scalar_rgb)")
    options = parser.parse_args()
    if options.targets:
        render_targets(options.variant)
    else:
        FIGURINE.mkdir(exist_ok=True)
        for make in (write_meshes, write_maps, write_skies, write_scenes):
            make()
