"""An example of every plugin: objects of a scene by name, and what is seen of them."""

from __future__ import annotations

from typing import Any, NamedTuple

from docs.plugin_code import Asset, LookAt, Placed, Scale, Scaled
from docs.plugin_scenes import CAMERA, RED

FEW, MANY = 128, 512  # samples for each pixel of a picture; light that passes through a surface is found by chance


class Example(NamedTuple):
    """What is shown of a plugin."""

    caption: str  # what the picture shows
    objects: dict[str, Any]
    like: str = ""  # another plugin of the category, whose picture is the same
    output: str = ""  # what is seen instead of the image: a quantity of `Renderer.aovs`
    samples: int = FEW


def ball(caption: str, kind: str, samples: int = FEW, **attributes: Any) -> Example:
    """A ball of a material."""
    return Example(caption, {"ball": {"type": "sphere", "bsdf": {"type": kind} | attributes}}, samples=samples)


def wall(caption: str, kind: str, **attributes: Any) -> Example:
    """A square whose colour is a texture."""
    surface = {"type": "diffuse", "reflectance": {"type": kind} | attributes}
    return Example(caption, {"wall": {"type": "rectangle", "to_world": FACING, "bsdf": surface}})


def lone(caption: str, name: str, kind: str, *, like: str = "", output: str = "", **attributes: Any) -> Example:
    """One object of the scene."""
    return Example(caption, {name: {"type": kind} | attributes}, like, output)


def seen(caption: str, *, like: str = "", film: dict[str, Any], **others: Any) -> Example:
    """The camera with another film or sampler."""
    return Example(caption, {"camera": CAMERA | {"film": {"type": "hdrfilm"} | film} | others}, like)


def filtered(caption: str, kind: str, **attributes: Any) -> Example:
    """The edge of a glowing disk, by a few pixels."""
    film = {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": kind} | attributes}
    disk = {"type": "disk", "to_world": FACING, "emitter": {"type": "area", "radiance": 0.5}}
    return Example(caption, {"camera": CAMERA | {"fov": 20.0, "film": film, "to_world": ABOVE}, "disk": disk})


def sampled(caption: str, kind: str, like: str = "") -> Example:
    """The ball by four samples of each pixel."""
    return seen(caption, like=like, film={"width": 64, "height": 64}, sampler={"type": kind, "sample_count": 4})


LAMP = {"type": "rectangle", "to_world": LookAt((-2.5, -2, 3.5)), "emitter": {"type": "area", "radiance": 30.0}}


def foggy(caption: str, medium: dict[str, Any]) -> Example:
    """The scene in fog."""
    fog = {"type": "homogeneous", "sigma_t": 0.12, "albedo": 0.9} | medium
    return Example(caption, {"camera": CAMERA | {"medium": fog}, "lamp": LAMP}, samples=MANY)


FACING = LookAt((0, 0, 0), (-0.3, -1, 0.2))  # the pose of a square that faces the camera
ABOVE = LookAt((-0.8, -4.6, 1.5), (0, 0, 0.7))
ASIDE = LookAt((-1.8, -3.0, 2.6))
WHITE = {"type": "rgb", "value": [0.8, 0.8, 0.8]}
PATCHES = {"type": "bitmap", "filename": Asset("patches.png")}
PAINT = {"type": "diffuse", "reflectance": RED}
SQUARES = {"type": "checkerboard", "color0": RED, "color1": WHITE, "to_uv": Scale(6, 6)}
UV = {"type": "diffuse", "reflectance": SQUARES}
GOLD = {"type": "roughconductor", "material": "Au", "alpha": 0.15}

BSDFS = {
    "blendbsdf": ball("Squares of red paint and of gold in turn.", "blendbsdf",
                      weight=SQUARES | {"color0": 0.0, "color1": 1.0}, first=PAINT, second=GOLD),
    "bumpmap": ball("Red plastic with bumps that are only in its shading: the outline stays round.", "bumpmap",
                    heights={"type": "bitmap", "filename": Asset("textured_room/plaster.png"), "raw": True,
                             "to_uv": Scale(4, 2)},
                    bsdf={"type": "plastic", "diffuse_reflectance": RED}, scale=0.2),
    "conductor": ball("A mirror of gold.", "conductor", material="Au"),
    "dielectric": ball("A ball of glass: the floor behind it is seen upside down.", "dielectric", MANY, int_ior=1.5),
    "diffuse": ball("Red paint without gloss.", "diffuse", reflectance=RED),
    "mask": ball("Red paint with square holes, through which the inside and the floor are seen.", "mask", MANY,
                 opacity=SQUARES | {"color0": 0.0, "color1": 1.0}, bsdf={"type": "twosided", "bsdf": PAINT}),
    "normalmap": ball("Red plastic with a relief that is only in its shading.", "normalmap",
                      normalmap={"type": "bitmap", "filename": Asset("relief/normals.exr"), "raw": True,
                                 "to_uv": Scale(4, 2)},
                      bsdf={"type": "plastic", "diffuse_reflectance": RED}),
    "null": Example("A red ball within a larger one that is not seen: light passes as if it were not there.", {
        "ball": {"type": "sphere", "bsdf": {"type": "null"}}, "core": {"type": "sphere", "radius": 0.6, "bsdf": PAINT}},
        samples=MANY),
    "plastic": ball("Smooth red plastic: its coat mirrors the lamp and the sky.", "plastic", diffuse_reflectance=RED,
                    int_ior=1.5),
    "principled": ball("Red car paint: half of it metal, under a clear coat.", "principled", base_color=RED, roughness=0.4,
                       metallic=0.5, clearcoat=1.0, clearcoat_gloss=0.95),
    "principledthin": Example("A paper lantern: half of the light of the lamp within passes through the thin red sheet.", {
        "ball": {"type": "sphere", "bsdf": {"type": "principledthin", "base_color": RED, "diff_trans": 1.0}},
        "bulb": {"type": "sphere", "center": [0, 0, -0.4], "radius": 0.3, "emitter": {"type": "area", "radiance": 8.0}}},
        samples=MANY),
    "roughconductor": ball("Gold with a roughness of 0.2.", "roughconductor", material="Au", alpha=0.2),
    "roughdielectric": ball("Frosted glass with a roughness of 0.15.", "roughdielectric", MANY, int_ior=1.5, alpha=0.15),
    "roughplastic": ball("Red plastic with a roughness of 0.15: the lamp's reflection is blurred.", "roughplastic",
                         diffuse_reflectance=RED, alpha=0.15),
    "thindielectric": ball("A soap bubble: the floor is seen through it where it is, the sky as in a mirror.",
                           "thindielectric", MANY, int_ior=1.5),
    "twosided": Example("A tube that is painted red outside and gold inside.", {
        "tube": {"type": "cylinder", "p0": [0, 0, -1], "p1": [0, 0, 0.2], "radius": 0.9,
                 "bsdf": {"type": "twosided", "outside": PAINT, "inside": GOLD}}},
        samples=MANY),
}
TEXTURES = {
    "bitmap": wall("An image, painted on a square.", "bitmap", filename=Asset("textured_room/painting.png")),
    "blackbody": Example("A grey ball, lit from the right by a lamp that glows at 2000 K.", {
        "ball": {"type": "sphere"}, "glow": {"type": "rectangle", "to_world": LookAt((3, -3, 2.5)), "emitter": {
            "type": "area", "radiance": {"type": "blackbody", "temperature": 2000.0}}}}),
    "checkerboard": wall("Red and white squares, three of each in a row.", "checkerboard", color0=RED, color1=WHITE,
                         to_uv=Scale(3, 3)),
    "d65": wall("White daylight times 0.6: a neutral grey.", "d65", scale=0.6),
    "irregular": wall("Orange: the surface reflects most from 600 nm on.", "irregular", wavelengths="400, 500, 600, 700",
                      values="0.05, 0.1, 0.7, 0.6"),
    "mesh_attribute": Example("Colours that the vertices of a PLY file bring along.", {
        "torus": {"type": "ply", "filename": Asset("shapes/torus.ply"), "bsdf": {
            "type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}}}),
    "rawconstant": wall("The numbers 0.1, 0.4 and 0.5 as red, green and blue.", "rawconstant", value=[0.1, 0.4, 0.5]),
    "regular": wall("Blue: the surface reflects less and less from 400 to 700 nm.", "regular", wavelength_min=400.0,
                    wavelength_max=700.0, values="0.7, 0.2, 0.05"),
    "rgb": wall("The same red everywhere.", "rgb", value=[0.6, 0.12, 0.08]),
    "srgb": wall("The same green everywhere.", "srgb", color=[0.15, 0.5, 0.1]),
    "uniform": wall("The same grey everywhere.", "uniform", value=0.5),
    "volume": Example("A ball that is bright where it meets a puff of smoke.", {"ball": {
        "type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "volume", "volume": {
            "type": "gridvolume", "filename": Asset("shapes/puff.vol"),
            "to_world": Placed((2.4, 2.4, 2.4), (-1.2, -2, -1.1))}}}}}),
}
EMITTERS = {
    "area": Example("A square lamp: soft shadows, and its reflection on the ball.", {
        "lamp": {"type": "rectangle", "to_world": LookAt((-3, -2, 4)), "emitter": {"type": "area", "radiance": 15.0}}}),
    "constant": lone("Light from everywhere: it is only darker where things are close to each other.", "sky", "constant",
                     radiance=0.7),
    "directional": lone("Parallel light, as of the sun: shadows with sharp edges.", "sun", "directional",
                        direction=[0.6, 0.5, -1.0], irradiance=2.5),
    "directionalarea": Example("A beam as wide as the square that sends it: outside of it nothing is lit.", {
        "lamp": {"type": "rectangle", "to_world": LookAt((-3, -2, 4)),
                 "emitter": {"type": "directionalarea", "radiance": 3.0}}}),
    "envmap": lone("The sky of an image, also in the reflection on the ball.", "sky", "envmap",
                   filename=Asset("lit_balls/sky.exr"), to_world=LookAt((0, 0, 0), (0, 1, 0))),
    "point": lone("A bulb without size: sharp shadows, and less light further away.", "bulb", "point",
                  position=[-1.5, -1.5, 2.0], intensity=14.0),
    "projector": lone("An image that is thrown on the ball and the floor.", "projector", "projector", irradiance=PATCHES,
                      scale=12.0, fov=40.0, to_world=ASIDE),
    "spot": lone("A cone of light that fades towards its edge.", "spot", "spot", to_world=ASIDE, intensity=45.0,
                 cutoff_angle=18.0),
    "sunsky": lone("A clear day: a warm sun, and shadows that the sky makes blue.", "sky", "sunsky",
                   sun_direction=[-0.5, -0.4, 0.6], sun_scale=1.2, sky_scale=1.2),
}
GROUP = {"type": "shapegroup", "ball": {"type": "sphere", "bsdf": UV},
         "bar": {"type": "cylinder", "p0": [0, 0, -1.8], "p1": [0, 0, 1.8], "radius": 0.2, "bsdf": PAINT}}
PLACES = {"left": Placed((0.5, 0.5, 0.5), (-1, 1, -0.1)), "middle": Placed((0.4, 0.4, 0.4), (0.2, -0.8, -0.3)),
          "right": Placed((0.3, 0.3, 0.3), (0.9, 0, -0.5))}
SHOWN = {"group": GROUP, **{name: {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}, "to_world": place}
                            for name, place in PLACES.items()}}
SHAPES = {
    "cube": lone("A cube, each face with surface coordinates of its own.", "cube", "cube",
                 to_world=Scaled(LookAt((0, 0, -0.4), (-1, -1.6, -0.4)), 0.6), bsdf=UV),
    "cylinder": lone("A tube without caps.", "tube", "cylinder", p0=[0, 0, -1], p1=[0, 0, 0.6], radius=0.7,
                     bsdf={"type": "twosided", "bsdf": UV}),
    "disk": lone("A disk: u grows outwards and v around.", "disk", "disk", to_world=FACING, bsdf=UV),
    "instance": Example("One group, a ball with a bar through it, shown three times.", SHOWN, "shapegroup"),
    "mesh": lone("A torus of an STL file, which has no normals: its facets are seen.", "torus", "mesh",
                 filename=Asset("shapes/torus.stl"), bsdf=PAINT),
    "obj": lone("A torus of an OBJ file.", "torus", "obj", filename=Asset("shapes/torus.obj"), bsdf=UV),
    "ply": lone("A torus of a PLY file.", "torus", "ply", filename=Asset("shapes/torus.ply"), bsdf=UV),
    "rectangle": lone("A square that faces the camera.", "square", "rectangle", to_world=FACING, bsdf=UV),
    "sdfgrid": lone("Two balls that touch: where the distances of a grid are zero.", "balls", "sdfgrid",
                    filename=Asset("shapes/two_balls.vol"), to_world=Placed((2, 2, 2), (-1, -1, -1)), bsdf=PAINT),
    "serialized": lone("A torus of a serialized file, as of Mitsuba 0.5.", "torus", "serialized",
                       filename=Asset("shapes/torus.serialized"), bsdf=UV),
    "shapegroup": Example("One group, a ball with a bar through it, shown three times.", SHOWN),
    "sphere": lone("A ball: u grows around its axis, v from pole to pole.", "ball", "sphere", center=[0, 0, 0], radius=1.0,
                   bsdf=UV),
}
FILM, VIEW = CAMERA["film"], {key: value for key, value in CAMERA.items() if key not in ("type", "fov")}
SENSORS = {
    "batch": lone("Two cameras of one batch, side by side.", "cameras", "batch", film=FILM,
                  left={"type": "perspective", "fov": 34.0, "to_world": LookAt((-2.4, -4.0, 1.5), (0, 0, -0.15))},
                  right={"type": "perspective", "fov": 34.0, "to_world": LookAt((2.4, -4.0, 1.5), (0, 0, -0.15))}),
    "calibrated": lone("A wide lens that bends straight lines outwards.", "camera", "calibrated", fx=240.0, k1=-0.15,
                       **VIEW | {"to_world": LookAt((-0.5, -2.9, 1.0), (0, 0, -0.15))}),
    "orthographic": lone("No perspective: squares have the same size near and far.", "camera", "orthographic",
                         **VIEW | {"to_world": Scaled(LookAt((-0.8, -4.6, 1.5), (0, 0, -0.15)), 1.4)}),
    "perspective": lone("A pinhole: what is far is small, and all is sharp.", "camera", "perspective", fov=34.0, **VIEW),
    "thinlens": lone("A lens that is focused on the front of the ball: the floor behind is blurred.", "camera", "thinlens",
                     fov=34.0, aperture_radius=0.12, focus_distance=3.9, **VIEW),
}
FILMS = {"hdrfilm": seen("The right lower part of the image, rendered alone.", film={
    "width": 256, "height": 256, "crop_offset_x": 128, "crop_offset_y": 128, "crop_width": 128, "crop_height": 128})}
FILTERS = {
    "box": filtered("Each sample counts in one pixel: the edge is one pixel wide.", "box"),
    "catmullrom": filtered("A sharp edge, with a faint darker line beside it.", "catmullrom"),
    "gaussian": filtered("A soft edge; the default.", "gaussian", stddev=0.5),
    "lanczos": filtered("The sharpest edge, with the darkest line beside it.", "lanczos", lobes=3),
    "mitchell": filtered("Between a soft edge and a sharp one.", "mitchell"),
    "tent": filtered("A soft edge.", "tent", radius=1.0),
}
SAMPLERS = {
    "independent": sampled("Four samples of each pixel: grainy where light is soft.", "independent"),
    "ldsampler": sampled("Four samples of each pixel: less grain than with `independent`.", "ldsampler"),
    **{name: sampled("The same points as those of `ldsampler`.", name, "ldsampler")
       for name in ("multijitter", "orthogonal", "stratified")},
}
NESTED = {"type": "path", "max_depth": 8}
INTEGRATORS = {
    "aov": lone("The normals of what is seen, beside the image; as colours.", "integrator", "aov", aovs="normals:sh_normal",
                image=NESTED, output="sh_normal"),
    "direct": lone("Light that comes straight from the lamp: shadows are black.", "integrator", "direct"),
    "direct_projective": lone("The image of `direct`.", "integrator", "direct_projective", like="direct"),
    "moment": lone("The image of the nested integrator.", "integrator", "moment", image=NESTED, like="path"),
    "path": lone("Light that is reflected up to seven times: the floor lights the ball from below.", "integrator", "path",
                 max_depth=8),
    **{name: lone("The image of `path`.", "integrator", name, max_depth=8, like="path")
       for name in ("prb", "prb_basic", "prb_projective", "prbvolpath", "ptracer", "volpath", "volpathmis")},
}
MEDIA = {
    "heterogeneous": Example("A puff of smoke in an invisible box, before the ball.", {
        "camera": CAMERA, "lamp": LAMP, "puff": {
            "type": "cube", "to_world": Placed((0.7, 0.7, 0.7), (-0.5, -1.3, -0.25)), "bsdf": {"type": "null"},
            "interior": {"type": "heterogeneous", "scale": 8.0, "albedo": 0.6, "sigma_t": {
                "type": "gridvolume", "filename": Asset("shapes/puff.vol"),
                "to_world": Placed((1.4, 1.4, 1.4), (-1.2, -2.0, -1))}}}}, samples=MANY),
    "homogeneous": foggy("A ball in fog, which the lamp above it lights.", {}),
}
PHASES = {
    "blendphase": foggy("Air with drops in it: they light up around the lamp.", {"phase": {
        "type": "blendphase", "weight": 0.5, "phase_0": {"type": "rayleigh"}, "phase_1": {"type": "hg", "g": 0.9}}}),
    "hg": foggy("Fog that scatters light mostly forwards: it is darker seen from the side of the lamp.", {
        "phase": {"type": "hg", "g": 0.7}}),
    "isotropic": foggy("Fog that scatters light into all directions alike.", {"phase": {"type": "isotropic"}}),
    "rayleigh": foggy("Air, so thick that it is seen.", {"phase": {"type": "rayleigh"}}),
    "sggx": foggy("Fibres along x in the air.", {"phase": {
        "type": "sggx", "S": {"type": "gridvolume", "filename": Asset("shapes/fibres.vol")}}}),
    "tabphase": foggy("Fog that scatters light forwards and backwards, by a table.", {"phase": {
        "type": "tabphase", "values": "2, 0.4, 0.2, 0.4, 4"}}),
}
VOLUMES = {
    "constvolume": foggy("Fog whose drops are coloured.", {
        "albedo": {"type": "constvolume", "value": {"type": "rgb", "value": [0.6, 0.8, 1.0]}}}),
    "gridvolume": foggy("Fog that scatters light forwards in a puff above the ball, and backwards around it.", {"phase": {
        "type": "blendphase", "phase_0": {"type": "hg", "g": -0.6}, "phase_1": {"type": "hg", "g": 0.6}, "weight": {
            "type": "gridvolume", "filename": Asset("shapes/puff.vol"), "to_world": Placed((4, 4, 3), (-2, -2, 0))}}}),
}
EXAMPLES = {"bsdf": BSDFS, "texture": TEXTURES, "emitter": EMITTERS, "shape": SHAPES, "sensor": SENSORS, "film": FILMS,
            "rfilter": FILTERS, "sampler": SAMPLERS, "integrator": INTEGRATORS, "medium": MEDIA, "phase": PHASES,
            "volume": VOLUMES}
