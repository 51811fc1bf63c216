"""Small scenes that between them use every material with all its options, beside lights that test it.

What reflects or refracts is flat or one mesh for both renderers, so that no tessellation comes between them.
"""

from __future__ import annotations

from pathlib import Path

from tests.scenes.xml.basics import file
from tests.scenes.xml.files import Folder, bitmap, bumpy_ball, diffuse, lamp, picture, placed, scene_xml, shape, size
from tests.scenes.xml.lights import VIEW, environment, pose

SIZE = size(40, 30)
# Where things stand: a wall behind, a sheet at the left and one at the right, a cube and a ball in front, a lamp above.
WALL = placed('scale x="2.4" y="1.2"', 'rotate x="1" angle="-8"', 'translate y="1" z="-1.6"')
LEFT = placed('scale x="0.5" y="0.6"', 'rotate y="1" angle="35"', 'translate x="-1.4" y="0.7" z="-0.3"')
RIGHT = placed('scale x="0.5" y="0.6"', 'rotate y="1" angle="140"', 'translate x="1.5" y="0.7" z="-0.2"')
CUBE = placed('scale x="0.35" y="0.5" z="0.35"', 'rotate y="1" angle="25"', 'translate x="0.65" y="0.55" z="0.7"')
BALL = placed('scale value="0.5"', 'translate x="-0.5" y="0.7" z="0.5"')
FLOOR = shape("rectangle", "floor", f'<bsdf type="twosided">{diffuse("0.7, 0.6, 0.5")}</bsdf>',
              placed('rotate x="1" angle="-90"', 'scale x="2.5" z="2.5"'))
LAMP = shape("rectangle", "lamp", lamp("6, 5, 4"), placed(
    'scale x="0.7" y="0.5"', 'rotate x="1" angle="110"', 'translate x="0.8" y="2.8" z="-0.6"'))


def bsdf(kind: str, *parts: str) -> str:
    return f'<bsdf type="{kind}">{"".join(parts)}</bsdf>'


def floats(**values: float) -> str:
    return "".join(f'<float name="{name}" value="{value}"/>' for name, value in values.items())


def names(**values: str) -> str:
    return "".join(f'<string name="{name}" value="{value}"/>' for name, value in values.items())


def colours(**values: str) -> str:
    return "".join(f'<rgb name="{name}" value="{value}"/>' for name, value in values.items())


def soft_sky(folder: Folder) -> str:
    """A turned environment map with a broad bright window: what is found by chance alone is not too rare."""
    sky = 0.8 * picture(9, 16, seed=41)
    sky[1:4, 4:8] = 4, 3.5, 3
    folder.pixels("soft.exr", sky)
    turn = placed('rotate y="1" angle="70"')
    return f'\n  <emitter type="envmap">{file("soft.exr")}{turn}</emitter>'


def gallery(folder: Folder, depth: int, lights: str, **materials: str) -> Path:
    """Materials of `wall`, `left`, `right`, `cube` and `ball` above a floor."""
    bumpy_ball(folder, "smooth.obj", normals=True)
    places = {"wall": WALL, "left": LEFT, "right": RIGHT, "cube": CUBE, "ball": file("smooth.obj") + BALL}
    kinds = {"cube": "cube", "ball": "obj"}
    shapes = [shape(kinds.get(name, "rectangle"), name, places[name], material) for name, material in materials.items()]
    return folder.text("scene.xml", scene_xml(SIZE, VIEW, FLOOR + "".join(shapes) + lights,
                                              f'<integer name="max_depth" value="{depth}"/>'))


def mirrors(folder: Folder) -> Path:
    """Ideal reflection: metals by name and by index, colour and image on top, two sides, a side without any."""
    folder.pixels("tint.exr", picture(6, 8, seed=43))
    sides = bsdf("twosided", bsdf("conductor", names(material="Ag"), bitmap("specular_reflectance", "tint.exr")),
                 bsdf("conductor", names(material="Cu")))
    return gallery(
        folder, 6, soft_sky(folder), wall=bsdf("conductor", names(material="Au")), left=sides, right=sides,
        cube=bsdf("conductor", colours(eta="0.4, 1.4, 2.2", k="2.9, 1.2, 0.6", specular_reflectance="0.9, 0.8, 1")),
        ball=bsdf("conductor", bitmap("specular_reflectance", "tint.exr")))


def glass(folder: Folder) -> Path:
    """Ideal refraction: glass, a diamond, air in water, a pane with colours; total internal reflection in all."""
    folder.pixels("tint.exr", picture(6, 8, seed=45))
    return gallery(
        folder, 6, soft_sky(folder), wall=diffuse("0.6, 0.3, 0.2"), left=bsdf("dielectric", floats(int_ior=1, ext_ior=1.6)),
        right=bsdf("dielectric", names(int_ior="water", ext_ior="air"), colours(specular_reflectance="1, 0.5, 0.7"),
                   bitmap("specular_transmittance", "tint.exr")),
        cube=bsdf("dielectric"), ball=bsdf("dielectric", names(int_ior="diamond", ext_ior="vacuum")))


def rough_metals(folder: Folder) -> Path:
    """Rough reflection under a small sun and a lamp: both distributions, roughness by number and by image, two sides."""
    folder.pixels("alpha.exr", 0.1 + 0.4 * picture(5, 6, seed=47)[:, :, :1].repeat(3, axis=2))
    folder.pixels("tint.exr", picture(6, 8, seed=48))
    sides = bsdf("twosided", bsdf("roughconductor", names(material="Cu", distribution="ggx"), bitmap("alpha", "alpha.exr")),
                 bsdf("roughconductor", names(material="Al", distribution="beckmann"), floats(alpha=0.4)))
    return gallery(
        folder, 4, environment(folder) + LAMP,
        wall=bsdf("roughconductor", names(material="Au", distribution="ggx"), floats(alpha=0.3)), left=sides, right=sides,
        cube=bsdf("roughconductor", floats(alpha=0.15), colours(eta="0.4, 1.4, 2.2", k="2.9, 1.2, 0.6")),
        ball=bsdf("roughconductor", bitmap("alpha", "alpha.exr"), bitmap("specular_reflectance", "tint.exr")))


def coloured_roughness(folder: Folder) -> Path:
    """Roughness by a colour, whose mean counts, and by an image in colour, whose luminance does."""
    folder.pixels("alpha.exr", 0.1 + 0.5 * picture(5, 6, seed=49))
    image = bitmap("alpha", "alpha.exr")
    return gallery(folder, 3, soft_sky(folder) + LAMP, wall=bsdf("roughconductor", names(distribution="ggx"), image),
                   left=bsdf("roughdielectric", image),
                   cube=bsdf("roughconductor", colours(alpha="0.1, 0.4, 0.7")))


def rough_glass(folder: Folder) -> Path:
    """Rough refraction: both distributions, roughness by number and by image, air in glass, colours."""
    folder.pixels("alpha.exr", 0.1 + 0.4 * picture(5, 6, seed=51)[:, :, :1].repeat(3, axis=2))
    folder.pixels("tint.exr", picture(6, 8, seed=52))
    return gallery(
        folder, 6, soft_sky(folder) + LAMP, wall=diffuse("0.6, 0.3, 0.2"),
        left=bsdf("roughdielectric", names(distribution="ggx"), floats(int_ior=1, ext_ior=1.6, alpha=0.25)),
        right=bsdf("roughdielectric", names(int_ior="water"), bitmap("alpha", "alpha.exr"),
                   colours(specular_reflectance="1, 0.5, 0.7"), bitmap("specular_transmittance", "tint.exr")),
        cube=bsdf("roughdielectric", names(distribution="ggx", int_ior="diamond"), bitmap("alpha", "alpha.exr")),
        ball=bsdf("roughdielectric", floats(alpha=0.2)))


def brushed(folder: Folder, turn: float = 0) -> Path:
    """Different roughness along the surface's coordinates u and v, of reflection and of refraction."""
    folder.pixels("alpha.exr", 0.05 + 0.3 * picture(5, 6, seed=53)[:, :, :1].repeat(3, axis=2))
    spin = f'rotate z="1" angle="{turn}"'
    panels = {
        "beckmann": (-0.9, 1.1, bsdf("roughconductor", names(material="Au"), floats(alpha_u=0.05, alpha_v=0.4))),
        "ggx": (0.4, 1.1, bsdf("roughconductor", names(material="Cu", distribution="ggx"),
                               floats(alpha_u=0.5), bitmap("alpha_v", "alpha.exr"))),
        "beckmann_glass": (-0.5, 0.4, bsdf("roughdielectric", floats(alpha_u=0.3, alpha_v=0.06))),
        "ggx_glass": (0.8, 0.4, bsdf("roughdielectric", names(distribution="ggx"), floats(alpha_u=0.08, alpha_v=0.35))),
    }
    shapes = [shape("rectangle", name, placed('scale x="0.5" y="0.3"', spin, 'rotate x="1" angle="-20"',
                                              f'translate x="{x}" y="{y}" z="{1 - y}"'), material)
              for name, (x, y, material) in panels.items()]
    return folder.text("scene.xml", scene_xml(SIZE, VIEW, FLOOR + "".join(shapes) + soft_sky(folder) + LAMP,
                                              '<integer name="max_depth" value="4"/>'))


def brushed_turned(folder: Folder) -> Path:
    """The same with panels turned in their plane: the brush strokes turn with them."""
    return brushed(folder, turn=50)


def polished(folder: Folder) -> Path:
    """Rough materials in light without extent: a textured spot, a projector, a point, and a directional light."""
    folder.pixels("window.exr", picture(5, 7, seed=55))
    sides = bsdf("twosided", bsdf("roughconductor", names(material="Ag", distribution="ggx"), floats(alpha=0.3)))
    return gallery(
        folder, 5, f"""
  <emitter type="spot">
    {pose("1.5, 3, 2.5", "-0.2, 0.4, 0")}<rgb name="intensity" value="40, 30, 20"/>
    <float name="cutoff_angle" value="28"/>{bitmap("texture", "window.exr")}
  </emitter>
  <emitter type="projector">
    {pose("-1.5, 2.5, 3", "0.3, 0.5, 0")}{bitmap("irradiance", "window.exr")}<float name="scale" value="4"/>
    <float name="fov" value="45"/>
  </emitter>
  <emitter type="point"><point name="position" x="0.2" y="2.4" z="1"/><rgb name="intensity" value="2, 3, 4"/></emitter>
  <emitter type="directional">
    <vector name="direction" x="0.5" y="-1" z="-0.3"/><rgb name="irradiance" value="0.8, 0.9, 0.6"/>
  </emitter>""",
        wall=bsdf("roughconductor", names(material="Al"), floats(alpha=0.4)), left=sides, right=sides,
        cube=bsdf("roughdielectric", floats(alpha=0.4, int_ior=1.8)),
        ball=bsdf("roughconductor", names(material="Cu", distribution="ggx"), floats(alpha=0.25)))


def principled(folder: Folder) -> Path:
    """Burley's material: a metal by images, cloth from two sides, rough glass, lacquer."""
    folder.pixels("colour.exr", 0.1 + 0.8 * picture(6, 8, seed=57))
    folder.pixels("metal.exr", picture(5, 6, seed=58)[:, :, :1].repeat(3, axis=2))
    cloth = bsdf("twosided", bsdf("principled", colours(base_color="0.7, 0.3, 0.4"), floats(
        sheen=1, sheen_tint=0.5, flatness=0.6, specular=0.3, spec_tint=0.5)))
    return gallery(
        folder, 4, soft_sky(folder) + LAMP, left=cloth, right=cloth,
        wall=bsdf("principled", bitmap("base_color", "colour.exr"), bitmap("metallic", "metal.exr"),
                  floats(roughness=0.4, anisotropic=0.6)),
        cube=bsdf("principled", colours(base_color="0.6, 0.9, 0.8"), floats(spec_trans=0.9, roughness=0.5, eta=1.4)),
        ball=bsdf("principled", colours(base_color="0.3, 0.4, 0.8"), floats(
            clearcoat=1, clearcoat_gloss=0.1, roughness=0.6, metallic=0.2)))
