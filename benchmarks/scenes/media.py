"""Three scenes with media that are timed: glass with a medium in it, fog in a room, a cloud."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.scenes.description import BenchmarkScene, Setting
from tests.scenes.xml.basics import ball
from tests.scenes.xml.files import Folder, diffuse, lamp, look, placed, scene_xml, shape
from tests.scenes.xml.materials import bsdf, colours, floats
from tests.scenes.xml.matrix_pieces import light
from tests.scenes.xml.media import fine_sky, phase

SIDE, CELLS = 128, 128
TINY = Setting(resolution=16, spp=4, max_depth=8)
GROUND = shape("rectangle", "floor", diffuse("0.6, 0.5, 0.4"), placed('rotate x="1" angle="-90"', 'scale value="3"'))
Made = tuple[BenchmarkScene, tuple[str, ...]]  # with the names of its parameters in Mitsuba


def made(folder: Folder, small: bool, depth: int, body: str, owner: str, extinction: str, sensor: str = "") -> Made:
    """A scene whose medium, of extinction and albedo, belongs to `owner`, as its interior or, of a sensor, its medium."""
    setting = TINY if small else Setting(SIDE, 16, depth)
    view = look("0.4, 1.9, 4.2", "0, 0.8, 0", 40) + sensor
    film = f'<default name="resolution" value="{SIDE}"/>'
    text = scene_xml('<integer name="width" value="$resolution"/><integer name="height" value="$resolution"/>', view,
                     film + body)
    path = folder.text("scene.xml", text)
    names = tuple(f"{owner}.{name}" for name in (extinction, "albedo.value.value"))
    theirs = tuple(name.replace(".interior.", ".interior_medium.") for name in names)
    return BenchmarkScene(path, names, setting), theirs


def glass(folder: Folder, small: bool) -> Made:
    """A ball of glass with a coloured medium in it, under a sky."""
    fine_sky(folder)
    filling = (f'<medium name="interior" type="homogeneous">{colours(sigma_t="0.5, 0.25, 1", albedo="0.9, 0.8, 0.6")}'
               f'{floats(scale=4)}{phase("hg", floats(g=0.4))}</medium>')
    body = GROUND + light("envmap") + shape("sphere", "ball", ball(0, 0.8, 0, 0.8), bsdf("dielectric"), filling)
    return made(folder, small, 16, body, "ball.interior", "sigma_t.value.value")


def fog(folder: Folder, small: bool) -> Made:
    """A room full of fog, under a lamp."""
    filling = (f'<medium name="interior" type="homogeneous">{colours(sigma_t="0.5, 0.5, 0.5", albedo="0.9, 0.9, 0.9")}'
               f'{floats(scale=0.5)}{phase("hg", floats(g=0.6))}</medium>')
    body = (GROUND + shape("rectangle", "wall", diffuse("0.5, 0.55, 0.7"),
                           placed('scale x="3" y="1.5"', 'translate y="1.5" z="-3"'))
            + shape("rectangle", "lamp", diffuse("0"), lamp("18, 15, 12"),
                    placed('scale value="0.6"', 'rotate x="1" angle="90"', 'translate y="2.9"'))
            + shape("sphere", "stone", ball(0.2, 0.6, 0, 0.6), diffuse("0.7, 0.4, 0.3"))
            + shape("cube", "box", placed('scale value="2.99"', 'translate y="3"'), bsdf("null"), filling))
    return made(folder, small, 16, body, "box.interior", "sigma_t.value.value")


def cloud(folder: Folder, small: bool) -> Made:
    """A cloud of 128^3 cells under a sky; of 32^3 where it is small."""
    fine_sky(folder)
    cells = 32 if small else CELLS
    z, y, x = (np.mgrid[:cells, :cells, :cells] + 0.5) / cells - 0.5
    puffs = sum(np.exp(-((x - a)**2 + (y - b)**2 + (z - c)**2) / 0.02)
                for a, b, c in ((0, 0, 0), (0.2, -0.1, 0.1), (-0.2, -0.05, -0.1), (0.05, 0.15, -0.15)))
    ripple = 0.5 + 0.5 * np.sin(40 * x + 3 * np.sin(25 * z)) * np.sin(37 * y + 2 * np.sin(31 * x))
    folder.volume("cloud.vol", np.clip(puffs - 0.35, 0, 1) * ripple)
    place = placed('scale value="1.6"', 'translate x="-0.8" z="-0.8"')
    filling = ('<medium name="interior" type="heterogeneous"><volume name="sigma_t" type="gridvolume"><string '
               f'name="filename" value="cloud.vol"/>{place}</volume>{colours(albedo="0.99, 0.98, 0.97")}{floats(scale=40)}'
               f'{phase("hg", floats(g=0.6))}</medium>')
    body = GROUND + light("envmap") + shape(
        "cube", "box", placed('scale value="0.8"', 'translate y="0.81"'), bsdf("null"), filling)
    return made(folder, small, 64, body, "box.interior", "sigma_t.data")


SCENES: dict[str, Callable[[Folder, bool], Made]] = {"glass": glass, "fog": fog, "cloud": cloud}
