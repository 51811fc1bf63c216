"""Images of one channel stay so: one parameter of one channel wherever a bitmap can stand, whose gradient is the sum."""

import numpy as np
import pytest
import torch
from PIL import Image

import torch_radbp as rb
from torch_radbp.formats.image import read_image, save_image
from torch_radbp.io.values.transform import translate
from torch_radbp.texture.bitmap import Bitmap

GREY = np.random.default_rng(5).uniform(0.2, 0.8, (3, 4)).astype(np.float32)
VIEW = rb.look_at([0.3, 0.2, 2.5], [0, 0, 0], [0, 1, 0])


def bitmap(image, **more):
    return {"type": "bitmap", "data": image, "raw": True, **more}


def wall(bsdf, **more):
    return {"wall": {"type": "rectangle", "bsdf": bsdf}, "sky": {"type": "constant", "radiance": [0.5, 1.0, 0.7]}, **more}


PLACES = {  # what surrounds an image, and the name of its parameter
    "reflectance": (lambda image: wall({"type": "diffuse", "reflectance": bitmap(image)}), "wall.bsdf.reflectance.data"),
    "trilinear": (lambda image: wall({"type": "diffuse", "reflectance": bitmap(image, filter_type="trilinear")}),
                  "wall.bsdf.reflectance.data"),
    "roughness": (lambda image: wall({"type": "roughconductor", "alpha": bitmap(image)},
                                     lamp={"type": "point", "position": [0.5, 1, 2], "intensity": 3.0}),
                  "wall.bsdf.alpha.data"),
    "opacity": (lambda image: wall({"type": "mask", "opacity": bitmap(image), "nested": {"type": "diffuse"}}),
                "wall.bsdf.opacity.data"),
    "heights": (lambda image: wall({"type": "bumpmap", "heights": bitmap(image), "nested": {"type": "diffuse"}},
                                   lamp={"type": "point", "position": [0.5, 1, 2], "intensity": 3.0}),
                "wall.bsdf.nested_texture.data"),
    "radiance": (lambda image: {"lamp": {"type": "rectangle", "to_world": translate((0, 0, -1)),
                                         "emitter": {"type": "area", "radiance": bitmap(image)}},
                                "ball": {"type": "sphere", "radius": 0.4}}, "lamp.emitter.radiance.data"),
    "surroundings": (lambda image: {"sky": {"type": "envmap", "bitmap": image}, "ball": {"type": "sphere", "radius": 0.6}},
                     "sky.data"),
}


def scene_of(objects):
    film = {"type": "hdrfilm", "width": 6, "height": 5, "rfilter": {"type": "box"}}
    return rb.load_dict({"type": "scene", "camera": {"type": "perspective", "fov": 50, "to_world": VIEW, "film": film},
                         **objects})


def rendered(objects, name):
    """The image, and the gradient of a weighted sum of it with respect to a parameter."""
    scene = scene_of(objects)
    data = scene.get_parameter(name).requires_grad_()
    image = rb.Renderer(scene, spp=4, max_depth=3, compile=False)(seed=1)
    weights = torch.linspace(-1, 2, image.numel()).view_as(image)
    (image * weights).sum().backward()
    return image.detach(), data.grad


@pytest.mark.parametrize("place", PLACES)
def test_the_gradient_is_the_sum_of_those_of_three_equal_channels(place):
    build, name = PLACES[place]
    image, gradient = rendered(build(GREY), name)
    same, gradients = rendered(build(np.repeat(GREY[..., None], 3, axis=2)), name)
    assert torch.allclose(image, same, rtol=1e-4, atol=1e-6)
    assert gradient.shape == (3, 4, 1) and gradients.shape == (3, 4, 3) and gradient.abs().max() > 0
    assert torch.allclose(gradient[..., 0], gradients.sum(2), rtol=1e-3, atol=1e-4 * gradient.abs().max().item())


@pytest.mark.parametrize("name", ["a.png", "a.exr", "a.pfm"])
def test_files_of_one_channel(name, tmp_path):
    if name == "a.pfm":
        (tmp_path / name).write_bytes(b"Pf\n4 3\n-1\n" + GREY[::-1].tobytes())
    else:
        save_image(tmp_path / name, torch.from_numpy(GREY)[None])
    found = Bitmap(filename=str(tmp_path / name)).data
    assert found.shape == (3, 4, 1) and read_image(tmp_path / name).shape == (3, 4, 1)
    assert torch.allclose(found[..., 0], torch.from_numpy(GREY), atol=0.01)


@pytest.mark.parametrize("raw", [False, True], ids=["", "raw"])
def test_bytes_are_fractions_of_255_in_srgb(raw):
    data = Bitmap(data=torch.tensor([[0, 51, 255]], dtype=torch.uint8), raw=raw).data
    assert torch.allclose(data[0, :, 0], torch.tensor([0.0, 0.2 if raw else 0.033105, 1.0]), atol=1e-6)


def test_bytes_are_those_of_the_file(tmp_path):
    pixels = np.random.default_rng(1).integers(0, 256, (3, 4, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    assert torch.equal(Bitmap(filename=str(tmp_path / "a.png")).data, Bitmap(data=torch.from_numpy(pixels)).data)


def test_integers_that_are_no_bytes_are_values():
    assert Bitmap(data=torch.tensor([[0, 7]])).data.flatten().tolist() == [0.0, 7.0]


@pytest.mark.parametrize("kind", ["xml", "glb"])
def test_what_is_saved_and_loaded_has_one_channel_still(kind, tmp_path):
    material = {"type": "principled", "base_color": [0.3, 0.5, 0.6], "roughness": bitmap(GREY)}
    scene = scene_of(wall(material))
    rb.save(scene, tmp_path / f"scene.{kind}")
    with pytest.warns(rb.GltfWarning) if kind == "glb" else torch.no_grad():
        again = rb.load(tmp_path / f"scene.{kind}")
    data, = (value for name, value in again.named_parameters() if name.endswith("roughness.data"))
    assert data.shape == (3, 4, 1) and torch.allclose(data[..., 0], torch.from_numpy(GREY), atol=0.01)


def test_an_environment_map_of_one_channel_is_saved_as_such(tmp_path):
    rb.save(scene_of(PLACES["surroundings"][0](GREY)), tmp_path / "scene.xml")
    assert rb.load(tmp_path / "scene.xml").get_parameter("sky.data").shape == (3, 4, 1)


@pytest.mark.hostile
@pytest.mark.parametrize("given", ["array", "file"])
def test_a_normal_map_of_one_channel_is_refused(given, tmp_path):
    image = bitmap(GREY)
    if given == "file":
        save_image(tmp_path / "a.exr", torch.from_numpy(GREY)[None])
        image = {"type": "bitmap", "filename": str(tmp_path / "a.exr"), "raw": True}
    which = "the bitmap" if given == "array" else str(tmp_path / "a.exr")
    with pytest.raises(rb.SceneError) as caught:
        scene_of(wall({"type": "normalmap", "normalmap": image, "nested": {"type": "diffuse"}}))
    assert str(caught.value) == ("wall.bsdf (type 'normalmap'): normalmap must have three channels, the components of the "
                                 f"normal; {which} has one: heights belong into a bumpmap")
