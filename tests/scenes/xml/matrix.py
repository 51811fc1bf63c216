"""Scenes of one kind each: a material on a shape, with a texture, in one light, generated from a table.

Every supported material, emitter, texture and shape occurs in it; whoever adds one adds a piece to `matrix_pieces`
and a row. The size of the image and the depth are variables of the scene: the tests render small images (`cases`),
`benchmarks.parity` large ones. The textures `blackbody`, `regular` and `irregular` are missing: Mitsuba's RGB modes evaluate
spectra only where they are written as pairs or as a file.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.scenes.xml.files import Case, Folder, diffuse, placed, scene_xml, shape
from tests.scenes.xml.layered import twosided
from tests.scenes.xml.matrix_pieces import BSDFS, CAMERAS, SHAPES, files, light

SMALL = {"width": 16, "height": 12, "max_depth": 6}  # the images of the tests


class Row(NamedTuple):
    """What a scene is made of, by the names in `matrix_pieces`."""

    bsdf: str
    emitter: str
    texture: str
    shape: str
    camera: str = "perspective"
    rfilter: str = "box"

    def __str__(self) -> str:
        """A name that can be one of a file."""
        special = [piece for piece in self[4:] if piece not in ("perspective", "box")]
        return "-".join([*self[:4], *special]).replace(" ", "_").replace(":", "_of_")


MATRIX = (
    Row("diffuse", "area", "bitmap", "rectangle"),
    Row("diffuse", "point", "checkerboard", "cube"),
    Row("diffuse", "envmap", "vertex attribute", "attributes"),
    Row("diffuse", "textured constant:d65", "spd", "disk"),
    Row("diffuse", "textured area:pairs", "srgb", "sphere", "orthographic"),
    Row("twosided", "projector:nearest", "pairs", "mesh"),
    Row("twosided", "area sphere", "raw", "rectangle"),
    Row("conductor", "envmap", "bitmap", "cube"),
    Row("conductor", "area mesh", "pairs", "sphere"),
    Row("roughconductor", "area disk", "rgb", "mesh"),
    Row("roughconductor", "spot", "checked bitmap", "facets"),
    Row("roughconductor alpha", "area", "checkerboard", "rectangle"),
    Row("roughconductor alpha", "compensated envmap", "face attribute", "attributes"),
    Row("roughconductor brushed", "textured spot:bitmap", "rawconstant", "disk"),
    Row("roughconductor brushed", "area cube", "nearest", "sphere"),
    Row("roughconductor", "area", "uniform", "cube"),
    Row("dielectric", "constant", "rgb", "sphere"),
    Row("dielectric", "envmap", "checkerboard", "cube"),
    Row("thindielectric", "area", "bitmap", "rectangle"),
    Row("thindielectric", "textured constant:pairs", "none", "mesh"),
    Row("roughdielectric", "envmap", "uniform", "sphere"),
    Row("roughdielectric", "area sphere", "raw", "cube"),
    Row("roughdielectric alpha", "area", "bitmap", "mesh"),
    Row("plastic", "directional", "bitmap", "sphere"),
    Row("plastic", "area mesh", "pairs", "disk", "orthographic"),
    Row("plastic nonlinear", "envmap", "checked bitmap", "mesh"),
    Row("roughplastic", "spot", "rawconstant", "attributes"),
    Row("roughplastic", "textured area:bitmap", "spd", "cube"),
    Row("roughplastic nonlinear", "area", "nearest", "facets"),
    Row("principled", "area", "bitmap", "sphere"),
    Row("principled", "envmap", "vertex attribute", "attributes"),
    Row("principled metal", "area disk", "bitmap", "mesh"),
    Row("principled metal", "constant", "number", "disk"),
    Row("principled glass", "area", "checkerboard", "sphere"),
    Row("principled glass", "envmap", "number", "mesh"),
    Row("principled lacquer", "textured area:d65", "raw", "cube"),
    Row("principled lacquer", "area", "face attribute", "attributes"),
    Row("principled cloth", "directional", "bitmap", "mesh"),
    Row("principledthin", "area", "pairs", "rectangle"),
    Row("principledthin", "envmap", "bitmap", "disk"),
    Row("principledthin glass", "area sphere", "checkerboard", "rectangle"),
    Row("blendbsdf", "area", "bitmap", "sphere"),
    Row("blendbsdf", "point", "face attribute", "attributes"),
    Row("mask", "envmap", "bitmap", "mesh"),
    Row("mask", "area cube", "checkerboard", "rectangle"),  # not closed: see tests/bsdf/test_closed_mask.py
    Row("normalmap", "area", "rgb", "mesh"),
    Row("normalmap metal", "envmap", "bitmap", "cube"),
    Row("bumpmap", "area", "bitmap", "mesh"),
    Row("bumpmap metal", "envmap", "raw", "rectangle"),
    Row("roughconductor", "envmap", "rgb", "cylinder"),
    Row("twosided", "area", "checkerboard", "cylinder"),
    Row("diffuse", "area disk", "bitmap", "instance"),
    Row("roughdielectric", "envmap", "rgb", "instance"),
    Row("twosided", "spot", "checkerboard", "serialized"),
    Row("twosided", "envmap", "bitmap", "serialized", "thinlens"),
    Row("roughconductor", "area", "bitmap", "sphere", "thinlens"),
    Row("diffuse", "sunsky", "bitmap", "sphere"),
    Row("roughconductor", "sunsky", "checkerboard", "mesh"),
    Row("null", "projector:rgb", "none", "sphere"),
    Row("roughplastic", "area", "bitmap", "mesh", rfilter="mitchell"),
    Row("twosided", "envmap", "checkerboard", "cube", rfilter="catmullrom"),
    Row("diffuse", "point", "nearest", "sphere", rfilter="lanczos"),
    Row("roughconductor all facets", "area", "bitmap", "cylinder"),
    Row("roughdielectric all facets", "envmap", "rgb", "sphere"),
    Row("roughplastic all facets", "spot", "checkerboard", "cube"),
    Row("diffuse", "beam:rgb", "bitmap", "sphere"),
    Row("roughplastic", "beam:nearest", "rgb", "mesh"),
    Row("diffuse", "sunsky", "checked bitmap", "cylinder"),
    Row("principled", "sunsky", "vertex attribute", "attributes", "thinlens"),
    Row("diffuse", "area cube", "face attribute", "attributes", "thinlens", "mitchell"),
)


def built(row: Row) -> Callable[[Folder], Path]:
    """The scene of a row: its shape before a wall on a floor; what makes its files."""

    def build(folder: Folder) -> Path:
        files(folder)
        camera, view = CAMERAS[row.camera]
        film = VARIABLE_SIZE if row.rfilter == "box" else VARIABLE_SIZE + BORDER
        wall = twosided(diffuse("0.5, 0.55, 0.7"))
        body = "".join([
            shape("rectangle", "floor", twosided(diffuse("0.6, 0.5, 0.4")),
                  placed('rotate x="1" angle="-90"', 'scale x="3" z="2.5"')),
            shape("rectangle", "wall", wall, placed('scale x="3" y="1.6"', 'translate y="1.6" z="-1.6"')),
            SHAPES[row.shape](BSDFS[row.bsdf](row.texture)), light(row.emitter)])
        text = scene_xml(film, view, body, '<integer name="max_depth" value="$max_depth"/>',
                         f'<rfilter type="{row.rfilter}"/>', camera)
        return folder.text("scene.xml", text)

    return build


BORDER = '<boolean name="sample_border" value="true"/>'  # wide filters: by it all pixels are filtered alike
VARIABLE_SIZE = '<integer name="width" value="$width"/><integer name="height" value="$height"/>'
ROWS = {f"matrix_{row}": row for row in MATRIX}
assert len(ROWS) == len(MATRIX), "two rows are the same"


SHY = ("area sphere", "area mesh", "area cube")  # half of what is sampled on these lies behind them: more noise


def cases(variables: dict[str, int]) -> dict[str, Case]:
    """The case of every row, with images of a size and of a depth."""
    return {name: case_of(row, variables) for name, row in ROWS.items()}


def case_of(row: Row, variables: dict[str, int]) -> Case:
    """The case of a row. Beams are seen by Mitsuba's particle tracer only; its wide filters share samples among pixels."""
    beam, shy, wide = row.emitter.startswith("beam"), row.emitter in SHY, row.rfilter != "box"
    return Case(built(row), variables, spp=256 if shy or beam else 64, peer_batches=16 if wide else 32,
                peer_spp=2048 if beam else 512 if shy or wide else 128, thin=5 if wide else 1,
                peer_integrator="ptracer" if beam else "path")
