"""Scenes of cylinders, serialized meshes and instances."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tests.scenes.xml.basics import FLIPPED, SKY, ball, file
from tests.scenes.xml.files import Folder, bumpy_ball, diffuse, lamp, look, picture, placed, scene_xml, shape, size, textured

FLAT = '<boolean name="face_normals" value="true"/>'
MIRROR = 'scale x="-1" y="1" z="1"'


def tube(start: str, end: str, radius: float) -> str:
    """The attributes of a cylinder between two points."""
    return f'<point name="p0" value="{start}"/><point name="p1" value="{end}"/><float name="radius" value="{radius}"/>'


def bowl(normals: bool, rows: int = 7, columns: int = 16) -> dict[str, Any]:
    """The arguments of `serialized_files.mesh` for a bowl with texture coordinates, open towards +z."""
    height, turn = (values.ravel() for values in np.meshgrid(np.linspace(0.05, 1, rows), np.linspace(0, 1, columns + 1),
                                                             indexing="ij"))
    angle = 2 * np.pi * turn
    points = np.stack([height * np.cos(angle), height * np.sin(angle), height**2], 1)
    corner = (np.arange(rows - 1)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    above = corner + columns + 1
    faces = np.concatenate([np.stack([corner, corner + 1, above + 1], 1), np.stack([corner, above + 1, above], 1)])
    made = {"vertices": points, "uv": np.stack([2 * turn, height], 1)}
    if normals:
        made["normals"] = np.stack([-2 * points[:, 0], -2 * points[:, 1], np.ones(len(points))], 1)
    return {name: values.round(6).tolist() for name, values in made.items()} | {"faces": faces.tolist()}


def tubes(folder: Folder) -> Path:
    """Cylinders seen from outside and inside, mirrored, textured, and as a lamp; serialized meshes; mirrored spheres."""
    folder.pixels("stripes.png", picture(6, 12, seed=3))
    folder.serialized("bowls.serialized", bowl(True), bowl(False) | {"double": True, "flags": 0x10}, bowl(False))
    folder.serialized("old.serialized", bowl(True) | {"version": 3}, bowl(True) | {"version": 3})
    bsdfs = f"""
  <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.6"/></bsdf>
  <bsdf type="twosided" id="both">{diffuse("0.3, 0.5, 0.7")}</bsdf>
  <bsdf type="twosided" id="striped">{textured("stripes.png")}</bsdf>"""
    ref = '<ref id="{}"/>'.format

    def at(x: float, y: float, z: float, *steps: str) -> str:
        return placed(*steps, f'translate x="{x}" y="{y}" z="{z}"')

    def mesh(name: str, index: int) -> str:
        return file(name) + f'<integer name="shape_index" value="{index}"/>'

    tilted = ('scale value="0.5"', 'rotate x="1" angle="-50"', 'rotate y="1" angle="20"')
    return folder.text("scene.xml", scene_xml(size(48, 36), look("0.3, 2.6, 6.2", "0, 0.9, 0", 48), bsdfs + "".join([
        shape("rectangle", "floor", placed('rotate x="1" angle="-90"', 'scale x="5" z="4"'), FLAT, ref("grey")),
        shape("cylinder", "post", tube("-2.2, 0, 0.2", "-1.9, 1.4, -0.3", 0.4), textured("stripes.png")),
        shape("cylinder", "pipe", tube("-1, 0.5, 1", "-0.2, 0.8, 1.9", 0.35), ref("striped")),
        shape("cylinder", "ring", at(0.9, 0.6, 1.4, 'scale value="0.5"', 'rotate y="1" angle="30"'), FLIPPED,
              diffuse("0.8, 0.4, 0.2")),
        shape("cylinder", "mirrored", at(2.4, 0, -0.5, MIRROR, 'scale x="0.5" y="0.5" z="1.3"', 'rotate x="1" angle="-80"'),
              textured("stripes.png")),
        shape("cylinder", "tube", tube("-1.5, 2.6, 0.8", "-0.2, 2.9, 0.4", 0.06), diffuse("0"), lamp("40, 36, 30")),
        shape("cylinder", "inside_out", tube("0.7, 2.4, 0.6", "1.7, 2.7, 0.9", 0.15), FLIPPED, lamp("3, 5, 9")),
        shape("serialized", "smooth", mesh("bowls.serialized", 0), at(0.3, 0.1, -0.6, *tilted), ref("striped")),
        shape("serialized", "computed", mesh("bowls.serialized", 1), at(1.5, 0.1, -0.2, *tilted), ref("both")),
        shape("serialized", "flat", mesh("bowls.serialized", 2), FLAT, at(-0.8, 0.1, -1, *tilted), ref("both")),
        shape("serialized", "old", mesh("old.serialized", 1), FLIPPED,
              at(1.9, 1.9, -1.5, 'scale value="0.6"', 'rotate x="1" angle="40"'), textured("stripes.png")),
        shape("sphere", "hollow", ball(0, 0, 0, 0.45), at(-0.4, 2, -1.4, MIRROR), diffuse("0.9, 0.2, 0.1")),
        shape("sphere", "hollow_flipped", ball(0, 0, 0, 0.35), FLIPPED, at(-1.7, 2, -1.3, MIRROR), textured("stripes.png")),
        shape("cube", "die", FLAT, textured("stripes.png"),
              at(0.1, 0.25, 2.4, 'scale value="0.2"', 'rotate y="1" angle="35"')),
    ]) + SKY.format("0.25, 0.3, 0.4")))


def knot(count: int, noise: float = 0.0) -> np.ndarray:
    """Distances, but for noise, from a ring with a ball in it, on a cube of points; the same along x, y and z in number.

    Mitsuba 3.9.1 exchanges the sizes of voxels along x and z, and loses the surface if `to_world` turns it.
    """
    z, y, x = np.meshgrid(*3 * [np.linspace(-1, 1, count)], indexing="ij")
    ring = np.hypot(np.hypot(x, y) - 0.6, z) - 0.2
    ball = np.sqrt(x**2 + (y - 0.2)**2 + z**2) - 0.35
    return np.minimum(ring, ball) + noise * np.random.default_rng(4).uniform(-1, 1, x.shape)


def distances(folder: Folder) -> Path:
    """Grids of distances: fine and coarse, with both kinds of normals, squeezed, turned, mirrored, cut off, and of glass."""
    folder.volume("fine.vol", knot(40))
    folder.volume("coarse.vol", knot(9, 0.04))
    folder.volume("wave.vol", np.fromfunction(lambda z, y, x: (z - 2.3 - np.sin(x) + 0.4 * np.cos(y)) / 5, (6, 6, 6)))
    bsdfs = f"""
  <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.6"/></bsdf>
  <bsdf type="twosided" id="both">{diffuse("0.3, 0.5, 0.7")}</bsdf>
  <bsdf type="roughconductor" id="metal"><string name="material" value="Cu"/><float name="alpha" value="0.3"/></bsdf>"""
    ref = '<ref id="{}"/>'.format
    analytic = '<string name="normals" value="analytic"/>'

    def at(x: float, y: float, z: float, factor: str, *steps: str) -> str:
        return placed('translate value="-0.5"', f"scale {factor}", *steps, f'translate x="{x}" y="{y}" z="{z}"')

    tilted = ('rotate x="1" angle="-25"', 'rotate y="1" angle="30"')
    return folder.text("scene.xml", scene_xml(size(48, 36), look("0.3, 2.6, 6.2", "0, 0.9, 0", 48), bsdfs + "".join([
        shape("rectangle", "floor", placed('rotate x="1" angle="-90"', 'scale x="5" z="4"'), FLAT, ref("grey")),
        shape("sdfgrid", "fine", file("fine.vol"), at(-1.5, 0.9, 0.2, 'value="1.7"'), diffuse("0.8, 0.4, 0.2")),
        shape("sdfgrid", "kinks", file("coarse.vol"), analytic, at(0.2, 0.8, 0.9, 'x="1.5" y="1.3" z="2"'), ref("metal")),
        shape("shapegroup", "rings", shape("sdfgrid", "smooth", file("coarse.vol"), ref("metal"))),
        shape("instance", "ring", ref("rings"), at(1.9, 1, 0.3, 'value="1.7"', *tilted)),
        shape("shapegroup", "waves", shape("sdfgrid", "wave", file("wave.vol"), ref("both"))),
        shape("instance", "mirrored", ref("waves"), at(0.3, 2.2, -0.9, 'x="2" y="1.4" z="-0.8"', *tilted)),
        shape("sdfgrid", "glass", file("fine.vol"), analytic, '<bsdf type="roughdielectric"/>',
              at(-0.5, 0.45, 2.3, 'x="0.9" y="0.7" z="1.2"')),
        shape("rectangle", "lamp", lamp("9, 8, 7"), placed(
            'scale value="0.6"', 'rotate x="1" angle="100"', 'translate x="0.8" y="3.6" z="1"')),
    ]) + SKY.format("0.25, 0.3, 0.4")))


def instances(folder: Folder) -> Path:
    """Two groups, one of them shown once: turned, squeezed, sheared and mirrored, in the light of a lamp and a sky."""
    folder.pixels("stripes.png", picture(6, 12, seed=3))
    bumpy_ball(folder, "smooth.obj", normals=True)
    folder.serialized("bowls.serialized", bowl(True))
    bsdfs = f"""
  <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.6"/></bsdf>
  <bsdf type="twosided" id="striped">{textured("stripes.png")}</bsdf>"""
    plant = "".join([
        shape("sphere", "fruit", ball(0, 1.5, 0, 0.3), diffuse("0.8, 0.3, 0.2")),
        shape("serialized", "leaf", file("bowls.serialized"), '<ref id="striped"/>', placed(
            'scale value="0.6"', 'rotate x="1" angle="-80"', 'rotate y="1" angle="25"', 'translate y="0.5" z="0.1"')),
        shape("cube", "pot", diffuse("0.3, 0.5, 0.2"), placed('scale x="0.3" y="0.2" z="0.3"', 'translate y="0.2"')),
        shape("disk", "label", textured("stripes.png"), placed('scale value="0.2"', 'translate y="0.2" z="0.31"')),
    ])
    lonely = shape("obj", "bumpy", file("smooth.obj"), textured("stripes.png"), placed('scale value="0.5"'))
    sheared = placed('matrix value="0.7 0.3 0 2.2  0 0.7 0.2 0  0.1 0 0.7 0.4  0 0 0 1"')
    return folder.text("scene.xml", scene_xml(size(48, 36), look("0.3, 2.6, 6.2", "0, 0.9, 0", 48), bsdfs + "".join([
        shape("rectangle", "floor", placed('rotate x="1" angle="-90"', 'scale x="5" z="4"'), '<ref id="grey"/>'),
        shape("shapegroup", "plant", plant), shape("shapegroup", "lonely", lonely),
        shape("shapegroup", "unseen", shape("sphere", "ghost", ball(0, 1, 3, 0.5))),
        shape("instance", "first", '<ref id="plant"/>'),
        shape("instance", "turned", '<ref id="plant"/>', placed(
            'scale x="1.2" y="0.7" z="0.8"', 'rotate y="1" angle="50"', 'translate x="-2.1" z="-0.4"')),
        shape("instance", "mirrored", '<ref id="plant"/>', placed(
            MIRROR, 'scale value="0.7"', 'rotate x="1" angle="15"', 'translate x="1.1" z="1.4"')),
        shape("instance", "sheared", '<ref id="plant"/>', sheared),
        shape("instance", "single", '<ref id="lonely"/>', placed(
            'scale x="1" y="-1" z="0.6"', 'rotate z="1" angle="20"', 'translate x="-1.1" y="0.5" z="1.6"')),
        shape("rectangle", "lamp", lamp("9, 8, 7"), placed(
            'scale value="0.5"', 'rotate x="1" angle="100"', 'translate x="0.8" y="3.2" z="1"')),
    ]) + SKY.format("0.25, 0.3, 0.4")))
