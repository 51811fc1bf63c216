"""Materials, normals and shapes that paths from lamps meet: their light is that of paths from the camera."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but
from tests.light_paths.agreement import SEEDS, SPP, assert_agree, images
from tests.light_paths.scenes import LAMPS, camera_named, lit_ball
from tests.scenes import diffuse, load, rectangle, sensor, texels
from tests.scenes.meshes import icosphere
from torch_radbp.io.values.transform import translate

WHITE, BRUSHED = diffuse(0.8, 0.8, 0.8), {"type": "roughconductor", "alpha": 0.3}
FLAT = np.full((4, 4, 3), (0.6, 0.55, 0.9), np.float32)  # a normal in the tangent frame, as a colour
MATERIALS = {
    "normal map": {"type": "normalmap", "normalmap": {"type": "bitmap", "data": FLAT, "raw": True}, "bsdf": BRUSHED},
    "mask": {"type": "mask", "opacity": 0.5, "bsdf": {"type": "conductor"}},
    "two sides": {"type": "twosided", "bsdf": BRUSHED},
    "two sides of a blend": {"type": "twosided", "bsdf": {
        "type": "blendbsdf", "weight": {"type": "bitmap", "data": texels(4, 4), "raw": True},
        "bsdf_0": {"type": "conductor"},
        "bsdf_1": {"type": "bumpmap", "arbitrary": {"type": "checkerboard"}, "bsdf": diffuse(0.5, 0.6, 0.7)}}},
    "thin glass": {"type": "thindielectric"},
}


def smooth_ball(bsdf: dict, bend: float = 0.5) -> dict:
    """A ball of few faces, with vertex normals that are turned away from its own."""
    vertices, faces = icosphere(1)
    normals = torch.nn.functional.normalize(vertices + bend * vertices.roll(1, dims=1), dim=1)
    centre = torch.tensor([0.3, 0.0, 0.6])
    return {"type": "mesh", "vertex_positions": 0.6 * vertices.float() + centre, "faces": faces,
            "vertex_normals": normals.float(), "bsdf": bsdf}


@pytest.mark.parametrize("name", deep_but(["normal map", "two sides of a blend"], MATERIALS))
def test_light_by_way_of_nested_materials_counts_once(name):
    scene = lit_ball("area", bsdf=MATERIALS[name])
    assert_agree(images(scene, "camera"), images(scene, "all"))


@pytest.mark.parametrize("bsdf", deep_but([WHITE], [WHITE, BRUSHED, {"type": "roughdielectric", "alpha": 0.3}]))
def test_shading_normals_are_those_of_the_adjoint_bsdf(bsdf):
    """Veach 1997, section 5.3: with normals far from those of the faces, an image without the correction is another."""
    scene = load(torch.float32, integrator={"type": "path", "max_depth": 4}, camera=camera_named("perspective"),
                 floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)), lamp=LAMPS["area"], ball=smooth_ball(bsdf))
    assert_agree(images(scene, "camera"), images(scene, "all"))


def test_instances_are_met_and_surround_the_scene():
    group = {"type": "shapegroup", "ball": {"type": "sphere", "radius": 0.4, "bsdf": BRUSHED}}
    scene = load(torch.float32, integrator={"type": "path", "max_depth": 4}, camera=camera_named("perspective"),
                 floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)), lamp=LAMPS["directional"],
                 shown={"type": "instance", "to_world": translate((0.6, 0, 0.5)), "group": group})
    assert_agree(images(scene, "camera"), images(scene, "all"))


def test_light_of_sun_and_sky_is_that_of_paths_from_the_camera():
    sky = {"type": "sunsky", "sun_direction": [0.3, 0.2, 0.9]}
    scene = load(torch.float32, integrator={"type": "path", "max_depth": 3}, camera=camera_named("perspective"), sky=sky,
                 floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)))
    assert_agree(images(scene, "camera"), images(scene, "all"))


def test_several_cameras_have_what_each_has_alone():
    """As far as noise tells: each has paths of its own."""
    def scene_of(**cameras) -> rb.Scene:
        return load(torch.float32, integrator={"type": "path", "max_depth": 4}, lamp=LAMPS["point"], **cameras,
                    floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)))

    cameras = {"a": camera_named("perspective"), "b": sensor(8, (2, 0, 3), (0, 0, 0), 50)}
    renderer = rb.Renderer(scene_of(**cameras), light_paths="all", spp=SPP)
    with torch.no_grad():
        both = torch.stack([renderer(sensors=["a", "b"], seed=seed) for seed in range(SEEDS)])
    for number, (name, camera) in enumerate(cameras.items()):
        assert_agree(images(scene_of(**{name: camera}), "camera"), both[:, number])
