"""Small scenes of plastics and of materials that hold others, in the gallery of `materials`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.scenes.xml.files import Folder, bitmap, diffuse, picture
from tests.scenes.xml.materials import LAMP, bsdf, colours, floats, gallery, names, soft_sky

NONLINEAR = '<boolean name="nonlinear" value="true"/>'
RAW = '<boolean name="raw" value="true"/>'


def twosided(*sides: str) -> str:
    return bsdf("twosided", *sides)


def grey(height: int, width: int, seed: int) -> np.ndarray:
    """A picture without colours."""
    return picture(height, width, seed)[:, :, :1].repeat(3, axis=2)


def plastics(folder: Folder) -> Path:
    """A diffuse base under a smooth coat: linear and nonlinear, indices by name and number, colour and image, two sides."""
    folder.pixels("base.exr", picture(6, 8, seed=61))
    sides = twosided(bsdf("plastic", bitmap("diffuse_reflectance", "base.exr"), NONLINEAR),
                     bsdf("plastic", colours(diffuse_reflectance="0.2, 0.5, 0.8"), floats(int_ior=1.9)))
    return gallery(
        folder, 5, soft_sky(folder) + LAMP,
        wall=bsdf("plastic", colours(diffuse_reflectance="0.7, 0.4, 0.1", specular_reflectance="1, 0.5, 0.7")),
        left=sides, right=sides, cube=bsdf("plastic", bitmap("diffuse_reflectance", "base.exr")),
        ball=bsdf("plastic", names(int_ior="diamond"), colours(diffuse_reflectance="0.9, 0.6, 0.3"), NONLINEAR))


def rough_plastics(folder: Folder) -> Path:
    """The same under a rough coat: both distributions."""
    folder.pixels("base.exr", picture(6, 8, seed=63))
    ggx = names(distribution="ggx")
    sides = twosided(bsdf("roughplastic", ggx, floats(alpha=0.3), bitmap("diffuse_reflectance", "base.exr"), NONLINEAR),
                     bsdf("roughplastic", colours(diffuse_reflectance="0.2, 0.5, 0.8"), floats(int_ior=1.9, alpha=0.5)))
    return gallery(
        folder, 5, soft_sky(folder) + LAMP,
        wall=bsdf("roughplastic", colours(diffuse_reflectance="0.7, 0.4, 0.1", specular_reflectance="1, 0.5, 0.7")),
        left=sides, right=sides,
        cube=bsdf("roughplastic", ggx, bitmap("diffuse_reflectance", "base.exr"), floats(alpha=0.15)),
        ball=bsdf("roughplastic", floats(alpha=0.25), colours(diffuse_reflectance="0.9, 0.6, 0.3"), NONLINEAR))


def blends(folder: Folder) -> Path:
    """Mixtures by number, by image, by an image in colour, and of mixtures.

    Smooth lobes with smooth ones, and ideal reflection with ideal refraction: where they are mixed with each other,
    Mitsuba's images are too dark, see `torch_radbp.bsdf.blendbsdf.BlendBSDF`.
    """
    folder.pixels("weight.exr", grey(5, 6, seed=65))
    folder.pixels("colours.exr", picture(5, 6, seed=66))
    gold = bsdf("roughconductor", names(material="Au", distribution="ggx"), floats(alpha=0.2))
    paint = bsdf("roughplastic", colours(diffuse_reflectance="0.2, 0.5, 0.8"), floats(alpha=0.3))
    inner = bsdf("blendbsdf", floats(weight=0.6), gold, paint)
    sides = twosided(bsdf("blendbsdf", bitmap("weight", "weight.exr"), diffuse("0.8, 0.3, 0.2"), gold),
                     bsdf("blendbsdf", bitmap("weight", "colours.exr"), diffuse("0.1, 0.6, 0.2"), paint))
    return gallery(
        folder, 5, soft_sky(folder) + LAMP,
        wall=bsdf("blendbsdf", floats(weight=0.3), diffuse("0.8, 0.6, 0.2"), inner), left=sides, right=sides,
        cube=bsdf("blendbsdf", floats(weight=0.4), bsdf("dielectric"), bsdf("conductor", names(material="Cu"))),
        ball=bsdf("blendbsdf", bitmap("weight", "weight.exr"), paint, gold))


def masks(folder: Folder) -> Path:
    """Holes by number, by image, by an image in colour, on two sides; and what is not there at all."""
    folder.pixels("opacity.exr", grey(5, 6, seed=67))
    folder.pixels("colours.exr", picture(5, 6, seed=68))
    silver = bsdf("roughconductor", names(material="Ag"), floats(alpha=0.3))
    return gallery(
        folder, 6, soft_sky(folder),
        wall=bsdf("mask", floats(opacity=0.7), twosided(diffuse("0.8, 0.6, 0.2"))),
        left=bsdf("mask", bitmap("opacity", "opacity.exr"), twosided(diffuse("0.2, 0.7, 0.3"), silver)),
        right=bsdf("mask", bitmap("opacity", "colours.exr"), twosided(diffuse("0.7, 0.3, 0.3"))),
        cube=bsdf("mask", floats(opacity=0.5), silver), ball=bsdf("null"))


def normal_maps(folder: Folder) -> Path:
    """Turned normals on diffuse, rough and ideal surfaces, with and without the fading of light towards the horizon."""
    bumps = np.array([0.5, 0.5, 1.0]) + 0.4 * (picture(6, 8, seed=69) - 0.5)
    folder.pixels("bumps.exr", bumps)
    gold = bsdf("roughconductor", names(material="Au", distribution="ggx"), floats(alpha=0.3))
    plain = '<boolean name="use_shadowing_function" value="false"/>'

    def mapped(nested: str, *more: str) -> str:
        return bsdf("normalmap", bitmap("normalmap", "bumps.exr", RAW), nested, *more)

    return gallery(
        folder, 4, soft_sky(folder) + LAMP, wall=mapped(diffuse("0.7, 0.5, 0.3")),
        left=twosided(mapped(gold)), right=twosided(mapped(diffuse("0.3, 0.5, 0.7"), plain)),
        cube=mapped(bsdf("roughplastic", floats(alpha=0.3))), ball=mapped(gold, plain))


def bump_maps(folder: Folder) -> Path:
    """Heights, grey and in colour, on flat and curved surfaces, stretched and moved over them; with and without fading."""
    folder.pixels("hills.exr", grey(7, 7, seed=70))
    folder.pixels("colours.exr", picture(6, 8, seed=71))
    gold = bsdf("roughconductor", names(material="Au", distribution="ggx"), floats(alpha=0.3))
    plain = '<boolean name="use_shadowing_function" value="false"/>'
    placed = RAW + '<transform name="to_uv"><scale x="1.5" y="0.8"/><translate x="0.2" y="-0.1"/></transform>'

    def bumpy(nested: str, scale: float, *more: str, file: str = "hills.exr", options: str = RAW) -> str:
        return bsdf("bumpmap", bitmap("arbitrary", file, options), nested, floats(scale=scale), *more)

    return gallery(
        folder, 4, soft_sky(folder) + LAMP, wall=bumpy(diffuse("0.7, 0.5, 0.3"), 0.4),
        left=twosided(bumpy(gold, -0.2, file="colours.exr", options=placed)),
        right=twosided(bumpy(diffuse("0.3, 0.5, 0.7"), 0.5, plain)),
        cube=bumpy(bsdf("roughplastic", floats(alpha=0.3)), 0.05, file="colours.exr"), ball=bumpy(gold, 0.1, plain))
