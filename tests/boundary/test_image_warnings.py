"""Who is told that an image is not what the scene was meant to show: once, by name, and nobody else."""

import warnings

import pytest
import torch
import trimesh

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at, rectangle, rgb, sensor, texels
from torch_radbp.io.values.transform import scale, translate

SKY = {"type": "constant", "radiance": rgb(0.5, 0.6, 0.7)}
PICTURE = {"type": "bitmap", "data": texels(4, 4)}
FILM = {"type": "hdrfilm", "width": 8, "height": 8}
BALL = trimesh.creation.icosphere(1)
OUTWARD, INWARD = torch.tensor(BALL.faces), torch.tensor(BALL.faces[:, ::-1].copy())
FLIPPED = {"type": "cube", "flip_normals": True}


def said(caught: str, scene: rb.Scene, **call) -> list[str]:
    """The warnings about something that a renderer gives in two calls."""
    renderer = rb.Renderer(scene, spp=1, max_depth=2, compile=False)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        for seed in range(2):
            renderer(seed=seed, **call)
    assert all(issubclass(warning.category, rb.SceneWarning) and warning.filename == __file__ for warning in found)
    return [str(warning.message) for warning in found if caught in str(warning.message)]


def mesh(faces: torch.Tensor = OUTWARD, **attributes) -> dict:
    return {"type": "mesh", "vertex_positions": torch.tensor(BALL.vertices), "faces": faces, **attributes}


def seen(origin=(0, 0, 3.5), target=(0, 0, 0), **shapes) -> rb.Scene:
    return load(camera=sensor(8, origin, target), sky=SKY, **shapes)


@pytest.mark.parametrize("attributes", [
    {"bsdf": {"type": "diffuse", "reflectance": PICTURE}},
    {"bsdf": {"type": "twosided", "brdf": {"type": "diffuse", "reflectance": {"type": "checkerboard"}}}},
    {"bsdf": {"type": "bumpmap", "texture": PICTURE, "bsdf": diffuse(0.5)}},
    {"bsdf": {"type": "diffuse", "reflectance": torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Sigmoid())}},
    {"emitter": {"type": "area", "radiance": PICTURE}}], ids=["bitmap", "nested", "bump map", "module", "light"])
def test_textures_on_a_mesh_without_coordinates_are_named(attributes):
    message, = said("coordinates", seen(ball=mesh(**attributes)))
    assert "`ball` has no surface coordinates" in message and "`ball.bsdf" in message or "`ball.emitter" in message


def test_textures_that_need_no_coordinates_or_have_them_are_not():
    of_one_texel = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels(1, 1)}}
    picture, coordinates = {"type": "diffuse", "reflectance": PICTURE}, torch.zeros(len(BALL.vertices), 2)
    assert said("", seen(ball=mesh(bsdf=of_one_texel), second=mesh(bsdf=picture, vertex_texcoords=coordinates),
                         third={"type": "sphere", "bsdf": picture})) == []


@pytest.mark.parametrize("shape", [
    mesh(INWARD), FLIPPED, {"type": "sphere", "flip_normals": True}, mesh(vertex_normals=-torch.tensor(BALL.vertices)),
    mesh(INWARD, emitter={"type": "area", "radiance": rgb(1, 2, 3)})], ids=["mesh", "cube", "sphere", "normals", "lamp"])
def test_a_closed_surface_that_shows_the_camera_its_back_is_named(shape):
    message, = said("inwards", seen(ball=shape))
    assert "the faces of `ball` point inwards" in message and "flip_normals" in message


@pytest.mark.parametrize("scene", [
    seen(ball=mesh()), seen(ball=mesh(INWARD[:-1])), seen(ball=mesh(INWARD, vertex_normals=torch.tensor(BALL.vertices))),
    seen(ball=mesh(INWARD), origin=(0, 0, 0.2)), seen(room=FLIPPED, box={"type": "cube", "to_world": scale([0.1] * 3)},
                                                      origin=(0, 0, 0.6)),
    seen(ball=mesh(INWARD), target=(0, 0, 9)), seen(ball=mesh(INWARD, bsdf={"type": "dielectric"})),
    seen(ball=mesh(INWARD, bsdf={"type": "mask", "opacity": 0.5, "bsdf": diffuse(0.5)})),
    seen(ball=mesh(INWARD, bsdf={"type": "twosided", "bsdf": diffuse(0.5)})),
    seen(ball=mesh(INWARD, bsdf={"type": "blendbsdf", "weight": 0.5, **{
        name: {"type": "twosided", "bsdf": diffuse(0.5)} for name in ("one", "other")}})),
    seen(ball=mesh(INWARD), front=rectangle((0, 0, 2), 3)), seen(wall=rectangle((0, 0, 0), 0.5, (1, 0, 0), 180)),
    seen(room=FLIPPED, origin=(0, 0, 0.5), next_door=FLIPPED | {"to_world": translate((0, 0, -3))})],
    ids=["outward", "open", "normals outward", "room", "room with a box", "out of view", "glass", "mask", "two-sided",
         "two-sided within", "hidden", "wall from behind", "room next door"])
def test_no_other_surface_is(scene):
    assert said("inwards", scene) == []


def calibrated(**attributes) -> dict:
    return {"type": "calibrated", "fx": 8.0, "film": FILM, "to_world": look_at((0, 0, 3.5), (0, 0, 0), (0, 1, 0)),
            **attributes}


@pytest.mark.parametrize("attributes", [
    *({name: sign * 1e30} for name in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2") for sign in (1, -1)),
    {"distortion": "fisheye", "k1": 1e30}, {"distortion": "fisheye", "k2": -1e30}], ids=str)
def test_a_distortion_that_leaves_no_rays_is_said_of_the_camera_that_has_it(attributes):
    scene = load(plain=calibrated(), bent=calibrated(**attributes), sky=SKY, ball=mesh())
    assert said("distortion", scene, sensors="plain") == []
    renderer = rb.Renderer(scene, spp=1, max_depth=2, compile=False)
    renderer(seed=0, sensors="plain")
    with pytest.warns(rb.SceneWarning, match=r"the distortion of `bent` projects no direction onto (9\d|100)% of its image"):
        renderer(seed=0, sensors="bent")


@pytest.mark.parametrize("attributes", [
    {"k1": 0.3}, {"k1": -0.4, "k2": 0.1}, {"distortion": "fisheye", "k1": -0.01},
    {"distortion": "fisheye", "fx": 2.0, "film": FILM | {"width": 16}}], ids=str)  # the last: a circle in the middle
def test_a_distortion_of_a_lens_is_not(attributes):
    assert said("", load(camera=calibrated(**attributes), sky=SKY, ball=mesh())) == []
