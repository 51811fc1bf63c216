"""Small scenes that between them use every supported plugin, written as Mitsuba 3 XML into a folder.

Both renderers read the same files. Meshes and pictures are formulas; nothing is downloaded or stored.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

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


def points(folder: Folder) -> Path:
    """Point lights, smooth normals, and clip planes that cut the nearer and the farther ball."""
    bumpy_ball(folder, "smooth.obj", normals=True)
    balls = [(-0.9, 1.4, "0.8, 0.4, 0.3"), (0.2, 0, "0.4, 0.8, 0.4"), (1.4, -2.2, "0.3, 0.4, 0.9")]
    clip = '<float name="near_clip" value="2.6"/><float name="far_clip" value="6.1"/>'
    return folder.text("scene.xml", scene_xml(
        size(40, 30), clip + look("0, 1.4, 4", "0, 0.4, 0", 48), "".join([
            *(shape("obj", f"ball_{k}", file("smooth.obj"), diffuse(colour),
                    placed('scale value="0.6"', f'translate x="{x}" y="0.5" z="{z}"'))
              for k, (x, z, colour) in enumerate(balls)),
            shape("rectangle", "floor", diffuse("0.6"),
                  placed('rotate x="1" angle="-90"', 'scale x="4" z="4"', 'translate y="-0.2"')),
        ]) + f"""
  <emitter type="point" id="first">
    <point name="position" x="2" y="3" z="2"/><rgb name="intensity" value="18, 15, 9"/>
  </emitter>
  <emitter type="point">
    {placed('translate x="-2.5" y="2" z="0.5"')}<rgb name="intensity" value="3, 5, 9"/>
  </emitter>""",
        '<integer name="max_depth" value="3"/>'))


def environment(folder: Folder, scale: float = 1.5, more: str = "") -> str:
    """A turned environment map with a small sun, and a black patch."""
    sky = picture(9, 16, seed=31)
    sky[2, 5] = 60, 50, 40
    sky[5:8, 9:13] = 0
    folder.pixels("sky.exr", sky)
    turn = placed('rotate x="1" angle="25"', 'rotate y="1" angle="70"', 'rotate z="1" angle="-15"')
    return f"""
  <emitter type="envmap" id="surroundings">
    {file("sky.exr")}<float name="scale" value="{scale}"/>{turn}{more}
  </emitter>"""


def furnished(folder: Folder) -> str:
    """A floor, a ball with normals and a two-sided sheet, for lights to shine on."""
    bumpy_ball(folder, "smooth.obj", normals=True)
    return "".join([
        shape("rectangle", "floor", f'<bsdf type="twosided">{diffuse("0.7, 0.6, 0.5")}</bsdf>',
              placed('rotate x="1" angle="-90"', 'scale x="2.5" z="2.5"')),
        shape("obj", "ball", file("smooth.obj"), diffuse("0.4, 0.7, 0.8"),
              placed('scale value="0.6"', 'translate x="-0.6" y="0.7" z="0.2"')),
        shape("rectangle", "sheet", f'<bsdf type="twosided">{diffuse("0.8, 0.3, 0.2")}</bsdf>',
              placed('scale x="0.6" y="0.8"', 'rotate y="1" angle="-35"', 'translate x="0.9" y="0.8" z="-0.6"')),
    ])


VIEW = look("0.4, 1.8, 4", "0, 0.5, 0", 48)


def envmap(folder: Folder) -> Path:
    """An environment map alone, which the camera sees, too."""
    return folder.text("scene.xml", scene_xml(size(40, 30), VIEW, furnished(folder) + environment(folder),
                                              '<integer name="max_depth" value="4"/>'))


def envmap_compensated(folder: Folder) -> Path:
    """The same where Mitsuba and we sample only what is brighter than the average."""
    more = '<boolean name="mis_compensation" value="true"/>'
    return folder.text("scene.xml", scene_xml(size(40, 30), VIEW, furnished(folder) + environment(folder, 1, more),
                                              '<integer name="max_depth" value="3"/>'))


def pose(origin: str, target: str) -> str:
    return f'<transform name="to_world"><lookat origin="{origin}" target="{target}" up="0.2, 1, 0.1"/></transform>'


def spots(folder: Folder) -> Path:
    """Spots: with an image, wide, and one whose cone is wider than a half space."""
    folder.pixels("window.exr", picture(5, 7, seed=33))
    return folder.text("scene.xml", scene_xml(size(40, 30), VIEW, furnished(folder) + f"""
  <emitter type="spot" id="image">
    {pose("1.5, 3, 2.5", "-0.2, 0.2, 0")}<rgb name="intensity" value="40, 30, 20"/>
    <float name="cutoff_angle" value="24"/><float name="beam_width" value="20"/>{bitmap("texture", "window.exr")}
  </emitter>
  <emitter type="spot" id="wide">
    {pose("-2.5, 2, 1", "0, 0, 0")}<float name="intensity" value="9"/><float name="cutoff_angle" value="50"/>
    <float name="beam_width" value="5"/>
  </emitter>
  <emitter type="spot" id="widest">
    {pose("0, 1.2, 1.2", "0, 0.5, 3")}<rgb name="intensity" value="0.5, 1, 0.7"/>
    <float name="cutoff_angle" value="130"/>
  </emitter>""", '<integer name="max_depth" value="3"/>'))


def beams(folder: Folder) -> Path:
    """Panels that shine along their normals, plain and with an image, on flat surfaces.

    Mitsuba's side uses its particle tracer: its path tracers never meet this light.
    """
    folder.pixels("panel.exr", picture(5, 7, seed=71))
    above = placed('scale x="1.5" y="1.2"', 'rotate x="1" angle="100"', 'translate x="-0.2" y="3" z="0.5"')
    aside = placed('scale x="0.7" y="0.6"', 'rotate x="1" angle="15"', 'rotate y="1" angle="85"',
                   'translate x="-2.3" y="0.8" z="0.6"')
    plain = '<emitter type="directionalarea"><rgb name="radiance" value="1, 2, 3"/></emitter>'
    image = f'<emitter type="directionalarea">{bitmap("radiance", "panel.exr")}</emitter>'
    return folder.text("scene.xml", scene_xml(size(16, 12), VIEW, "".join([
        shape("cube", "room", FLIPPED, diffuse("0.7, 0.6, 0.5"), placed('scale x="2.6" y="1.8" z="5"', 'translate y="1.8"')),
        shape("cube", "box", diffuse("0.4, 0.7, 0.8"),
              placed('scale value="0.4"', 'rotate y="1" angle="30"', 'translate x="-0.3" y="0.4" z="0.4"')),
        shape("rectangle", "plain", above, diffuse("0"), plain),
        shape("rectangle", "image", aside, diffuse("0"), image),
    ]), '<integer name="max_depth" value="4"/>'))


def projector(folder: Folder) -> Path:
    """Projectors, with a picture and without, upright and wide, beside an area light."""
    folder.pixels("slide.png", picture(6, 9, seed=35))
    folder.pixels("tall.exr", picture(8, 5, seed=36))
    return folder.text("scene.xml", scene_xml(size(40, 30), VIEW, furnished(folder) + shape(
        "rectangle", "lamp", lamp("3, 2, 1"),
        placed('scale x="0.5" y="0.3"', 'rotate x="1" angle="90"', 'translate x="0.6" y="3" z="0.5"')) + f"""
  <emitter type="projector" id="slide">
    {pose("0.5, 2.5, 3.5", "-0.3, 0.5, 0")}{bitmap("irradiance", "slide.png")}<float name="scale" value="6"/>
    <float name="fov" value="35"/><string name="fov_axis" value="diagonal"/>
  </emitter>
  <emitter type="projector" id="tall">
    {pose("-2.5, 2, 2", "0.5, 0.5, -0.5")}{bitmap("irradiance", "tall.exr")}
    <float name="fov" value="40"/><string name="fov_axis" value="y"/>
  </emitter>
  <emitter type="projector" id="plain">
    {pose("2.5, 1.5, 1", "0, 0.3, 0")}<rgb name="irradiance" value="0.5, 0.7, 1"/>
  </emitter>""", '<integer name="max_depth" value="3"/>'))


def every_light(folder: Folder) -> Path:
    """All emitters at once: an environment map, a textured lamp, a point, a spot, a projector, two directional lights."""
    folder.pixels("slide.exr", picture(6, 9, seed=37))
    folder.pixels("lamp.exr", 12 * picture(4, 6, seed=38) ** 3)
    return folder.text("scene.xml", scene_xml(size(40, 30), VIEW, furnished(folder) + environment(folder, 0.3) + shape(
        "rectangle", "lamp", f'<emitter type="area">{bitmap("radiance", "lamp.exr")}</emitter>',
        placed('scale x="0.8" y="0.5"', 'rotate x="1" angle="110"', 'translate x="-1" y="2.2" z="-0.5"')) + f"""
  <emitter type="directional" id="moon">
    <vector name="direction" x="0.3" y="-1" z="-0.5"/><rgb name="irradiance" value="0.5, 0.6, 0.9"/>
  </emitter>
  <emitter type="directional" id="evening">
    {pose("0, 0, 0", "-1, -0.3, -0.4")}<rgb name="irradiance" value="0.9, 0.5, 0.3"/>
    <float name="sampling_weight" value="2"/>
  </emitter>
  <emitter type="point">
    <point name="position" x="1.8" y="1.2" z="1"/><rgb name="intensity" value="1, 2, 1"/>
  </emitter>
  <emitter type="spot">
    {pose("-2.5, 2, 1", "0, 0, 0")}<float name="intensity" value="6"/><float name="cutoff_angle" value="25"/>
  </emitter>
  <emitter type="projector">
    {pose("0.5, 2.5, 3.5", "-0.3, 0.5, 0")}{bitmap("irradiance", "slide.exr")}<float name="fov" value="30"/>
  </emitter>""", '<integer name="max_depth" value="4"/>'))


def daylight(folder: Folder) -> Path:
    """The sky of a hazy morning, the sun low in it, seen and in rough metal."""
    metal = '<bsdf type="roughconductor"><float name="alpha" value="0.2"/><string name="material" value="Al"/></bsdf>'
    return folder.text("scene.xml", scene_xml(
        size(40, 30), VIEW, furnished(folder) + shape("sphere", "globe", ball(0.3, 0.35, 1.2, 0.35), metal) + f"""
  <emitter type="sunsky">
    {placed('rotate x="1" angle="-90"', 'rotate y="1" angle="130"')}<float name="turbidity" value="5.5"/>
    <rgb name="albedo" value="0.5, 0.3, 0.1"/><float name="hour" value="8.2"/><float name="latitude" value="48.1"/>
    <float name="longitude" value="11.6"/><float name="timezone" value="2"/><integer name="month" value="9"/>
    <float name="sky_scale" value="4"/><float name="sun_scale" value="0.7"/>
  </emitter>""", '<integer name="max_depth" value="4"/>'))


def many_lamps(folder: Folder) -> Path:
    """Thirty-six lamps of all kinds, brightness and weight, on diffuse surfaces and rough metal, and a dim sky: picked by a
    tree here, uniformly there."""
    folder.pixels("lamp.exr", 12 * picture(4, 6, seed=38) ** 3)
    random = np.random.default_rng(5)
    ring = []
    for number in range(36):
        angle, height = 2 * np.pi * number / 36, 0.6 + 0.5 * (number % 4)
        place = f"{2.3 * np.sin(angle):.3f}, {height}, {2.3 * np.cos(angle):.3f}"
        x, y, z = place.split(", ")
        colour = random.uniform(0.2, 1, 3) * (4 if number % 5 == 0 else 1)
        red, green, blue = (f"{value:.3f}" for value in colour)
        bright = ", ".join(f"{9 * float(value):.3f}" for value in (red, green, blue))
        weight = f'<float name="sampling_weight" value="{1 + number % 3}"/>'
        facing = f'<lookat origin="{place}" target="0, {0.2 * (number % 3)}, 0" up="0.1, 1, 0.2"/>'
        rect = f'<transform name="to_world"><scale x="0.15" y="0.1"/>{facing}</transform>'
        ring.append((
            shape("rectangle", f"lamp_{number}", rect, diffuse("0"), lamp(bright)),
            f"""
  <emitter type="point" id="lamp_{number}">
    <point name="position" x="{x}" y="{y}" z="{z}"/><rgb name="intensity" value="{red}, {green}, {blue}"/>{weight}
  </emitter>""",
            f"""
  <emitter type="spot" id="lamp_{number}">
    <transform name="to_world">{facing}</transform><rgb name="intensity" value="{red}, {green}, {blue}"/>
    <float name="cutoff_angle" value="35"/>
  </emitter>""",
            shape("rectangle", f"lamp_{number}", rect, diffuse("0"),
                  f'<emitter type="area">{bitmap("radiance", "lamp.exr")}{weight}</emitter>'),
            shape("sphere", f"lamp_{number}", ball(float(x), float(y), float(z), 0.08), diffuse("0"), lamp("5, 6, 4")),
        )[number % 5])
    metal = '<bsdf type="roughconductor"><float name="alpha" value="0.25"/><string name="material" value="Al"/></bsdf>'
    globe = shape("sphere", "globe", ball(0.3, 0.35, 1.2, 0.35), metal)
    return folder.text("scene.xml", scene_xml(
        size(40, 30), VIEW, furnished(folder) + globe + "".join(ring) + SKY.format("0.05, 0.06, 0.08"),
        '<integer name="max_depth" value="4"/><boolean name="hide_emitters" value="true"/>'))
