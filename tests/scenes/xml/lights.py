"""Small scenes with every light, written as Mitsuba 3 XML into a folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.scenes.xml.basics import FLIPPED, SKY, ball, file
from tests.scenes.xml.files import Folder, bitmap, bumpy_ball, diffuse, lamp, look, picture, placed, scene_xml, shape, size


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
