"""Scenes with media, generated from a table: a medium, its phase function, its boundary, where the camera stands, a light.

Every medium, phase function and volume occurs in it; whoever adds one adds a piece and, by its name, rows. They stand on a
floor before a wall. `benchmarks.media` compares the images with Mitsuba's.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.scenes.xml.basics import ball
from tests.scenes.xml.files import Case, Folder, diffuse, lamp, look, picture, placed, scene_xml, shape
from tests.scenes.xml.materials import bsdf, colours, floats, names
from tests.scenes.xml.matrix import VARIABLE_SIZE
from tests.scenes.xml.matrix_pieces import emitter, light

# Without Russian roulette, by which Mitsuba's `volpathmis` is biased: `benchmarks.media --integrators`.
DEPTH = '<integer name="max_depth" value="$max_depth"/><integer name="rr_depth" value="1000"/>'
SIZE = {"width": 24, "height": 24}
DEPTHS = (2, 8, 64)
FLAKES = [0.9, 0.3, 0.5, 0.2, -0.1, 0.15]  # xx, yy, zz, xy, xz, yz of a positive definite matrix


def phase(kind: str, *parts: str, name: str = "phase") -> str:
    return f'<phase name="{name}" type="{kind}">{"".join(parts)}</phase>'


def grid(name: str, filename: str) -> str:
    """A grid that fills the cube of `BODIES`."""
    place = placed('scale value="1.5"', 'translate x="-0.75" y="0.05" z="-0.75"')
    return (f'<volume name="{name}" type="gridvolume"><string name="filename" value="{filename}"/>'
            f'<boolean name="raw" value="true"/>{place}</volume>')


def homogeneous(sigma_t: str, albedo: str) -> tuple[str, str]:
    return "homogeneous", colours(sigma_t=sigma_t, albedo=albedo)


PHASES = {
    "isotropic": phase("isotropic"), "hg": phase("hg", floats(g=0.6)), "rayleigh": phase("rayleigh"),
    "tabphase": phase("tabphase", names(values="0.2, 0.1, 0, 0.4, 1.5")),
    "blendphase": phase("blendphase", floats(weight=0.3), phase("hg", floats(g=-0.5), name="phase_0"),
                        phase("rayleigh", name="phase_1")),
    "sggx": phase("sggx", grid("S", "flakes.vol")),
}
MEDIA = {  # type, and the rest
    "grey": homogeneous("0.5, 0.5, 0.5", "0.8, 0.8, 0.8"), "coloured": homogeneous("0.5, 0.25, 1", "0.9, 0.6, 0.4"),
    "grid": ("heterogeneous", grid("sigma_t", "smoke.vol") + colours(albedo="0.9, 0.6, 0.3")),
    "coloured grid": ("heterogeneous", grid("sigma_t", "paint.vol") + colours(albedo="0.9, 0.8, 0.7")),
    "albedo grid": ("heterogeneous", grid("sigma_t", "smoke.vol") + grid("albedo", "albedo.vol")),
}
BOUNDARIES = {"null": bsdf("null"), "dielectric": bsdf("dielectric", floats(int_ior=1.33)),
              "roughdielectric": bsdf("roughdielectric", floats(alpha=0.3, int_ior=1.3))}
PANES = {"thindielectric": bsdf("thindielectric", floats(int_ior=1.5)),
         "mask": bsdf("mask", floats(opacity=0.4), diffuse("0.6, 0.3, 0.2"))}
# In no row: in Mitsuba's `volpathmis` light of lamps behind tinted panes is too bright (`benchmarks.media --integrators`).
TINTED = {"tinted": bsdf("thindielectric", floats(int_ior=1.5), colours(specular_transmittance="0.9, 0.5, 0.2"))}
BODIES = {"homogeneous": ("sphere", placed('scale value="0.8"', 'translate y="0.8"')),
          "heterogeneous": ("cube", placed('scale value="0.75"', 'translate y="0.8"'))}
CAMERAS = {"outside": look("0.4, 1.9, 4.2", "0, 0.8, 0", 40), "inside": look("0.1, 1, 0.4", "0.8, 1, -2", 70)}
STONE = shape("sphere", "stone", ball(0.1, 0.8, 0.1, 0.3), diffuse("0.7, 0.5, 0.3"))
LAMP = shape("rectangle", "lamp", diffuse("0"), lamp("9, 7, 5"), placed(
    'scale x="0.8" y="0.6"', 'rotate x="1" angle="110"', 'translate x="0.5" y="2.8" z="0.4"'))
LIGHTS = {"sky": light("envmap"), "stone": light("envmap") + STONE, "lamp": LAMP, "bulb": emitter(
    "point", '<point name="position" x="0.9" y="2.2" z="1.6"/>', colours(intensity="9, 8, 7"))}
# Glass hides lamps from next-event estimation, and fog that fills all space hides the sky.
LIGHTS_OF = {"null": ("sky", "stone", "lamp", "bulb"), "none": ("lamp", "bulb"), "mask": ("sky", "stone", "lamp", "bulb"),
             "thindielectric": ("sky", "stone", "lamp")}  # a bulb has caustics in there, by reflection, which Mitsuba lacks


class Row(NamedTuple):
    """What a scene is made of, by the names above; `none`: the medium fills all space."""

    medium: str
    phase: str
    boundary: str
    camera: str
    light: str
    depth: int

    def __str__(self) -> str:
        return ", ".join(map(str, self))


def rows() -> list[Row]:
    """Each medium with each phase function in two boundaries, and each homogeneous one without; the rest in turn.
    Some in panes, too."""
    found = []
    for number, (again, medium, phase_name) in enumerate(product((0, 1), MEDIA, PHASES)):
        boundary = list(BOUNDARIES)[(number + number // 6 + 2 * again) % 3]
        lights = LIGHTS_OF.get(boundary, ("sky", "stone"))
        found.append(Row(medium, phase_name, boundary, list(CAMERAS)[(number + number // 9 + again) % 2],
                         lights[(number + number // 2 + 3 * again) % len(lights)], DEPTHS[(number // 2 + number // 6) % 3]))
    for number, (medium, phase_name) in enumerate(product(("grey", "coloured"), PHASES)):
        found.append(Row(medium, phase_name, "none", "inside", LIGHTS_OF["none"][number // 2 % 2],
                         DEPTHS[(number + number // 6) % 3]))
    for number, (boundary, camera, depth) in enumerate(product(PANES, CAMERAS, DEPTHS[:2])):
        lights = LIGHTS_OF[boundary]
        found.append(Row(list(MEDIA)[number % 5], list(PHASES)[number % 5], boundary, camera,
                         lights[(number + number // 4) % len(lights)], depth))
    return found


def built(row: Row) -> Callable[[Folder], Path]:
    """The scene of a row; what makes its files."""

    def build(folder: Folder) -> Path:
        files(folder)
        kind, values = MEDIA[row.medium]
        enclosed, inside = row.boundary != "none", row.camera == "inside"
        body = f'<medium id="air" type="{kind}">{values}{floats(scale=4.0 if enclosed else 0.6)}{PHASES[row.phase]}</medium>'
        if enclosed:
            body_kind, place = BODIES[kind]
            around = (BOUNDARIES | PANES | TINTED)[row.boundary]
            body += shape(body_kind, "body", place, around, '<ref name="interior" id="air"/>')
        body += shape("rectangle", "floor", diffuse("0.6, 0.5, 0.4"), placed('rotate x="1" angle="-90"', 'scale value="3"'))
        body += shape("rectangle", "wall", diffuse("0.5, 0.55, 0.7"), placed(
            'scale x="3" y="0.7"', 'translate y="0.7" z="-1.6"'))
        view = CAMERAS[row.camera if enclosed else "outside"] + ('<ref name="medium" id="air"/>' if inside else "")
        return folder.text("scene.xml", scene_xml(VARIABLE_SIZE, view, body + LIGHTS[row.light], DEPTH))

    return build


def files(folder: Folder) -> None:
    """The volumes and the sky that the pieces refer to."""
    random = np.random.default_rng(50)
    folder.volume("smoke.vol", 2 * random.random((12, 9, 10, 1))**2)
    folder.volume("paint.vol", 2 * random.random((12, 9, 10, 3))**2)
    folder.volume("albedo.vol", random.random((4, 5, 6, 3)))
    folder.volume("flakes.vol", np.tile(FLAKES, (1, 1, 1, 1)))
    fine_sky(folder)


def fine_sky(folder: Folder) -> None:
    """A sky with a bright window."""
    sky = 0.6 * picture(9, 16, seed=85)
    sky[1:4, 3:9] = 3, 2.6, 2.2
    folder.pixels("sky.exr", np.kron(sky, np.ones((16, 16, 1))))


def case_of(row: Row, size: dict[str, int] = SIZE) -> Case:
    return Case(built(row), size | {"max_depth": row.depth}, peer_integrator="volpathmis")
