"""Photographs as a data set: what files mean, which camera sees what, what is refused."""

import json
import pickle

import numpy as np
import pytest
import torch
from PIL import Image
from torch.utils.data import DataLoader

import torch_radbp as rb
from tests.formats.exr_files import write_exr
from tests.formats.picture_files import png_of, tiff_of
from tests.photographs.nerf_folder import HEIGHT, WIDTH, ball_in_the_open, write_photographs, write_transforms
from torch_radbp.formats.image import srgb_to_linear

K, R, T = [[10.0, 0, 3.5], [0, 10, 2.5], [0, 0, 1]], np.eye(3), [0, 0, 2.0]


def camera(width=8, height=6):
    return rb.camera_from_opencv(K, R, T, width, height)


def levels(channels: int, seed: int = 0, width: int = 8, height: int = 6) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)


def test_eight_bits_are_decoded_by_the_curve_that_is_stated(tmp_path):
    pixels = levels(3)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    coded = torch.from_numpy(pixels).movedim(-1, 0) / 255
    for curve, expected in (("srgb", srgb_to_linear(coded)), ("linear", coded), (2.2, coded**2.2)):
        found = rb.Photographs([tmp_path / "a.png"], [camera()], curve=curve)[0]
        torch.testing.assert_close(found.image, expected, rtol=1e-6, atol=1e-7)
        assert torch.equal(found.mask, torch.ones(1, 6, 8)) and found.sensors == "view_0" and found.views == 0


def test_sixteen_bits_are_kept(tmp_path):
    values = torch.rand(6, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    words = (values * 65535).round().to(torch.int64).numpy().astype(np.uint16)
    Image.fromarray(words).save(tmp_path / "a.png")
    found = rb.Photographs([tmp_path / "a.png"], [camera()], curve="linear")[0].image
    torch.testing.assert_close(found, torch.from_numpy(words / 65535).float().expand(3, -1, -1), rtol=1e-6, atol=0)
    assert (found - values.float()).abs().max() < 1 / 65535


def test_exr_is_linear_whatever_the_curve_and_jpeg_is_not(tmp_path):
    image = torch.rand(3, 6, 8) * 5
    rb.save_image(tmp_path / "a.exr", image)
    assert torch.equal(rb.Photographs([tmp_path / "a.exr"], [camera()])[0].image, image)
    Image.new("RGB", (8, 6), (128, 128, 128)).save(tmp_path / "a.jpg", quality=100)
    found = rb.Photographs([tmp_path / "a.jpg"], [camera()])[0].image
    torch.testing.assert_close(found, srgb_to_linear(torch.tensor(128 / 255)).expand(3, 6, 8), rtol=0.02, atol=0)


def test_alpha_is_the_mask_and_the_background_is_seen_through_it(tmp_path):
    pixels = levels(4)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    colour, alpha = (torch.from_numpy(pixels).movedim(-1, 0) / 255).split([3, 1])
    colour = srgb_to_linear(colour)
    found = rb.Photographs([tmp_path / "a.png"], [camera()])[0]
    torch.testing.assert_close(found.mask, alpha)
    torch.testing.assert_close(found.image, colour * alpha)
    white = rb.Photographs([tmp_path / "a.png"], [camera()], background=1.0)[0].image
    torch.testing.assert_close(white, colour * alpha + (1 - alpha))


def test_colours_of_exr_are_multiplied_by_alpha_already(tmp_path):
    channels = {name: np.random.default_rng(k).uniform(0, 1, (6, 8)).astype(np.float32) for k, name in enumerate("RGBA")}
    write_exr(tmp_path / "a.exr", channels)
    found = rb.Photographs([tmp_path / "a.exr"], [camera()], background=(0.5, 0.25, 0.0))[0]
    colour, alpha = torch.from_numpy(np.stack([channels[c] for c in "RGB"])), torch.from_numpy(channels["A"])[None]
    torch.testing.assert_close(found.mask, alpha)
    torch.testing.assert_close(found.image, colour + (1 - alpha) * torch.tensor([0.5, 0.25, 0.0])[:, None, None])


def test_the_alpha_of_sixteen_bits_is_read_in_full(tmp_path):
    words = np.random.default_rng(1).integers(0, 65536, (6, 8, 4))
    (tmp_path / "a.png").write_bytes(png_of(words))
    found = rb.Photographs([tmp_path / "a.png"], [camera()], curve="linear")[0]
    expected = torch.from_numpy(words.astype(np.float64) / 65535).movedim(-1, 0)
    torch.testing.assert_close(found.mask, expected[3:].float(), rtol=1e-6, atol=0)
    torch.testing.assert_close(found.image, (expected[:3] * expected[3:]).float(), rtol=1e-5, atol=1e-7)


def test_masks_are_files_or_tensors_and_leave_the_image_as_it_is(tmp_path):
    pixels, mask = levels(3), levels(1, 1)[..., 0]
    Image.fromarray(pixels).save(tmp_path / "a.png")
    Image.fromarray(mask).save(tmp_path / "mask.png")
    soft = torch.from_numpy(mask)[None] / 255
    plain = rb.Photographs([tmp_path / "a.png"], [camera()])[0].image
    for given in (tmp_path / "mask.png", soft):
        found = rb.Photographs([tmp_path / "a.png"], [camera()], [given])[0]
        torch.testing.assert_close(found.mask, soft)
        assert torch.equal(found.image, plain)
    without = rb.Photographs([tmp_path / "a.png"], [camera()], [None])[0].mask
    assert torch.equal(without, torch.ones(1, 6, 8))


def test_a_batch_of_a_loader_is_what_the_renderer_takes(tmp_path):
    write_photographs(tmp_path)
    photographs = rb.Photographs.from_nerf(tmp_path / "transforms.json", rfilter="box", near_clip=0.5)
    assert photographs.names == ["view_0_png", "view_1_png", "view_2_png"]
    scene = rb.load_dict({"type": "scene", **photographs.cameras, **ball_in_the_open(0.5, 0.5, 0.5)})
    batch, rest = DataLoader(photographs, batch_size=2, num_workers=1)
    assert batch.image.shape == (2, 3, HEIGHT, WIDTH) and batch.mask.shape == (2, 1, HEIGHT, WIDTH)
    assert batch.sensors == ("view_0_png", "view_1_png") and batch.views.tolist() == [0, 1]
    rendered = rb.Renderer(scene, spp=1, max_depth=2)
    with torch.no_grad():
        assert rendered(sensors=batch.sensors).shape == batch.image.shape
        assert torch.equal(rendered(sensors=rest.sensors), rendered(sensors=[2]))
        assert torch.equal(rendered(sensors=photographs[-1].sensors), rendered(sensors=[2]))
    assert scene.sensors[0].near_clip == 0.5
    whole = photographs.batch()
    assert torch.equal(whole.image[:2], batch.image) and whole.views.tolist() == [0, 1, 2]


def test_a_photograph_is_what_its_camera_renders(tmp_path):
    """Axes, rows and columns: each differs from the image of its own camera by rounding, from others by much more."""
    images = write_photographs(tmp_path)
    photographs = rb.Photographs.from_nerf(tmp_path / "transforms.json")
    seen = photographs.batch().image / torch.tensor([1.0, 0.6, 1.4])[:, None, None, None]
    assert (seen - images).abs().max() < 0.01
    scene = rb.load_dict({"type": "scene", **photographs.cameras, **ball_in_the_open(0.6, 0.3, 0.1)})
    with torch.no_grad():
        again = rb.render(scene, spp=64, seed=3)
    assert (again - seen).abs().mean() < 0.005 and (again - seen.flip(3)).abs().mean() > 0.05


def test_photographs_of_colmap(tmp_path):
    (tmp_path / "images" / "folder").mkdir(parents=True)
    (tmp_path / "masks").mkdir()
    (tmp_path / "cameras.txt").write_text("1 SIMPLE_PINHOLE 8 6 7 4 3\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 0 0 1 1 folder/b.png\n\n")
    for k, name in enumerate(("a", "folder/b")):
        Image.fromarray(levels(3, k)).save(tmp_path / "images" / f"{name}.png")
    photographs = rb.Photographs.from_colmap(tmp_path, tmp_path / "images", curve="linear")
    assert photographs.names == ["a_png", "folder/b_png"]
    torch.testing.assert_close(photographs[1].image, torch.from_numpy(levels(3, 1)).movedim(-1, 0) / 255)
    with pytest.raises(FileNotFoundError, match=r"the image a.png has no mask; looked for .*a.png.png, .*masks.a.png"):
        rb.Photographs.from_colmap(tmp_path, tmp_path / "images", masks=tmp_path / "masks")
    (tmp_path / "masks" / "folder").mkdir()
    Image.new("L", (8, 6), 51).save(tmp_path / "masks" / "a.png.png")
    Image.new("L", (8, 6), 255).save(tmp_path / "masks" / "folder" / "b.png")
    masked = rb.Photographs.from_colmap(tmp_path, tmp_path / "images", masks=tmp_path / "masks")
    assert masked[0].mask.unique().tolist() == pytest.approx([0.2]) and masked[1].mask.min() == 1


def test_masks_of_nerf_are_read_where_frames_name_them(tmp_path):
    write_photographs(tmp_path)
    document = json.loads((tmp_path / "transforms.json").read_text())
    document["frames"][1]["mask_path"] = "hidden/m.png"
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    with pytest.raises(FileNotFoundError, match="m.png: file not found, the mask 'hidden/m.png' of the data set"):
        rb.Photographs.from_nerf(tmp_path / "transforms.json")
    (tmp_path / "hidden").mkdir()
    Image.new("L", (WIDTH, HEIGHT), 0).save(tmp_path / "hidden" / "m.png")
    photographs = rb.Photographs.from_nerf(tmp_path / "transforms.json")
    assert [float(each.mask.mean()) for each in photographs] == [1, 0, 1]


def test_files_that_were_reduced_have_cameras_of_their_size(tmp_path):
    """As images_2 of nerfstudio, beside images: 8 x 6 pixels of cameras of 16 x 12."""
    path = write_transforms(tmp_path)
    (tmp_path / "images_2").mkdir()
    for number in range(3):
        Image.fromarray(levels(3, number)).save(tmp_path / "images_2" / f"view_{number}.png")
    photographs = rb.Photographs.from_nerf(path, images=tmp_path / "images_2", scale=0.5)
    whole = rb.cameras_from_nerf(path)["view_0.png"]
    half = photographs.cameras["view_0_png"]
    assert (half.film.width, half.film.height) == (8, 6)
    assert float(half.fx) == pytest.approx(float(whole.fx) / 2) and float(half.cx) == pytest.approx(3.5)
    with pytest.raises(ValueError, match=r"has 8 x 6 pixels, and its camera 'view_0_png' 16 x 12; .*say scale=0.5"):
        rb.Photographs.from_nerf(path, images=tmp_path / "images_2")
    with pytest.raises(ValueError, match="has 8 x 6 pixels, and its camera 16 x 12, which is 4 x 3 with scale=0.25"):
        rb.Photographs.from_nerf(path, images=tmp_path / "images_2", scale=0.25)


def test_files_are_read_when_they_are_asked_for_and_kept_within_the_limit(tmp_path, monkeypatch):
    import torch_radbp.photographs.dataset as module

    for k in range(3):
        Image.fromarray(levels(3, k)).save(tmp_path / f"{k}.png")
    asked, read = [], module.read_picture

    def counted(picture, curve, background):
        asked.append(picture.image.stem)
        return read(picture, curve, background)

    monkeypatch.setattr(module, "read_picture", counted)
    of_two = 2 * 4 * 6 * 8 * 4  # bytes of two images and their masks
    photographs = rb.Photographs([tmp_path / f"{k}.png" for k in range(3)], [camera()] * 3, cache_bytes=of_two)
    assert asked == []
    for view in (0, 1, 0, 2, 0, 1):  # 1 is forgotten for 2
        photographs[view]
    assert asked == ["0", "1", "2", "1"]
    first = photographs[0].image
    first.zero_()
    assert photographs[0].image.max() > 0  # what is given away is a copy
    assert pickle.loads(pickle.dumps(photographs)).cache.held == 0


def test_truth_values_are_a_mask():
    mask = torch.rand(1, 6, 8, generator=torch.Generator().manual_seed(1)) > 0.4
    assert torch.equal(rb.Photographs([IMAGE], [camera()], [mask])[0].mask, mask.float())


def test_sizes_are_kept_apart_in_batches():
    images = [torch.rand(3, 6, 8), torch.rand(3, 8, 6), torch.rand(3, 6, 8), torch.rand(3, 6, 8)]
    cameras = [camera(image.shape[2], image.shape[1]) for image in images]
    photographs = rb.Photographs(images, cameras)
    with pytest.raises(ValueError, match=r"one size, \(height, width\), got \[\(6, 8\), \(8, 6\)\]"):
        photographs.batch()
    batches = photographs.batches(2, generator=torch.Generator().manual_seed(1))
    loaded = list(DataLoader(photographs, batch_sampler=batches))
    assert len(loaded) == len(batches) == 3
    assert sorted(view for batch in loaded for view in batch.views.tolist()) == [0, 1, 2, 3]
    assert list(photographs.batches(2, shuffle=False)) == [[0, 2], [3], [1]]


def test_webp_and_tiff_are_photographs(tmp_path):
    """Lossless, with alpha; TIFF in 16 bits."""
    pixels = levels(4)
    Image.fromarray(pixels).save(tmp_path / "a.webp", lossless=True, exact=True)
    (tmp_path / "a.tif").write_bytes(tiff_of(pixels.astype(np.uint16) * 257, ExtraSamples=2))
    Image.fromarray(pixels).save(tmp_path / "a.png")
    expected = rb.Photographs([tmp_path / "a.png"], [camera()])[0]
    for name in ("a.webp", "a.tif"):
        found = rb.Photographs([tmp_path / name], [camera()])[0]
        torch.testing.assert_close(found.image, expected.image, rtol=1e-6, atol=1e-7)
        torch.testing.assert_close(found.mask, expected.mask, rtol=1e-6, atol=0)


def test_grey_and_alpha_of_sixteen_bits_are_a_photograph(tmp_path):
    (tmp_path / "a.png").write_bytes(png_of(np.stack([np.full((6, 8), 1000), np.full((6, 8), 40000)], axis=2)))
    found = rb.Photographs([tmp_path / "a.png"], [camera()], curve="linear")[0]
    assert found.mask.unique().item() == pytest.approx(40000 / 65535, rel=1e-6)
    assert found.image.unique().item() == pytest.approx(1000 / 65535 * 40000 / 65535, rel=1e-6)


@pytest.mark.parametrize("orientation", [6, 8])
def test_a_file_that_is_shown_turned_is_told(tmp_path, orientation):
    """Stored as 8 x 6, shown as 6 x 8, and calibrated as it is shown; of another orientation nothing is said."""
    exif = Image.Exif()
    exif[274] = orientation
    for name in ("a.jpg", "a.webp", "a.png"):
        Image.fromarray(levels(3)).save(tmp_path / name, exif=exif)
        with pytest.raises(ValueError, match=rf"{name} has 8 x 6 pixels, and its camera 'view_0' 6 x 8; its EXIF data say "
                                             rf"that it is shown turned \(orientation {orientation}\).*exif_transpose"):
            rb.Photographs([tmp_path / name], [camera(6, 8)])
        rb.Photographs([tmp_path / name], [camera(8, 6)])[0]
    exif[274] = 3  # upside down
    Image.fromarray(levels(3)).save(tmp_path / "a.jpg", exif=exif)
    with pytest.raises(ValueError, match="6 x 8; is it the image of that camera, or turned on its side"):
        rb.Photographs([tmp_path / "a.jpg"], [camera(6, 8)])


def test_a_file_that_was_exchanged_for_one_of_another_size_is_told(tmp_path):
    """It would be stretched to the size that it had."""
    Image.fromarray(levels(3)).save(tmp_path / "a.png")
    Image.fromarray(levels(1)[..., 0]).save(tmp_path / "mask.png")
    photographs = rb.Photographs([tmp_path / "a.png"], [camera()], [tmp_path / "mask.png"], cache_bytes=0)
    photographs[0]
    Image.fromarray(levels(1, width=4, height=3)[..., 0]).save(tmp_path / "mask.png")
    with pytest.raises(ValueError, match="the mask .*mask.png has 4 x 3 pixels, and its image 8 x 6"):
        photographs[0]
    Image.fromarray(levels(3, width=16, height=12)).save(tmp_path / "a.png")
    Image.fromarray(levels(1, width=16, height=12)[..., 0]).save(tmp_path / "mask.png")
    for each in (photographs, photographs.at_scale(0.5)):
        with pytest.raises(ValueError, match="a.png has 16 x 12 pixels now, and had 8 x 6 when these photographs were made"):
            each[0]


def test_what_is_not_finite_does_not_count_where_the_mask_is_zero(tmp_path):
    """As in renderings that have NaN where nothing is."""
    values = np.random.default_rng(0).uniform(0, 1, (6, 8)).astype(np.float32)
    broken, alpha = values.copy(), np.ones_like(values)
    broken[0], broken[1, 2], alpha[:2] = np.nan, np.inf, 0
    write_exr(tmp_path / "a.exr", {"R": broken, "G": values, "B": values, "A": alpha})
    write_exr(tmp_path / "b.exr", {"R": broken, "G": values, "B": values})
    mask = torch.from_numpy(alpha)[None]
    for photographs in (rb.Photographs([tmp_path / "a.exr"], [camera()]),
                        rb.Photographs([tmp_path / "b.exr"], [camera()], [mask])):
        found = photographs[0]
        assert found.image.isfinite().all() and torch.equal(found.mask, mask)
        assert torch.equal(found.image[0, 2:], torch.from_numpy(values[2:]))
        assert photographs.at_scale(0.5)[0].image.isfinite().all()
    with pytest.raises(ValueError, match="b.exr: 9 values of the image are NaN or infinite; mend it first, or give a mask"):
        rb.Photographs([tmp_path / "b.exr"], [camera()])[0]


def test_alpha_is_cut_to_its_range_and_must_be_a_number(tmp_path):
    """Filters with negative lobes leave some beside."""
    values = np.random.default_rng(0).uniform(0, 1, (6, 8)).astype(np.float32)
    alpha = np.ones_like(values)
    alpha[0, 0], alpha[0, 1] = -0.02, 1.03
    write_exr(tmp_path / "a.exr", {**dict.fromkeys("RGB", values), "A": alpha})
    found = rb.Photographs([tmp_path / "a.exr"], [camera()])[0]
    assert found.mask[0, 0, :2].tolist() == [0, 1] and torch.equal(found.image[0], torch.from_numpy(values))
    alpha[3, 3] = np.nan
    write_exr(tmp_path / "a.exr", {**dict.fromkeys("RGB", values), "A": alpha})
    with pytest.raises(ValueError, match="a.exr: its alpha has values that are NaN or infinite; mend it first"):
        rb.Photographs([tmp_path / "a.exr"], [camera()])[0]


@pytest.mark.parametrize("least, greatest", [(-0.1, 1.0), (0.0, 1.1), (np.nan, 1.0)])
def test_a_mask_in_a_file_must_be_in_its_range(tmp_path, least, greatest):
    """Of which a cut value would say nothing: less than 0 makes a negative loss, more than 1 counts twice."""
    values = np.full((6, 8), greatest, dtype=np.float32)
    values[0, 0] = least
    write_exr(tmp_path / "mask.exr", {"Y": values})
    photographs = rb.Photographs([IMAGE], [camera()], [tmp_path / "mask.exr"])
    with pytest.raises(ValueError, match=r"mask.exr must be in \[0, 1\], how much of a pixel counts, got"):
        photographs[0]


def wrong_size(folder):
    Image.fromarray(levels(3)).save(folder / "a.png")
    rb.Photographs([folder / "a.png"], [camera(6, 8)])


def not_finite(folder):
    rb.Photographs([torch.full((3, 6, 8), torch.nan)], [camera()])[0]


IMAGE = torch.zeros(3, 6, 8)
BAD = {
    "no file": (lambda folder: rb.Photographs([folder / "a.png"], [camera()]), FileNotFoundError, "a.png: file not found"),
    "size": (wrong_size, ValueError, "a.png has 8 x 6 pixels, and its camera 'view_0' 6 x 8; is it the image of that"),
    "curve": (lambda _: rb.Photographs([IMAGE], [camera()], curve="sgrb"), ValueError,
              "curve must be a gamma greater than 0, .*got 'sgrb'; did you mean 'srgb'"),
    "gamma": (lambda _: rb.Photographs([IMAGE], [camera()], curve=0), ValueError, "curve must be a gamma greater than 0"),
    "number": (lambda _: rb.Photographs([IMAGE] * 2, [camera()]), ValueError, "got 2 images, 1 cameras and 2 masks"),
    "nothing": (lambda _: rb.Photographs([], []), ValueError, "got 0 images, 0 cameras"),
    "shape": (lambda _: rb.Photographs([IMAGE.movedim(0, -1)], [camera()]), ValueError,
              r"images\[0\] must have shape \(3, H, W\), got \(6, 8, 3\)"),
    "bytes": (lambda _: rb.Photographs([IMAGE.byte()], [camera()]), TypeError, "a path or a tensor of floating point numb"),
    "mask": (lambda _: rb.Photographs([IMAGE], [camera()], [torch.ones(1, 6, 7)]), ValueError,
             "the mask a tensor of shape .* has 7 x 6 pixels, and its image 8 x 6"),
    "levels": (lambda _: rb.Photographs([IMAGE], [camera()], [torch.full((1, 6, 8), 255.0)]), ValueError,
               r"masks\[0\] must be in \[0, 1\], got 255 to 255"),
    "camera": (lambda _: rb.Photographs([IMAGE], {"a": K}), TypeError, "the camera 'a' must be a sensor of one image"),
    "names": (lambda _: rb.Photographs([IMAGE] * 2, {"a.b": camera(), "a_b": camera()}), ValueError, "two cameras are call"),
    "background": (lambda _: rb.Photographs([IMAGE], [camera()], background=(1, 0)), ValueError, "a number or three"),
    "not finite": (not_finite, ValueError, "144 values of the image are NaN or infinite; mend"),
    "extension": (lambda folder: rb.Photographs([folder / "a.webp"], [camera()]), FileNotFoundError, "a.webp: file not fo"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("call, kind, message", BAD.values(), ids=BAD)
def test_what_cannot_be_a_photograph_is_named(tmp_path, call, kind, message):
    with pytest.raises(kind, match=message):
        call(tmp_path)


def test_an_index_beyond_the_end_ends_iteration():
    photographs = rb.Photographs([IMAGE], [camera()])
    assert len(list(photographs)) == 1
    with pytest.raises(IndexError, match="there are 1 photographs, from 0 to 0, got 1"):
        photographs[1]
