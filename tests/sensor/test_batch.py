"""Several sensors of one film."""

import pytest
import torch

import torch_radbp as rb
from tests.gradients import image_and_gradients
from tests.scenes import cornell, diffuse, load, look_at, rectangle, rgb
from torch_radbp.io.write import save

SKY = {"type": "constant", "radiance": rgb(0.4, 0.6, 0.9)}
BOX = {"type": "cube", "to_world": look_at((0, 0, 0), (1, 2, 3), (0, 1, 0)), "bsdf": diffuse(0.7, 0.3, 0.2)}


def views() -> dict:
    """Two sensors with films of their own, which do not count."""
    return {"left": {"type": "perspective", "fov": 50, "to_world": look_at((0.2, 0.3, 5), (0, 0, 0), (0, 1, 0))},
            "right": {"type": "thinlens", "fov": 60, "aperture_radius": 0.2, "focus_distance": 5.0, "id": "blurred",
                      "to_world": look_at((-4, 1, 3), (0, 0, 0), (0, 1, 0)), "film": {"type": "hdrfilm", "width": 3}}}


def batch(**more) -> dict:
    film = {"type": "hdrfilm", "width": 16, "height": 6, "rfilter": {"type": "box"}}
    return {"type": "batch", "film": film, "sampler": {"type": "independent", "sample_count": 8}, **views(), **more}


def test_each_sensor_is_an_image_and_its_film_is_a_share():
    scene = load(cameras=batch(), sky=SKY, box=BOX)
    assert list(scene.named_sensors) == ["cameras.sensor0", "cameras.blurred"]
    assert {"cameras.sensor0.x_fov", "cameras.blurred.aperture_radius"} < {name for name, _ in scene.named_parameters()}
    image = rb.render(scene)  # 8 samples, as the batch says
    assert image.shape == (2, 3, 6, 8) and (image[0] - image[1]).abs().max() > 0.1
    film = {"type": "hdrfilm", "width": 8, "height": 6, "rfilter": {"type": "box"}}
    single = {name: view | {"film": film, "sampler": {"type": "independent"}} for name, view in views().items()}
    assert torch.equal(image, rb.render(load(**single, sky=SKY, box=BOX), spp=8))


def test_sensors_are_chosen_by_name_or_number():
    scene = load(cameras=batch(), sky=SKY, box=BOX, other={"type": "perspective"})
    image = rb.render(scene, spp=4, sensors=["cameras.blurred"])
    assert torch.equal(image, rb.render(scene, spp=4, sensors=1))
    with pytest.raises(ValueError, match="no sensor 'cameras'; .*known: cameras.blurred, cameras.sensor0, other"):
        rb.render(scene, spp=4, sensors="cameras")


def test_side_by_side_the_images_are_that_of_mitsuba():
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    objects = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.4, 0.6, 0.9]}},
               "box": BOX | {"to_world": mi.ScalarTransform4f(BOX["to_world"])}}
    cameras = batch()
    for name in ("left", "right"):
        cameras[name] = cameras[name] | {"to_world": mi.ScalarTransform4f(cameras[name]["to_world"])}
    theirs = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 2}, "cameras": cameras, **objects})
    expected = torch.tensor(mi.render(theirs, spp=1024).numpy())[..., :3]
    image = rb.render(load(torch.float32, cameras=batch(), sky=SKY, box=BOX), spp=1024, max_depth=2)
    assert expected.std() > 0.05
    assert (torch.cat(list(image), -1).movedim(0, -1) - expected).abs().max() < 0.04  # 5 standard errors of 1024 samples


def test_gradients_are_those_of_the_sensors_by_themselves():
    names = ["white.reflectance.value", "light.emitter.radiance.value"]
    film = {"type": "hdrfilm", "width": 8, "height": 6, "rfilter": {"type": "box"}}
    single = {f"{name} one": view | {"film": film} for name, view in views().items()}
    together = {"cameras": {"type": "batch", "film": film | {"width": 16}, **views()}}
    (image, gradients), (expected, wanted) = (
        image_and_gradients(cornell(sensors=sensors), names, spp=2, max_depth=3, compile=False)
        for sensors in (together, single))
    assert torch.equal(image, expected) and all(torch.equal(*pair) for pair in zip(gradients, wanted))


def test_saved_and_loaded_it_is_the_same(tmp_path):
    scene = load(torch.float32, cameras=batch(), sky=SKY, box=BOX)
    save(scene, tmp_path / "scene.xml")
    loaded = rb.load(tmp_path / "scene.xml")
    assert list(loaded.named_sensors) == list(scene.named_sensors)
    torch.testing.assert_close(rb.render(loaded, spp=4), rb.render(scene, spp=4), rtol=1e-4, atol=1e-5)


BAD = {
    "none": ({"left": None, "right": None}, "batch needs 'sensors', which is missing"),
    "width": ({"film": {"type": "hdrfilm", "width": 15}}, "must be a multiple of its 2 sensors, got 15"),
    "crop": ({"film": {"type": "hdrfilm", "width": 16, "crop_width": 8}}, "no crop window, got 8 x"),
    "itself": ({"left": {"type": "batch", "only": {"type": "perspective"}}}, "not another batch"),
    "name": ({"left": {"type": "perspective", "id": "film"}}, "cannot be called 'film'; use another id"),
}


@pytest.mark.parametrize("attributes, message", BAD.values(), ids=BAD)
def test_a_batch_that_cannot_be(attributes, message):
    given = {name: value for name, value in (batch() | attributes).items() if value is not None}
    with pytest.raises(rb.SceneError, match=message):
        load(cameras=given, sky=SKY, box=rectangle((0, 0, 0)))
