"""The scenes that are compared, and the cameras: every case by its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.scenes.xml import matrix
from tests.scenes.xml.basics import SKY, bitmaps, cornell_box, hidden_emitters, shapes, sky
from tests.scenes.xml.files import Case, Folder, bitmap, diffuse, picture, scene_xml, shape, size
from tests.scenes.xml.gltf import gltf
from tests.scenes.xml.layered import blends, bump_maps, masks, normal_maps, plastics, rough_plastics
from tests.scenes.xml.lights import (
    beams,
    daylight,
    envmap,
    envmap_compensated,
    every_light,
    many_lamps,
    points,
    projector,
    spots,
)
from tests.scenes.xml.materials import (
    brushed,
    brushed_turned,
    coloured_roughness,
    glass,
    mirrors,
    polished,
    principled,
    rough_glass,
    rough_metals,
)
from tests.scenes.xml.shapes import distances, instances, tubes
from tests.scenes.xml.textures import textures

BOX = '<rfilter type="box"/>'
FOV = '<float name="fov" value="40"/>'
BORDER = '<boolean name="sample_border" value="true"/>'
LOOK = '<transform name="to_world"><lookat origin="0.3, -0.2, 3" target="0, 0, 0" up="0.1, 1, 0"/></transform>'


class Camera(NamedTuple):
    sensor: str
    film: str = size(24, 16)
    rfilter: str = BOX
    place: str = LOOK
    type: str = "perspective"


def fov(axis: str, film: str = size(24, 16)) -> Camera:
    return Camera(f'<string name="fov_axis" value="{axis}"/>{FOV}', film)


def crop(x: int, y: int, width: int, height: int) -> str:
    values = {"crop_offset_x": x, "crop_offset_y": y, "crop_width": width, "crop_height": height}
    return size(36, 24) + "".join(f'<integer name="{name}" value="{value}"/>' for name, value in values.items())


CAMERAS = {
    **{f"fov_{axis}": fov(axis) for axis in ("x", "y", "diagonal", "smaller", "larger")},
    "fov_smaller_upright": fov("smaller", size(16, 24)),
    "fov_larger_upright": fov("larger", size(16, 24)),
    "focal_length": Camera('<string name="focal_length" value="50mm"/>'),
    "focal_length_upright": Camera('<string name="focal_length" value="35mm"/>', size(16, 24)),
    "principal_point": Camera(FOV + '<float name="principal_point_offset_x" value="0.15"/>'
                                    '<float name="principal_point_offset_y" value="-0.22"/>'),
    "crop": Camera(FOV, crop(5, 9, 20, 11)),
    "tent": Camera(FOV, size(24, 16) + BORDER, '<rfilter type="tent"/>'),
    "gaussian": Camera(FOV, size(24, 16) + BORDER, '<rfilter type="gaussian"/>'),
    "gaussian_wide_crop": Camera(FOV, crop(7, 3, 20, 16) + BORDER,
                                 '<rfilter type="gaussian"><float name="stddev" value="0.8"/></rfilter>'),
    "gaussian_no_border": Camera(FOV, rfilter='<rfilter type="gaussian"/>'),
    **{f"{name}{'' if border else '_no_border'}": Camera(FOV, size(24, 16) + border, f'<rfilter type="{name}"/>')
       for name, border in (("mitchell", BORDER), ("catmullrom", BORDER), ("lanczos", BORDER), ("lanczos", ""))},
    "default_filter": Camera(FOV, size(24, 16) + BORDER, ""),
    "transform_chain": Camera(FOV, place='<transform name="to_world"><rotate z="1" angle="12"/><rotate y="1" angle="176"/>'
                                         '<translate x="0.2" y="-0.1" z="3"/></transform>'),
    "orthographic": Camera(
        '<float name="near_clip" value="0.5"/>', crop(3, 2, 20, 12), type="orthographic",
        place='<transform name="to_world"><scale x="1.6" y="1.3" z="0.7"/><lookat origin="0.5, -0.4, 3" target="0, 0.1, 0" '
              'up="0.1, 1, 0"/></transform>'),
    "thinlens": Camera(FOV + '<float name="aperture_radius" value="0.25"/><float name="focus_distance" value="2"/>',
                       type="thinlens"),
    "matrix": Camera(FOV, place='<transform name="to_world"><rotate y="1" angle="180"/>'
                                '<matrix value="1 0 0 0.1  0 1 0 0.2  0 0 1 3  0 0 0 1"/></transform>'),
}


def poster(name: str) -> Callable[[Folder], Path]:
    """An emissive poster before one of `CAMERAS`: nothing but the sensor and the film decides these images."""
    camera = CAMERAS[name]

    def build(folder: Folder) -> Path:
        folder.pixels("poster.exr", 2 * picture(12, 12, seed=21))
        emitter = f'<emitter type="area">{bitmap("radiance", "poster.exr")}</emitter>'
        return folder.text("scene.xml", scene_xml(
            camera.film, camera.sensor + camera.place,
            shape("rectangle", "poster", diffuse("0"), emitter) + SKY.format("0.1, 0.2, 0.3"),
            '<integer name="max_depth" value="2"/>', camera.rfilter, camera.type))

    return build


CASES = {
    # At depth 1 nothing but the lamp is seen, and its edge is all the noise: more samples for the same certainty.
    **{f"cornell_depth_{depth}": Case(cornell_box, {"resolution": 32, "max_depth": depth}, spp=256 if depth == 1 else 64)
       for depth in (1, 2, 3, 8)},
    "cornell_roulette": Case(cornell_box, {"resolution": 32, "max_depth": -1, "rr_depth": 1}),
    "shapes": Case(shapes),
    "tubes": Case(tubes),
    "distances": Case(distances),
    "instances": Case(instances),
    "bitmaps": Case(bitmaps),
    "textures": Case(textures),
    "sky": Case(sky, thin=3),
    "hidden_emitters": Case(hidden_emitters, peer_integrator="volpath"),
    "points": Case(points),
    "envmap": Case(envmap),
    "envmap_compensated": Case(envmap_compensated),
    "spots": Case(spots),
    "projector": Case(projector),
    "beams": Case(beams, spp=384, peer_integrator="ptracer", peer_spp=3000),
    "every_light": Case(every_light),
    "daylight": Case(daylight),
    "many_lamps": Case(many_lamps, spp=128, peer_integrator="volpath"),
    "mirrors": Case(mirrors),
    "glass": Case(glass),
    "rough_metals": Case(rough_metals),
    "coloured_roughness": Case(coloured_roughness),
    "rough_glass": Case(rough_glass),
    "brushed": Case(brushed),
    "brushed_turned": Case(brushed_turned),
    "polished": Case(polished),
    "plastics": Case(plastics),
    "rough_plastics": Case(rough_plastics),
    "blends": Case(blends),
    "masks": Case(masks),
    "normal_maps": Case(normal_maps),
    "bump_maps": Case(bump_maps),
    "principled": Case(principled),
    "gltf": Case(gltf),
    **matrix.cases(matrix.SMALL),
    **{f"camera_{name}": Case(poster(name), peer_spp=256, peer_batches=32, thin=1 if camera.rfilter == BOX else 5)
       for name, camera in CAMERAS.items()},
}
