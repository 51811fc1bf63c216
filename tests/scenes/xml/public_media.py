"""The scenes with media of Mitsuba's own test suite, rebuilt: its media, boundaries, lights, camera, depth; other shapes.

Their table is in `SCENES`. Instead of their meshes stand spheres, a cube and bumpy balls, instead of their photograph of a
museum a sky with a bright window. 48 x 48 pixels, seen from (0, 0.5, 4).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.scenes.xml.basics import ball, file
from tests.scenes.xml.files import Case, Folder, bumpy_ball, diffuse, lamp, look, placed, scene_xml, shape
from tests.scenes.xml.lights import pose
from tests.scenes.xml.materials import bsdf, colours, floats, names
from tests.scenes.xml.matrix import VARIABLE_SIZE
from tests.scenes.xml.matrix_pieces import emitter
from tests.scenes.xml.media import DEPTH, fine_sky

SIZE = {"width": 48, "height": 48}
SPP, BATCHES = 31, 28  # 868 samples


class Scene(NamedTuple):
    """What is special about a scene."""

    medium: str
    body: str
    max_depth: int = 6
    sky: float | None = 1.0  # scale of the environment map
    background: bool = True


def homogeneous(scale: float, albedo: str, sigma_t: str = "1, 1, 1") -> str:
    return f'<medium id="medium1" type="homogeneous">{floats(scale=scale)}{colours(sigma_t=sigma_t, albedo=albedo)}</medium>'


def heterogeneous(scale: float, *parts: str) -> str:
    return f'<medium id="medium1" type="heterogeneous">{floats(scale=scale)}{"".join(parts)}</medium>'


def grid(name: str, filename: str) -> str:
    place = placed('scale value="1.5"', 'translate x="-0.75" y="-0.75" z="-0.75"')
    return f'<volume name="{name}" type="gridvolume"><string name="filename" value="{filename}"/>{place}</volume>'


NULL, FILLED = bsdf("null"), '<ref name="interior" id="medium1"/>'
WATER, THIN = (bsdf(kind, names(int_ior="water", ext_ior="air")) for kind in ("dielectric", "thindielectric"))
ROUGH = bsdf("roughdielectric", floats(alpha=0.3, int_ior=1.3), names(ext_ior="air"))


def two(upper: str, lower: str, radius: float = 0.75) -> str:
    """A sphere above a smaller one, both filled."""
    return (shape("sphere", "upper", ball(0, 0.1, 0, radius), upper, FILLED)
            + shape("sphere", "lower", ball(0, -0.97, 0, 0.3), lower, FILLED))


CUBE = (shape("cube", "cube", placed('scale value="0.75"'), NULL, FILLED)
        + shape("sphere", "lower", ball(0, -1.02, 0, 0.25), diffuse("0.5")))
MIDDLE = colours(value="0.5, 0.4, 0.3")
RINGS = [placed(f'scale value="{scale}"', f'translate x="{x}" y="0.1" z="0.1"') for scale, x in ((0.22, -0.3), (0.18, 0.3))]


def inside(first: str, second: str) -> str:
    """Two things in the upper sphere."""
    return "".join(shape("obj", name, file("bumpy.obj"), place, *(parts,))
                   for name, place, parts in zip(("left", "right"), RINGS, (first, second)))


WHITE, CONSTANT = colours(albedo="0.99, 0.99, 0.99"), f'<volume name="sigma_t" type="constvolume">{MIDDLE}</volume>'
SHINES = '<emitter type="area"><spectrum name="radiance" value="400:0, 500:0.3, 600:0.8, 700:1.1"/></emitter>'
SCENES = {
    "homo_null_envmap": Scene(homogeneous(3, "0.99, 0.5, 0.5"), two(NULL, NULL)),
    "homo_dielectric_envmap": Scene(homogeneous(0.5, "0.99, 0.7, 0.99"), two(WATER, WATER), 16, background=False),
    "homo_area_light": Scene(homogeneous(2.5, "0.99, 0.999, 0.99"), two(NULL, THIN) + shape(
        "cube", "lamp", diffuse("0"), lamp("18.387, 10.9873, 8.75357"),
        placed('scale value="0.25"', 'rotate y="1" angle="30"', 'translate x="1.3" y="0.2" z="0.3"')), sky=None),
    "homo_emitter_inside_medium": Scene(homogeneous(5, "0.99, 0.99, 0.999"), two(THIN, THIN) + inside(
        diffuse("0") + SHINES, bsdf("roughplastic", colours(diffuse_reflectance="0.05, 0.2, 0.05"))), sky=0.4),
    "homo_obj_inside_medium": Scene(homogeneous(2, "0.99, 0.7, 0.7"), two(THIN, THIN) + inside(
        bsdf("roughplastic", colours(diffuse_reflectance="0.9, 0.99, 0.97")), diffuse("1"))),
    "homo_roughdielectric_spot": Scene(
        homogeneous(1, "0.1, 0.5, 0.9", "0.102, 0.993, 0.103"), two(ROUGH, ROUGH, 0.3) + emitter(
            "spot", pose("0, -0.5, -2", "0, 0.5, 0"), colours(intensity="1"), floats(cutoff_angle=60)), 16, None, False),
    "homo_spectral_sigmat": Scene(homogeneous(10, "0.5, 0.5, 0.99", "1, 0.2, 1"), two(NULL, NULL)),
    "hetero_sigmat": Scene(heterogeneous(5, grid("sigma_t", "sigmat.vol"), WHITE), CUBE),
    "hetero_sigmat_albedo": Scene(heterogeneous(5, grid("sigma_t", "sigmat.vol"), grid("albedo", "albedo.vol")), CUBE),
    "hetero_spectral_sigmat": Scene(heterogeneous(2, grid("sigma_t", "albedo.vol"), WHITE), CUBE),
    "hetero_spectral_sigmat_no_scattering": Scene(heterogeneous(5, CONSTANT, colours(albedo="0, 0, 0")), CUBE),
}
# Of different textures: rectangles of the same material Mitsuba 3.9.1 merges into one, which its bounding box of the scene
# does not contain, and then shadow rays towards the sky end too early.
FLOOR, WALL = ('<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"><rgb name="color0" value="0.2"/><rgb '
               f'name="color1" value="0.4"/><transform name="to_uv"><scale value="{tiles}"/></transform></texture></bsdf>'
               for tiles in (16, 8))
BACKGROUND = (shape("rectangle", "floor", FLOOR, placed('rotate x="1" angle="-90"', 'scale value="4"', 'translate y="-1.3"'))
              + shape("rectangle", "wall", WALL, placed('scale value="4"', 'translate z="-3"')))


def built(scene: Scene) -> Callable[[Folder], Path]:
    """A scene; what makes its files."""

    def build(folder: Folder) -> Path:
        random = np.random.default_rng(16)
        fine_sky(folder)
        folder.volume("sigmat.vol", random.random((16, 16, 16, 1)))
        folder.volume("albedo.vol", random.random((16, 16, 16, 3)))
        bumpy_ball(folder, "bumpy.obj", normals=True)
        body = scene.medium + scene.body + (BACKGROUND if scene.background else "")
        body += "" if scene.sky is None else emitter("envmap", file("sky.exr"), floats(scale=scene.sky))
        view = look("0, 0.5, 4", "0, -0.5, 0", 39.3077) + floats(near_clip=1)
        return folder.text("scene.xml", scene_xml(VARIABLE_SIZE, view, body, DEPTH))

    return build


def case_of(name: str) -> Case:
    scene = SCENES[name]
    return Case(built(scene), SIZE | {"max_depth": scene.max_depth}, peer_integrator="volpathmis")
