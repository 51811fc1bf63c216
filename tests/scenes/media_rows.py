"""Scenes with media by whose parameters derivatives are compared with differences: a product of small pieces.

A row is a medium, what bounds it, a light, where the camera stands, what stands in the medium, and a parameter. Each piece
has a name, and these make the name of the row. `python -m benchmarks.media_derivatives` compares all of them with
differences, `tests/medium/test_differences.py` some.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tests.scenes import diffuse, look_at, rectangle, rgb, sensor
from tests.scenes.lights import sky_image, slide
from tests.scenes.media import BLACK
from tests.scenes.phase_functions import FLAKES, TABLE
from torch_radbp.io.values.transform import scale, translate

SIZE = 8  # pixels a side
AIR = {"type": "ref", "id": "air"}


class Row(NamedTuple):
    """A scene, by the names of its pieces, and a parameter by which it is differentiated."""

    medium: str  # of MEDIA
    boundary: str  # of BOUNDARIES; none: the medium fills all space
    light: str  # of LIGHTS
    parameter: str  # of PARAMETERS
    phase: str = "isotropic"  # of PHASES
    camera: str = "outside"  # or inside
    embedded: str = ""  # of EMBEDDED
    ground: str = ""  # of GROUNDS; by default that of GROUND_OF
    depth: int = 4

    def __str__(self) -> str:
        medium = self.medium if self.phase == "isotropic" else f"{self.medium} {self.phase}"
        return ", ".join(filter(None, (medium, self.boundary, self.light, self.camera, self.embedded,
                                       self.ground, f"depth {self.depth}"))
                         ) + f": {self.parameter}"


def even(sigma_t, albedo=(0.8, 0.8, 0.8), factor: float = 1.0) -> dict[str, Any]:
    """A homogeneous medium; one number: of all colours."""
    colours = sigma_t if isinstance(sigma_t, tuple) else (sigma_t,) * 3
    return {"type": "homogeneous", "scale": factor, "sigma_t": rgb(*colours), "albedo": rgb(*albedo)}


def grid(values: np.ndarray) -> dict[str, Any]:
    """Values on a grid that fills the cube of `BODIES`."""
    return {"type": "gridvolume", "data": values, "to_world": translate((-0.75,) * 3) @ scale((1.5,) * 3)}


def smoke(values: np.ndarray, albedo: Any = (0.9, 0.6, 0.3), factor: float = 1.0) -> dict[str, Any]:
    """A heterogeneous medium."""
    return {"type": "heterogeneous", "scale": factor, "sigma_t": grid(values),
            "albedo": rgb(*albedo) if isinstance(albedo, tuple) else grid(albedo)}


def cells(channels: int = 1, largest: float = 2.0, seed: int = 50) -> np.ndarray:
    """(2, 2, 2, channels) values, of which none is 0."""
    return largest * np.random.default_rng(seed).uniform(0.2, 1.0, (2, 2, 2, channels))


def emitting(medium: dict[str, Any], emission: Any) -> dict[str, Any]:
    """A medium that emits, too: by colour, or the values of a grid."""
    return {**medium, "emission": rgb(*emission) if isinstance(emission, tuple) else grid(emission)}


HALF_EMPTY = cells() * (np.arange(8).reshape(2, 2, 2, 1) % 2)
GLOW = (0.3, 0.2, 0.1)  # radiance per length
GREY, COLOURED = even(1.0), even((0.5, 0.25, 2.0), (0.9, 0.6, 0.4))
MEDIA = {
    "fog": even((0.1, 0.05, 0.3), (0.9, 0.6, 0.4)), "grey": GREY,
    "coloured": COLOURED, "empty": even(0.0), "empty in red": even((0.0, 1.0, 2.0)), "thin": even(0.01),
    "dense": even(4.0), "black": even(1.0, (0.0, 0.0, 0.0)), "white": even((0.5, 1.0, 2.0), (1.0, 1.0, 1.0)),
    "scaled": even((0.2, 0.1, 0.4), (0.9, 0.6, 0.4), 5.0), "scaled by 0": even((0.5, 0.25, 2.0), factor=0.0),
    "smoke": smoke(cells()), "half empty smoke": smoke(HALF_EMPTY), "empty smoke": smoke(0.0 * HALF_EMPTY),
    "thin smoke": smoke(0.01 * cells()), "dense smoke": smoke(cells(largest=12.0)),
    "coloured smoke": smoke(cells(3)[:, :1], (0.9, 0.8, 0.7)), "smoke of colours": smoke(cells(), cells(3, 0.9, 7)[:1]),
    "half black smoke": smoke(cells(), cells(3, 0.9, 7)[:1] * (np.arange(4).reshape(1, 2, 2, 1) % 2)),
    "scaled smoke": smoke(cells(largest=0.5), factor=4.0), "smoke scaled by 0": smoke(cells(), factor=0.0),
    "glowing fog": emitting(COLOURED, GLOW), "glowing grid in fog": emitting(COLOURED, cells(3, 1.0, 8)),
    "glowing emptiness": emitting(even(0.0), GLOW), "fog that glows in red": emitting(COLOURED, (0.5, 0.0, 0.0)),
    "glowing smoke": emitting(smoke(cells()), cells(3, 1.0, 8)), "glowing empty smoke": emitting(
        smoke(0.0 * HALF_EMPTY), GLOW), "half glowing smoke": emitting(smoke(cells(3)[:, :1], (0.9, 0.8, 0.7)), HALF_EMPTY),
    "dense glowing smoke": emitting(smoke(cells(largest=6.0)), GLOW),
}
PHASES: dict[str, dict[str, Any]] = {
    "isotropic": {"type": "isotropic"}, "rayleigh": {"type": "rayleigh"}, "hg backwards": {"type": "hg", "g": -0.5},
    "hg even": {"type": "hg", "g": 0.0}, "hg": {"type": "hg", "g": 0.6}, "hg sharp": {"type": "hg", "g": 0.85},
    "tabphase": {"type": "tabphase", "values": ", ".join(map(str, TABLE))},
    "sggx": {"type": "sggx", "S": {"type": "gridvolume", "data": np.reshape(FLAKES, (1, 1, 1, 6))}},
    **{f"blendphase {weight}": {"type": "blendphase", "weight": weight, "phase_0": {"type": "hg", "g": -0.5},
                                "phase_1": {"type": "hg", "g": 0.7}} for weight in (0.0, 0.3, 1.0)},
    "blendphase of a grid": {"type": "blendphase", "weight": grid(np.linspace(0.3, 0.7, 8).reshape(2, 2, 2, 1)),
                             "phase_0": {"type": "hg", "g": -0.5}, "phase_1": {"type": "rayleigh"}},
}
BOUNDARIES = {"null": {"type": "null"}, "dielectric": {"type": "dielectric", "int_ior": 1.3},
              "roughdielectric": {"type": "roughdielectric", "int_ior": 1.3, "alpha": 0.3}}
BODIES = {"homogeneous": {"type": "sphere", "radius": 0.8},
          "heterogeneous": {"type": "cube", "to_world": scale((0.75,) * 3)}}
CAMERAS = {"outside": sensor(SIZE), "inside": sensor(SIZE, (0.0, 0.1, 0.5), (0.2, 0.0, -1.5), 60)}
PLANE = rectangle((0, 0, -1.6), 2.5)
PEBBLE = {"type": "sphere", "center": [0, -30, 0], "radius": 0.1, "bsdf": BLACK}  # a scene needs a shape
GROUNDS = {"wall": {"wall": PLANE | {"bsdf": diffuse(0.6, 0.5, 0.4)}}, "nothing": {"pebble": PEBBLE},
           "glow": {"wall": PLANE | {"bsdf": BLACK, "emitter": {"type": "area", "radiance": rgb(1.0, 0.8, 0.6)}}}}
# Behind a medium that is as bright as what is behind it a derivative is small, and only noise is seen.
GROUND_OF = {"glow": "glow", "sunsky": "wall", "directional": "wall", "ember": "wall"}  # else nothing
STONE = {"type": "sphere", "center": [0.15, -0.1, 0.2], "radius": 0.35}
EMBEDDED = {
    "": {}, "stone": {"stone": STONE | {"bsdf": diffuse(0.7, 0.5, 0.3)}},
    "pearl": {"stone": STONE | {"bsdf": {"type": "dielectric"}}},
    "core": {"core": {"type": "sphere", "center": [0.1, 0.0, 0.1], "radius": 0.4, "bsdf": BOUNDARIES["null"],
                      "interior": even((2.0, 1.0, 3.0), (0.3, 0.6, 0.9)), "exterior": AIR}},
}
# Out of the camera's view. Point lights stand outside of what scatters more than once: their light has no variance there.
ABOVE = (0.9, 1.4, 1.2)
AIMED = look_at(ABOVE, (0, 0, 0), (0, 0, 1))
LAMP = rectangle((0, 1.7, 0.8), (0.6, 0.5, 1.0), (1, 0, 0), 115, bsdf=BLACK)
LIGHTS: dict[str, dict[str, Any]] = {
    "constant": {"sky": {"type": "constant", "radiance": rgb(0.6, 0.8, 1.0)}},
    "envmap": {"sky": {"type": "envmap", "bitmap": sky_image(sun=4.0)}},
    "sunsky": {"sky": {"type": "sunsky", "sun_direction": [0.3, 0.9, 0.4], "sky_scale": 0.05, "sun_scale": 0.02,
                       "sun_aperture": 40.0}},
    "directional": {"sun": {"type": "directional", "direction": [-0.4, -0.8, -0.6], "irradiance": rgb(2, 1.8, 1.5)}},
    "point": {"bulb": {"type": "point", "position": list(ABOVE), "intensity": rgb(9, 8, 7)}},
    "spot": {"bulb": {"type": "spot", "to_world": AIMED, "intensity": rgb(12, 10, 9), "cutoff_angle": 35.0,
                      "beam_width": 20.0}},
    "projector": {"bulb": {"type": "projector", "to_world": AIMED, "irradiance": slide(), "scale": 9.0, "fov": 50.0}},
    "area": {"lamp": LAMP | {"emitter": {"type": "area", "radiance": rgb(9, 8, 7)}}},
    "directionalarea": {"lamp": LAMP | {"emitter": {"type": "directionalarea", "radiance": rgb(3, 2, 2)}}},
    "ember": {"ember": {"type": "sphere", "center": [0.3, 0.2, 0.1], "radius": 0.2, "bsdf": BLACK,
                        "emitter": {"type": "area", "radiance": rgb(6, 5, 4)}}},  # in the medium
    "glow": {},  # of the ground
    "own light": {},  # of the medium
}


class Parameter(NamedTuple):
    """Names that a parameter may have, of which a scene has one, and the step of differences: a share of its size."""

    names: tuple[str, ...]
    step: float = 0.1
    least: float = 0.25  # that the size counts as, of values near 0
    poses: bool = False  # is a pose


PARAMETERS = {
    "extinction": Parameter(("air.sigma_t.value.value", "air.sigma_t.data")),
    "albedo": Parameter(("air.albedo.value.value", "air.albedo.data")),
    "scale": Parameter(("air.scale",)),
    "emission": Parameter(("air.emission.value.value", "air.emission.data"), 0.5),
    "g": Parameter(("air.phase_function.g",), 0.15),
    "weight": Parameter(("air.phase_function.weight.value.value", "air.phase_function.weight.data"), 0.14, 1.0),
    "g of the first": Parameter(("air.phase_function.phase_0.g",), 0.15),
    "g of the second": Parameter(("air.phase_function.phase_1.g",), 0.15),
    "values": Parameter(("air.phase_function.values",), 0.04),
    "S": Parameter(("air.phase_function.S.data",), 0.03),
    "extinction of the core": Parameter(("core.interior.sigma_t.value.value",)),
    "reflectance of the stone": Parameter(("stone.bsdf.reflectance.value",)),
    "reflectance of the wall": Parameter(("wall.bsdf.reflectance.value",)),
    "radiance": Parameter(("lamp.emitter.radiance.value", "ember.emitter.radiance.value", "wall.emitter.radiance.value",
                           "sky.radiance.value")),
    "intensity": Parameter(("bulb.intensity.value",)),
    "roughness": Parameter(("body.bsdf.alpha.value",)),
    "place of the bulb": Parameter(("bulb.position",), 0.02),
    "pose of the bulb": Parameter(("bulb.to_world",), 0.02, poses=True),
    "pose of the body": Parameter(("body.to_world",), 0.05, poses=True),
    "pose of the core": Parameter(("core.to_world",), 0.08, poses=True),
    "pose of the camera": Parameter(("camera.to_world",), 0.05, poses=True),
    "pose of the lamp": Parameter(("lamp.to_world",), 0.05, poses=True),
}


def scene_of(row: Row) -> dict[str, Any]:
    """The scene of a row in Mitsuba's dict vocabulary, with transforms and values as arrays."""
    medium, camera = MEDIA[row.medium], CAMERAS[row.camera]
    enclosed = row.boundary != "none"
    if row.camera == "inside" or not enclosed:
        camera = camera | {"medium": AIR}
    body = {"body": BODIES[medium["type"]] | {"bsdf": BOUNDARIES[row.boundary], "interior": AIR}} if enclosed else {}
    ground = row.ground or GROUND_OF.get(row.light, "nothing")
    return {"type": "scene", "air": medium | {"phase": PHASES[row.phase]}, "camera": camera, **body,
            **EMBEDDED[row.embedded], **GROUNDS[ground], **LIGHTS[row.light]}


SKIES = ("constant", "envmap", "sunsky", "directional")
PUNCTUAL = ("point", "spot", "projector")
LAMPS = (*PUNCTUAL, "area", "directionalarea", "ember", "glow")  # whose light comes through fog everywhere
FOGS = ("empty", "empty in red", "thin", "grey", "coloured", "dense")
SMOKES = ("empty smoke", "half empty smoke", "thin smoke", "smoke", "coloured smoke", "dense smoke")


def extinctions() -> list[Row]:
    """Values of extinction in every boundary; smoke in two of them in turn."""
    lit = {"none": ("area", "glow"), "null": ("constant", "point", "glow"), "dielectric": ("constant", "glow"),
           "roughdielectric": ("glow", "constant")}
    found = []
    for turn, (boundary, lights) in enumerate(lit.items()):
        media = [*FOGS[:5 if boundary == "none" else 6], *SMOKES[turn % 2::2]]
        for place, medium in enumerate(media):
            light = lights[place % len(lights)]
            found.append(Row(medium, boundary, light, "extinction", ground="wall" if light == "area" else ""))
    return found


def lights() -> list[Row]:
    """Every light, through a boundary that is not seen, and in fog."""
    enclosed = [Row("coloured", "null", light, "extinction", "hg") for light in (*SKIES, *LAMPS)]
    enclosed += [Row(medium, "null", light, "extinction", "hg") for medium, lights in {
        "half empty smoke": ("envmap", "directional"), "smoke": ("point", "spot", "ember")}.items() for light in lights]
    # Light of a point inside of what scatters more than once has no variance.
    return enclosed + [Row("fog", "none", light, "extinction", "hg", depth=2 if light in PUNCTUAL else 4)
                       for light in LAMPS]


def colours() -> list[Row]:
    """Albedo at both ends and between, and the factor of extinction."""
    media = {"black": "null", "coloured": "roughdielectric", "white": "none", "smoke": "dielectric",
             "smoke of colours": "null", "half black smoke": "null"}
    found = [Row(medium, boundary, "area" if boundary == "none" else "constant", "albedo")
             for medium, boundary in media.items()]
    return found + [Row(medium, "null", "envmap", "scale") for medium in (
        "scaled", "scaled by 0", "scaled smoke", "smoke scaled by 0")]


def phases() -> list[Row]:
    """Every parameter of phase functions, in homogeneous media and others."""
    parameters = {"hg backwards": "g", "hg even": "g", "hg sharp": "g", "tabphase": "values", "sggx": "S",
                  "blendphase 0.0": "weight", "blendphase 0.3": "weight", "blendphase 1.0": "weight",
                  "blendphase of a grid": "weight"}
    found = [Row(medium, "null", "point", parameter, phase) for phase, parameter in parameters.items()
             for medium in ("coloured", "smoke")]
    return found + [
        Row("grey", "null", "point", "g of the first", "blendphase 0.3"),
        Row("grey", "null", "point", "g of the second", "blendphase 0.3"),
        Row("grey", "roughdielectric", "glow", "g", "hg"), Row("grey", "none", "point", "g", "hg", depth=2),
        Row("coloured", "null", "envmap", "extinction", "sggx"), Row("smoke", "null", "envmap", "extinction", "sggx"),
        Row("coloured", "null", "area", "extinction", "rayleigh"), Row("coloured", "null", "area", "extinction", "tabphase")]


def embedded() -> list[Row]:
    """What stands in a medium, a camera in it, and what else is seen through it."""
    surfaces = [Row(medium, boundary, "constant", "extinction", embedded=stone)
                for medium in ("grey", "smoke") for boundary in ("null", "dielectric")
                for stone in ("stone", "pearl")]
    cameras = [Row(medium, "null", light, parameter, "hg", "inside")
               for medium, light in (("coloured", "glow"), ("half empty smoke", "glow"))
               for parameter in ("extinction", "albedo", "g")]
    return surfaces + cameras + [
        Row("coloured", "null", "spot", "extinction", "hg", "inside"),
        Row("grey", "null", "constant", "extinction", embedded="core"),
        Row("grey", "null", "constant", "extinction of the core", embedded="core"),
        Row("grey", "null", "area", "reflectance of the stone", embedded="stone"),
        Row("smoke", "null", "area", "reflectance of the wall", ground="wall"), Row("coloured", "null", "area", "radiance"),
        Row("coloured", "null", "point", "intensity"), Row("thin", "roughdielectric", "glow", "roughness")]


def emission() -> list[Row]:
    """What media emit by themselves: without extinction or emission, in colours, behind glass, around what moves."""
    named = {"emission": {"null": ("glowing fog", "glowing emptiness", "fog that glows in red", "glowing smoke",
                                   "half glowing smoke", "glowing empty smoke"),
                          "dielectric": ("glowing fog", "glowing smoke"), "roughdielectric": ("glowing grid in fog",)},
             "extinction": {"null": ("glowing grid in fog", "glowing emptiness", "glowing smoke", "glowing empty smoke"),
                            "dielectric": ("glowing fog", "half glowing smoke"), "roughdielectric": ("glowing smoke",),
                            "none": ("glowing fog",)},
             "albedo": {"null": ("glowing fog", "glowing smoke")}, "scale": {"null": ("dense glowing smoke",)},
             "pose of the body": {"null": ("glowing fog", "glowing grid in fog")},
             "pose of the camera": {"null": ("glowing fog",)}}
    found = [Row(medium, boundary, "own light", parameter) for parameter, boundaries in named.items()
             for boundary, media in boundaries.items() for medium in media]
    return found + [Row("glowing smoke", "null", "own light", "emission", "hg", "inside"),
                    Row("glowing smoke", "null", "own light", "reflectance of the stone", embedded="stone"),
                    Row("glowing fog", "null", "own light", "pose of the core", embedded="core"),
                    Row("glowing fog", "dielectric", "own light", "pose of the body", depth=2),
                    Row("glowing fog", "null", "envmap", "extinction", "hg", depth=24)]


def long_paths() -> list[Row]:
    """Many bounces, of which roulette ends some."""
    return [Row("coloured", "null", "constant", "extinction", "hg", depth=24),
            Row("smoke", "roughdielectric", "constant", "albedo", depth=24),
            Row("fog", "none", "area", "extinction", "hg", depth=24)]


def poses() -> list[Row]:
    """What moves such that no edge does: nothing is behind it, or it is a ball, at whose rim all light goes through."""
    return [Row("coloured", "null", "glow", "pose of the body"),
            Row("coloured", "null", "glow", "pose of the body", depth=1),
            Row("grey", "null", "glow", "pose of the core", embedded="core"),
            Row("coloured", "null", "glow", "pose of the camera"), Row("fog", "none", "area", "pose of the camera", depth=2),
            Row("coloured", "null", "point", "place of the bulb"),
            Row("coloured", "none", "point", "place of the bulb", depth=2),
            Row("coloured", "null", "area", "pose of the lamp"), Row("coloured", "null", "spot", "pose of the bulb")]


def rows() -> list[Row]:
    return [*extinctions(), *lights(), *colours(), *phases(), *embedded(), *emission(), *long_paths(), *poses()]
