"""The pieces that scenes of one kind each are made of: textures, materials, lights, shapes and cameras, by name.

See `matrix`, whose rows name them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.scenes.xml.basics import SKY, ball, file
from tests.scenes.xml.files import Folder, bitmap, bumpy_ball, diffuse, lamp, look, picture, placed, shape
from tests.scenes.xml.layered import NONLINEAR, RAW, twosided
from tests.scenes.xml.lights import pose
from tests.scenes.xml.materials import bsdf, colours, floats, names
from tests.scenes.xml.shapes import bowl
from tests.scenes.xml.textures import GREEN, coloured_ball

TILED = '<transform name="to_uv"><rotate z="1" angle="20"/><scale x="2.3" y="1.7"/></transform>'

# Textures, for an attribute {}. Numbers that are read from one are between 0 and 1.
TEXTURES = {
    "none": "",
    "number": '<float name="{}" value="0.35"/>',
    "rgb": '<rgb name="{}" value="0.7, 0.35, 0.15"/>',
    "srgb": '<texture type="srgb" name="{}"><rgb name="color" value="0.2, 0.5, 0.7"/></texture>',
    "rawconstant": '<texture type="rawconstant" name="{}"><vector name="value" value="0.2, 0.5, 0.7"/></texture>',
    "uniform": '<spectrum type="uniform" name="{}"><float name="value" value="0.45"/></spectrum>',
    "pairs": '<spectrum name="{}" value="400:0.1, 550:0.6, 700:0.3"/>',
    "spd": '<spectrum name="{}" filename="green.spd"/>',
    "bitmap": bitmap("{}", "a.exr", TILED),
    "nearest": bitmap("{}", "b.png", '<string name="filter_type" value="nearest"/><string name="wrap_mode" value="mirror"/>'
                      + TILED),
    "raw": bitmap("{}", "c.jpg", RAW + '<string name="wrap_mode" value="clamp"/>'),
    "checkerboard": '<texture type="checkerboard" name="{}"><rgb name="color0" value="0.7, 0.3, 0.1"/>'
                    f'<rgb name="color1" value="0.2, 0.4, 0.6"/>{TILED}</texture>',
    "checked bitmap": f'<texture type="checkerboard" name="{{}}">{bitmap("color0", "a.exr")}'
                      f'<float name="color1" value="0.2"/>{TILED}</texture>',
    "vertex attribute": '<texture type="mesh_attribute" name="{}"><string name="name" value="vertex_color"/></texture>',
    "face attribute": '<texture type="mesh_attribute" name="{}"><string name="name" value="face_shade"/></texture>',
    "d65": '<spectrum type="d65" name="{}"><float name="scale" value="0.02"/></spectrum>',
}


def slot(name: str) -> Callable[[str], str]:
    """A texture as the attribute `name`; nothing without one."""
    return lambda texture: TEXTURES[texture].format(name)


def textured(kind: str, attribute: str, *parts: str) -> Callable[[str], str]:
    """A material whose `attribute` is the texture."""
    return lambda texture: bsdf(kind, slot(attribute)(texture), *parts)


GGX, BECKMANN = names(distribution="ggx"), names(distribution="beckmann")
ALL_FACETS = '<boolean name="sample_visible" value="false"/>'
BUMPS = bitmap("normalmap", "bumps.exr", RAW)
GOLD = bsdf("roughconductor", names(material="Au"), GGX, floats(alpha=0.25))
BSDFS: dict[str, Callable[[str], str]] = {
    "diffuse": textured("diffuse", "reflectance"),
    "twosided": lambda texture: twosided(bsdf("diffuse", slot("reflectance")(texture)), GOLD),
    "conductor": textured("conductor", "specular_reflectance", names(material="Cu")),
    "roughconductor": textured("roughconductor", "specular_reflectance", names(material="Al"), GGX, floats(alpha=0.2)),
    "roughconductor alpha": textured("roughconductor", "alpha", names(material="Au"), BECKMANN),
    "roughconductor brushed": textured("roughconductor", "specular_reflectance", BECKMANN,
                                       floats(alpha_u=0.1, alpha_v=0.45)),
    "roughconductor all facets": textured("roughconductor", "specular_reflectance", names(material="Ag"), GGX, ALL_FACETS,
                                          floats(alpha=0.3)),
    "dielectric": textured("dielectric", "specular_transmittance", names(int_ior="bk7")),
    "thindielectric": textured("thindielectric", "specular_transmittance", names(int_ior="diamond")),
    "roughdielectric": textured("roughdielectric", "specular_transmittance", GGX, floats(alpha=0.3)),
    "roughdielectric alpha": textured("roughdielectric", "alpha", BECKMANN, floats(int_ior=1.7)),
    "roughdielectric all facets": textured("roughdielectric", "specular_reflectance", BECKMANN, ALL_FACETS,
                                           floats(alpha=0.25, int_ior=1.6)),
    "plastic": textured("plastic", "diffuse_reflectance", names(int_ior="water")),
    "plastic nonlinear": textured("plastic", "diffuse_reflectance", NONLINEAR),
    "roughplastic": textured("roughplastic", "diffuse_reflectance", BECKMANN, floats(alpha=0.2)),
    "roughplastic nonlinear": textured("roughplastic", "diffuse_reflectance", GGX, NONLINEAR,
                                      floats(alpha=0.3, int_ior=1.8)),
    "roughplastic all facets": textured("roughplastic", "diffuse_reflectance", BECKMANN, ALL_FACETS, floats(alpha=0.3)),
    "principled": textured("principled", "base_color", floats(roughness=0.4, specular=0.6, spec_tint=0.4, flatness=0.5)),
    "principled metal": textured("principled", "roughness", colours(base_color="0.8, 0.5, 0.3"),
                                 floats(metallic=0.9, anisotropic=0.6)),
    "principled glass": textured("principled", "spec_trans", colours(base_color="0.6, 0.8, 0.9"),
                                 floats(roughness=0.5, eta=1.4)),
    "principled lacquer": textured("principled", "metallic", colours(base_color="0.3, 0.4, 0.8"),
                                   floats(roughness=0.6, clearcoat=0.9, clearcoat_gloss=0.3)),
    "principled cloth": textured("principled", "sheen", colours(base_color="0.7, 0.3, 0.4"),
                                 floats(roughness=0.8, sheen_tint=0.6)),
    "principledthin": textured("principledthin", "base_color",
                               floats(roughness=0.4, diff_trans=0.9, spec_trans=0.3, eta=1.4)),
    "principledthin glass": textured("principledthin", "spec_trans", colours(base_color="0.8, 0.9, 0.6"),
                                     floats(roughness=0.5, anisotropic=0.5, sheen=0.3)),
    "blendbsdf": textured("blendbsdf", "weight", diffuse("0.7, 0.3, 0.2"), GOLD),
    "mask": textured("mask", "opacity", twosided(diffuse("0.3, 0.6, 0.7"))),
    "normalmap": lambda texture: bsdf("normalmap", BUMPS, bsdf("roughplastic", slot("diffuse_reflectance")(texture))),
    "normalmap metal": lambda texture: bsdf("normalmap", BUMPS, bsdf("roughconductor", slot("alpha")(texture))),
    "bumpmap": textured("bumpmap", "arbitrary", bsdf("roughplastic"), floats(scale=0.1)),
    "bumpmap metal": textured("bumpmap", "arbitrary", GOLD, floats(scale=0.05)),
    "null": lambda texture: bsdf("null"),
}

FACETED = '<boolean name="face_normals" value="true"/>'
ABOVE = placed('scale x="0.9" y="0.7"', 'rotate x="1" angle="110"', 'translate x="0.5" y="3" z="-0.4"')
AIM = pose("1.2, 3, 2.2", "0, 0.6, 0")


def of_surface(kind: str, place: str, attribute: str = "radiance", light: str = "area") -> Callable[[str], str]:
    """A shape that shines, its radiance the texture."""
    return lambda texture: shape(kind, "lamp", place, f'<emitter type="{light}">{slot(attribute)(texture)}</emitter>')


def emitter(kind: str, *parts: str) -> str:
    return f'\n  <emitter type="{kind}">{"".join(parts)}</emitter>'


# Lights; those with a texture of their own take the one that their name ends with, see `light`.
EMITTERS: dict[str, Callable[[str], str]] = {
    "area": lambda _: shape("rectangle", "lamp", lamp("7, 6, 4"), ABOVE),
    "area sphere": lambda _: shape("sphere", "lamp", ball(0.9, 2.4, 0.8, 0.3), lamp("14, 12, 9")),
    "area disk": lambda _: shape("disk", "lamp", ABOVE, lamp("6, 7, 9")),
    # Without normals at vertices, by which Mitsuba weights what it samples: see tests/emitter/test_normals_of_lamps.py.
    "area mesh": lambda _: shape("obj", "lamp", file("smooth.obj"), FACETED, lamp("8, 6, 5"), placed(
        'scale value="0.3"', 'translate x="1" y="2.4" z="0.6"')),
    "area cube": lambda _: shape("cube", "lamp", lamp("5, 6, 7"), placed(
        'scale value="0.3"', 'rotate y="1" angle="30"', 'translate x="0.9" y="2.5" z="0.7"')),
    "textured area": of_surface("rectangle", ABOVE),
    "beam": of_surface("rectangle", ABOVE, light="directionalarea"),
    "constant": lambda _: SKY.format("0.7, 0.8, 1"),
    "textured constant": lambda texture: emitter("constant", slot("radiance")(texture)),
    "envmap": lambda _: emitter("envmap", file("sky.exr"), placed('rotate y="1" angle="70"')),
    "compensated envmap": lambda _: emitter("envmap", file("sky.exr"), '<boolean name="mis_compensation" value="true"/>'),
    "point": lambda _: emitter("point", '<point name="position" x="0.8" y="2.6" z="1.6"/>', colours(intensity="9, 8, 7")),
    "spot": lambda _: emitter("spot", AIM, colours(intensity="30, 26, 20"), floats(cutoff_angle=35, beam_width=20)),
    "textured spot": lambda texture: emitter("spot", AIM, floats(intensity=40, cutoff_angle=35), slot("texture")(texture)),
    "projector": lambda texture: emitter("projector", AIM, slot("irradiance")(texture), floats(scale=8, fov=45)),
    "sunsky": lambda _: emitter("sunsky", floats(turbidity=4, sky_scale=4, sun_scale=0.5),
                                placed('rotate x="1" angle="-90"'),
                                '<vector name="sun_direction" x="0.6" y="0.7" z="0.6"/>'),
    "directional": lambda _: emitter("directional", '<vector name="direction" x="-0.4" y="-1" z="-0.6"/>',
                                     colours(irradiance="1.5, 1.3, 1")),
}

UPRIGHT = placed('scale x="1.1" y="0.9"', 'rotate y="1" angle="-15"', 'rotate x="1" angle="-12"', 'translate y="0.95"')
BODY = placed('scale value="0.75"', 'rotate y="1" angle="25"', 'rotate x="1" angle="10"', 'translate y="0.95"')


def thing(kind: str, *parts: str) -> Callable[[str], str]:
    """A shape of a material."""
    return lambda material: shape(kind, "thing", *parts, material)


def instanced(material: str) -> str:
    """Two instances of a ball, one of them squeezed."""
    group = shape("shapegroup", "group", shape("obj", "thing", file("smooth.obj"), material))
    poses = (placed('scale value="0.6"', 'translate x="-0.4" y="0.9"'),
             placed('scale x="0.5" y="0.8" z="0.4"', 'rotate z="1" angle="20"', 'translate x="0.9" y="0.9" z="0.3"'))
    return group + "".join(shape("instance", f"instance_{number}", '<ref id="group"/>', each)
                           for number, each in enumerate(poses))


SHAPES: dict[str, Callable[[str], str]] = {
    "rectangle": thing("rectangle", UPRIGHT), "disk": thing("disk", UPRIGHT), "cube": thing("cube", BODY),
    "sphere": thing("sphere", BODY), "mesh": thing("obj", file("smooth.obj"), BODY),
    "facets": thing("obj", file("smooth.obj"), FACETED, BODY), "attributes": thing("ply", file("coloured.ply"), BODY),
    "cylinder": thing("cylinder", floats(radius=0.7), placed(
        'translate z="-0.5"', 'scale z="1.5"', 'rotate x="1" angle="-75"', 'rotate y="1" angle="20"', 'translate y="0.9"')),
    "instance": instanced, "serialized": thing("serialized", file("bowl.serialized"), BODY),
}
CAMERAS: dict[str, tuple[str, str]] = {  # type, and the rest
    "perspective": ("perspective", look("0.4, 1.9, 4.2", "0, 0.8, 0", 40)),
    "orthographic": ("orthographic", placed('scale x="1.9" y="1.9"', 'lookat origin="0.4, 1.9, 4.2" target="0, 0.8, 0" '
                                            'up="0, 1, 0"')),
    "thinlens": ("thinlens", look("0.4, 1.9, 4.2", "0, 0.8, 0", 40) + floats(aperture_radius=0.12, focus_distance=4.1)),
}


def light(name: str) -> str:
    """The emitter that a row names, and after a colon its texture."""
    kind, _, texture = name.partition(":")
    return EMITTERS[kind](texture)


def files(folder: Folder) -> None:
    """The meshes and images that the pieces refer to."""
    bumpy_ball(folder, "smooth.obj", normals=True)
    coloured_ball(folder, "coloured.ply")
    folder.serialized("bowl.serialized", bowl(True))
    folder.pixels("a.exr", picture(6, 8, seed=81))
    folder.pixels("b.png", picture(7, 5, seed=82))
    folder.pixels("c.jpg", picture(8, 8, seed=83), quality=95)
    folder.pixels("bumps.exr", np.array([0.5, 0.5, 1.0]) + 0.4 * (picture(6, 8, seed=84) - 0.5))
    sky = 0.7 * picture(9, 16, seed=85)
    sky[1:4, 4:8] = 4, 3.5, 3
    folder.pixels("sky.exr", sky)
    folder.text("green.spd", GREEN)
