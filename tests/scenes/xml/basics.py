"""Small scenes of shapes, pictures and hidden lamps, and the Cornell box, written as Mitsuba 3 XML into a folder.

Both renderers read the same files. Meshes and pictures are formulas; nothing is downloaded or stored.
"""

from __future__ import annotations

from pathlib import Path

from tests.scenes.xml.files import (
    Folder,
    bitmap,
    bumpy_ball,
    diffuse,
    lamp,
    look,
    octahedron,
    picture,
    placed,
    scene_xml,
    shape,
    size,
    textured,
)

ASSETS = Path(__file__).parents[3] / "assets"
SKY = '\n  <emitter type="constant"><rgb name="radiance" value="{}"/></emitter>'
FLIPPED = '<boolean name="flip_normals" value="true"/>'


def cornell_box(folder: Folder) -> Path:
    return folder.text("scene.xml", (ASSETS / "cornell_box" / "scene.xml").read_text())


def file(name: str) -> str:
    return f'<string name="filename" value="{name}"/>'


def ball(x: float, y: float, z: float, radius: float) -> str:
    return f'<point name="center" x="{x}" y="{y}" z="{z}"/><float name="radius" value="{radius}"/>'


def shapes(folder: Folder) -> Path:
    """Every shape, with flipped normals, face normals, and area lights that are a sphere and a disk."""
    bumpy_ball(folder, "smooth.obj", normals=True)
    bumpy_ball(folder, "plain.obj", normals=False)
    octahedron(folder, "octahedron.ply")
    folder.pixels("stripes.png", picture(6, 12, seed=3))
    ref = '<ref id="{}"/>'.format
    bsdfs = f"""
  <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.6"/></bsdf>
  <bsdf type="twosided" id="both">{diffuse("0.3, 0.5, 0.7")}</bsdf>"""
    return folder.text("scene.xml", scene_xml(size(48, 36), look("0.3, 2.6, 6.2", "0, 0.7, 0", 48), bsdfs + "".join([
        shape("rectangle", "floor", placed('rotate x="1" angle="-90"', 'scale x="5" z="4"'), ref("grey")),
        shape("sphere", "ball", ball(-2.2, 0.7, 0.6, 0.7), diffuse("0.8, 0.3, 0.2")),
        shape("sphere", "globe", textured("stripes.png"), placed(
            'scale value="0.7"', 'rotate z="1" angle="25"', 'rotate y="1" angle="40"', 'translate x="-0.7" y="0.9" z="-1"')),
        shape("sphere", "lamp", ball(1.6, 3.3, 1.2, 0.25), diffuse("0"), lamp("30, 26, 20")),
        shape("disk", "dish", ref("both"), placed(
            'scale value="0.8"', 'rotate x="1" angle="-70"', 'translate x="2.4" y="0.8" z="-0.6"')),
        # No material: an emitter's is black, not the usual grey.
        shape("disk", "spot", FLIPPED, lamp("6, 9, 14"), placed(
            'scale value="0.5"', 'rotate x="1" angle="-90"', 'translate x="-2" y="3.4" z="-1"')),
        shape("cube", "box", diffuse("0.2, 0.7, 0.3"), placed(
            'scale x="0.4" y="0.3" z="0.5"', 'rotate y="1" angle="35"', 'rotate x="1" angle="20"',
            'translate x="0.5" y="0.6" z="1.8"')),
        shape("cube", "room", FLIPPED, diffuse("0.6, 0.55, 0.5"), placed('scale x="6" y="4" z="8"', 'translate y="3.5"')),
        shape("obj", "smooth", file("smooth.obj"), textured("stripes.png"),
              placed('scale value="0.6"', 'translate x="0.6" y="0.75" z="0.1"')),
        shape("obj", "faceted", file("smooth.obj"), '<boolean name="face_normals" value="true"/>', ref("both"),
              placed('scale value="0.5"', 'translate x="1.9" y="0.6" z="1.2"')),
        shape("obj", "plain", file("plain.obj"), ref("both"),
              placed('scale value="0.45"', 'translate x="-1.1" y="0.55" z="1.8"')),
        shape("ply", "octahedron", file("octahedron.ply"), diffuse("0.7, 0.7, 0.2"), placed(
            'scale value="0.6"', 'rotate y="1" angle="20"', 'translate x="0.2" y="2.4" z="-1.5"')),
    ])))


# How the twelve tiles read their bitmap: file, attributes, to_uv.
BITMAPS = [
    ("a.png", "", ""),
    ("a.png", "nearest", ""),
    ("a.png", "raw", ""),
    ("a.png", "repeat", '<scale x="2.5" y="1.7"/>'),
    ("a.png", "mirror", '<scale x="2.5" y="1.7"/><translate x="-0.8" y="0.3"/>'),
    ("a.png", "clamp", '<scale x="2" y="2"/><translate x="-0.5" y="-0.5"/>'),
    ("a.png", "mirror nearest", '<scale x="3" y="3"/><translate x="-1.2" y="-1.1"/>'),
    ("b.jpg", "", ""),
    ("b.jpg", "raw", '<rotate z="1" angle="30"/>'),
    ("c.exr", "", ""),
    ("d.exr", "clamp nearest", '<rotate z="1" angle="-20"/><scale x="1.5" y="0.7"/>'),
    ("d.exr", "raw", '<scale x="-1" y="1"/><translate x="1"/>'),
]
WORDS = {
    "raw": '<boolean name="raw" value="true"/>', "nearest": '<string name="filter_type" value="nearest"/>',
    **{mode: f'<string name="wrap_mode" value="{mode}"/>' for mode in ("repeat", "mirror", "clamp")},
}


def bitmaps(folder: Folder) -> Path:
    """Twelve tiles, one for each way to read a bitmap, and a lamp whose radiance is a bitmap."""
    folder.pixels("a.png", picture(8, 8, seed=97))
    folder.pixels("b.jpg", picture(8, 8, seed=98), quality=95)
    folder.pixels("c.exr", picture(8, 8, seed=99), compression="piz")
    folder.pixels("d.exr", picture(5, 7, seed=100))
    folder.pixels("lamp.exr", 12 * picture(4, 6, seed=11) ** 3)
    tiles = []
    for k, (name, words, to_uv) in enumerate(BITMAPS):
        transform = f'<transform name="to_uv">{to_uv}</transform>' if to_uv else ""
        texture = bitmap("reflectance", name, "".join(WORDS[word] for word in words.split()) + transform)
        place = placed('scale x="0.48" y="0.48"', f'translate x="{k % 4 - 1.5}" y="{1 - k // 4}"')
        tiles.append(shape("rectangle", f"tile_{k}", place, f'<bsdf type="diffuse">{texture}</bsdf>'))
    tiles.append(shape("rectangle", "lamp", f'<emitter type="area">{bitmap("radiance", "lamp.exr")}</emitter>', placed(
        'scale x="1.2" y="0.8"', 'rotate x="1" angle="145"', 'translate y="2.2" z="1.5"')))
    return folder.text("scene.xml", scene_xml(size(64, 48), look("0, 0, 4.2", "0, 0, 0", 52),
                                              "".join(tiles) + SKY.format("0.15, 0.1, 0.2"),
                                              '<integer name="max_depth" value="3"/>'))


def sky(folder: Folder) -> Path:
    """A constant sky, two-sided sheets with one and two materials, early roulette, unlimited depth, a tent filter."""
    folder.pixels("sheet.png", picture(8, 8, seed=5))
    two_faced = f'\n  <bsdf type="twosided" id="two_faced">{textured("sheet.png")}{diffuse("0.9, 0.2, 0.1")}</bsdf>'
    sheet = 'scale x="0.6" y="0.6"'
    return folder.text("scene.xml", scene_xml(
        size(40, 32), look("0.5, 1.6, 4", "0, 0.5, 0", 50), two_faced + "".join([
            shape("rectangle", "floor", f'<bsdf type="twosided">{diffuse("0.75")}</bsdf>',
                  placed('rotate x="1" angle="-90"', 'scale x="2.5" z="2.5"')),
            shape("rectangle", "front", '<ref id="two_faced"/>',
                  placed(sheet, 'rotate y="1" angle="30"', 'translate x="-1" y="0.7"')),
            shape("rectangle", "reversed", '<ref id="two_faced"/>',
                  placed(sheet, 'rotate y="1" angle="200"', 'translate x="0.8" y="0.7" z="-0.3"')),
            shape("rectangle", "one_sided_from_behind", diffuse("0.9"),
                  placed('scale x="0.25" y="0.25"', 'rotate y="1" angle="180"', 'translate y="0.4" z="1.2"')),
        ]) + SKY.format("0.6, 0.9, 1.4"),
        '<integer name="max_depth" value="-1"/><integer name="rr_depth" value="2"/>',
        '<rfilter type="tent"/><boolean name="sample_border" value="true"/>'))


def hidden_emitters(folder: Folder) -> Path:
    """hide_emitters: a lamp and a sky that light the scene but are not seen; what is behind the lamp is.

    Mitsuba's side uses `volpath`: with a hidden area light in view, its `path` is 3 times too bright behind the light in
    scalar_rgb and black there in llvm_ad_rgb (3.9.1). `volpath` gives, in both, what either integrator shows when the
    camera's near plane cuts the lamp off instead.
    """
    return folder.text("scene.xml", scene_xml(
        size(32, 32), look("0, 1, 4", "0, 0.6, 0", 50), "".join([
            shape("rectangle", "floor", diffuse("0.5, 0.6, 0.7"), placed('rotate x="1" angle="-90"', 'scale x="2" z="2"')),
            shape("sphere", "ball", ball(0.6, 0.5, -0.4, 0.5), diffuse("0.7, 0.4, 0.2")),
            shape("rectangle", "lamp", diffuse("0.5"), lamp("7, 6, 4"), placed(
                'scale x="0.4" y="0.4"', 'rotate y="1" angle="170"', 'translate x="0.2" y="0.7" z="0.8"')),
        ]) + SKY.format("0.3, 0.35, 0.4"),
        '<integer name="max_depth" value="5"/><boolean name="hide_emitters" value="true"/>'))
