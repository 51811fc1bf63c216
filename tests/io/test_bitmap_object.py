"""Mitsuba's `Bitmap` objects in scene dicts have the values that Mitsuba 3.9.1 reads from them."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.io.documents import scene_dict

IMAGE = np.random.default_rng(3).random((5, 7, 4)).astype(np.float32)
BYTES = (IMAGE * 255).astype(np.uint8)
ARRAYS = {"8 bits": BYTES[..., :3], "8 bits and alpha": BYTES, "8 bits, grey": BYTES[..., 0],
          "16 bits": (IMAGE * 65535).astype("u2"), "half": IMAGE[..., :3].astype("f2"), "float": IMAGE[..., :3],
          "float and alpha": IMAGE, "double": IMAGE.astype("f8")}


def texture(bitmap, raw: bool, name: str = "bitmap") -> dict:
    return {"type": "bitmap", name: bitmap, "raw": raw, "format": "variant"}


@pytest.mark.parametrize("raw", [False, True], ids=["", "raw"])
@pytest.mark.parametrize("array", ARRAYS.values(), ids=ARRAYS)
def test_the_values_are_those_of_mitsuba(mi, array, raw):
    bitmap = mi.Bitmap(array)
    theirs = np.array(mi.traverse(mi.load_dict(texture(bitmap, raw)))["data"])
    scene = rb.load_dict(scene_dict(white={"type": "diffuse", "reflectance": texture(bitmap, raw)}))
    ours = scene.get_parameter("white.reflectance.data").detach().numpy()
    assert 0.2 < theirs.mean() < 0.8
    assert ours.shape == theirs.shape
    np.testing.assert_allclose(ours, theirs, atol=2e-6)


@pytest.mark.parametrize("raw", [False, True], ids=["", "raw"])
@pytest.mark.parametrize("name", ["8 bits", "8 bits, grey"])
def test_arrays_of_bytes_are_read_as_their_bitmaps(mi, name, raw):
    theirs = np.array(mi.traverse(mi.load_dict(texture(mi.Bitmap(ARRAYS[name]), raw)))["data"])
    for array in (ARRAYS[name], torch.from_numpy(ARRAYS[name].copy())):
        scene = rb.load_dict(scene_dict(white={"type": "diffuse", "reflectance": texture(array, raw, name="data")}))
        ours = scene.get_parameter("white.reflectance.data").detach().numpy()
        assert ours.shape == theirs.shape and 0.2 < ours.mean() < 0.8
        np.testing.assert_allclose(ours, theirs, atol=2e-6)


def test_an_environment_map_of_bytes_is_decoded_as_well(mi):
    ours, theirs = (rb.load_dict(scene_dict(sky={"type": "envmap", "bitmap": image})).get_parameter("sky.data").detach()
                    for image in (BYTES[..., :3], mi.Bitmap(BYTES[..., :3])))
    np.testing.assert_allclose(ours.numpy(), theirs.numpy(), atol=2e-6)


def test_a_bitmap_that_says_that_it_is_srgb_is_decoded(mi):
    bitmap = mi.Bitmap(IMAGE[..., :3])
    bitmap.set_srgb_gamma(True)
    scene = rb.load_dict(scene_dict(white={"type": "diffuse", "reflectance": texture(bitmap, False, name="data")}))
    theirs = np.array(mi.traverse(mi.load_dict(texture(bitmap, False)))["data"])
    assert abs(theirs - IMAGE[..., :3]).max() > 0.1
    np.testing.assert_allclose(scene.get_parameter("white.reflectance.data").detach().numpy(), theirs, atol=2e-6)


def test_an_environment_map_takes_one(mi):
    scene = rb.load_dict(scene_dict(sky={"type": "envmap", "bitmap": mi.Bitmap(BYTES[..., :3])}))
    assert 0.1 < scene.get_parameter("sky.data").mean() < 0.6  # (5, 7) bytes, decoded


def test_a_bitmap_of_many_channels_is_refused(mi):
    bitmap = mi.Bitmap(np.zeros((4, 4, 6), np.float32))
    with pytest.raises(rb.SceneError, match="white.reflectance.bitmap: a Bitmap must have one of .* got MultiChannel"):
        rb.load_dict(scene_dict(white={"type": "diffuse", "reflectance": texture(bitmap, False)}))


def test_arrays_of_many_lanes_are_no_plain_values(mi):
    mi.set_variant("llvm_ad_rgb")
    try:
        with pytest.raises(rb.SceneError, match=r"ball.center: center must be three numbers, got Point3f of shape \(3, 1\)"):
            rb.load_dict(scene_dict(ball={"type": "sphere", "center": mi.Point3f(0, 1, 2)}))
    finally:
        mi.set_variant("scalar_rgb")


def test_objects_that_mitsuba_has_made_are_refused_with_advice(mi):
    with pytest.raises(rb.SceneError, match="what Mitsuba has made of a description cannot be read: give the description"):
        rb.load_dict(scene_dict(ball=mi.load_dict({"type": "sphere"})))
    with pytest.raises(rb.SceneError, match=r"ball.bsdf: [\s\S]* cannot be read: give the description"):
        rb.load_dict(scene_dict(ball={"type": "sphere", "bsdf": mi.load_dict({"type": "diffuse"})}))
