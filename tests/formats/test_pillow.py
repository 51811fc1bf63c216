"""Pictures of whole numbers: every bit of 16, alpha, WebP and TIFF, and what Pillow would get wrong in silence."""

import resource
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, features

import torch_radbp as rb
from tests.formats.picture_files import png_of, tiff_of
from torch_radbp.formats.alpha import image_size, read_alpha
from torch_radbp.formats.image import read_image
from torch_radbp.formats.memory import memory_for

ROUNDING = 1e-7  # of float32


@pytest.fixture
def words():
    return np.random.default_rng(3).integers(0, 65536, (5, 4, 4))


def check(path, content, expected, atol=ROUNDING):
    """The colours and the alpha of a file are those of an (H, W, C) array in [0, 1]."""
    path.write_bytes(content)
    colours = expected[:, :, :3 if expected.shape[2] > 2 else 1]
    np.testing.assert_allclose(read_image(path, raw=True).numpy(), colours, rtol=0, atol=atol)
    alpha = read_alpha(path)
    if expected.shape[2] in (2, 4):
        np.testing.assert_allclose(alpha.numpy(), expected[:, :, -1], rtol=0, atol=atol)
    else:
        assert alpha is None
    assert image_size(path) == (expected.shape[1], expected.shape[0])


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_of_sixteen_bits_keeps_them_all(tmp_path, words, channels):
    check(tmp_path / "a.png", png_of(words[:, :, :channels]), words[:, :, :channels] / 65535)


def test_grey_and_alpha_of_sixteen_bits_are_not_cut_to_eight(tmp_path):
    """Of 1000 / 65535 eight bits leave 3 / 255, 23% less."""
    pixels = np.full((2, 3, 2), 1000)
    (tmp_path / "a.png").write_bytes(png_of(pixels))
    assert read_image(tmp_path / "a.png", raw=True).shape == (2, 3, 1)
    assert read_image(tmp_path / "a.png", raw=True).unique().item() == pytest.approx(1000 / 65535, rel=1e-6)
    assert read_alpha(tmp_path / "a.png").unique().item() == pytest.approx(1000 / 65535, rel=1e-6)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_transparent_colour_of_sixteen_bits_is_compared_in_all_of_them(tmp_path, words, channels):
    pixels = words[:, :, :channels].copy()
    key = (0x1234, 0x5678, 0x9abc)[:channels]
    pixels[0, 0], pixels[1, 1] = key, [part + 1 for part in key]  # the latter has the same high bytes
    alpha = np.ones((5, 4, 1))
    alpha[0, 0] = 0
    check(tmp_path / "a.png", png_of(pixels, key), np.concatenate([pixels / 65535, alpha], axis=2))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels, tags", [(1, {}), (3, {}), (4, {"ExtraSamples": 2})])
def test_tiff_is_read_with_all_its_bits(tmp_path, words, channels, tags, bits, order):
    values = words[:, :, :channels] >> (16 - bits)
    check(tmp_path / "a.tif", tiff_of(values, order, bits, **tags), values / (2**bits - 1))


def test_a_channel_that_tiff_does_not_name_is_no_alpha(tmp_path, words):
    check(tmp_path / "a.tif", tiff_of(words, ExtraSamples=0), words[:, :, :3] / 65535)


@pytest.mark.parametrize("bits", [8, 16])
def test_tiff_whose_zero_is_white_is_turned_round(tmp_path, words, bits):
    values = words[:, :, :1] >> (16 - bits)
    check(tmp_path / "a.tif", tiff_of(values, bits=bits, PhotometricInterpretation=0), 1 - values / (2**bits - 1))


def test_the_orientation_of_tiff_counts_and_so_does_the_size(tmp_path, words):
    """Orientation 6: the first row of the file is the right column of the image (TIFF 6.0, page 36)."""
    colours = words[:, :, :3]
    check(tmp_path / "a.tiff", tiff_of(colours, Orientation=6), np.rot90(colours, -1) / 65535)


@pytest.mark.skipif(not features.check("libtiff"), reason="Pillow was built without libtiff")
@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_deflate", "packbits"])
def test_compressed_tiff(tmp_path, words, compression):
    grey, colours = words[:, :, 0].astype(np.uint16), (words >> 8).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "grey.tif", compression=compression)
    np.testing.assert_allclose(read_image(tmp_path / "grey.tif", raw=True)[..., 0].numpy(), grey / 65535, atol=ROUNDING)
    Image.fromarray(colours).save(tmp_path / "a.tif", compression=compression)
    check(tmp_path / "a.tif", (tmp_path / "a.tif").read_bytes(), colours / 255)


@pytest.mark.skipif(not features.check("webp"), reason="Pillow was built without WebP")
@pytest.mark.parametrize("channels", [3, 4])
def test_webp_is_what_was_written(tmp_path, words, channels):
    pixels = (words[:, :, :channels] >> 8).astype(np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.webp", lossless=True, exact=True)
    check(tmp_path / "a.webp", (tmp_path / "a.webp").read_bytes(), pixels / 255)


def several(folder: Path, suffix: str, words: np.ndarray) -> bytes:
    """A file of two pictures."""
    first, second = (Image.fromarray((words[:, :, :3] >> shift).astype(np.uint8)) for shift in (8, 9))
    first.save(folder / f"two{suffix}", save_all=True, append_images=[second])
    return (folder / f"two{suffix}").read_bytes()


def saved(folder: Path, mode: str, words: np.ndarray) -> bytes:
    """A TIFF file of one of Pillow's modes of 32 bits."""
    Image.fromarray(words[:, :, 0].astype(np.float32 if mode == "F" else np.int32), mode=mode).save(folder / "wide.tif")
    return (folder / "wide.tif").read_bytes()


REFUSED = {
    "apart": (".tif", lambda folder, words: tiff_of(words[:, :, :3], PlanarConfiguration=2), "its channels are stored one"),
    "apart, grey": (".tif", lambda folder, words: tiff_of(words[:, :, :1], bits=8, PlanarConfiguration=2), "one after"),
    "multiplied": (".tif", lambda folder, words: tiff_of(words, ExtraSamples=1), "16 bits in the layout RGBa;16L are not"),
    "inks": (".tif", lambda folder, words: tiff_of(words, PhotometricInterpretation=5), "16 bits in the layout CMYK;16L"),
    "floats": (".tif", lambda folder, words: saved(folder, "F", words), "its numbers have 32 bits; supported are"),
    "integers": (".tif", lambda folder, words: saved(folder, "I", words), "its numbers have 32 bits; supported are"),
    "pages": (".tif", lambda folder, words: several(folder, ".tif", words), "it has 2 pictures; keep one"),
    "film": (".webp", lambda folder, words: several(folder, ".webp", words), "it has 2 pictures; keep one"),
    "few rows": (".tif", lambda folder, words: tiff_of(words, ExtraSamples=2, RowsPerStrip=2), "its strips have 8 of 20"),
    "cut short": (".tif", lambda folder, words: tiff_of(words)[:-9], "."),
    "another": (".webp", lambda folder, words: tiff_of(words), "the file begins as TIFF does; change its extension"),
    "not a picture": (".webp", lambda folder, words: b"RIFF\4\0\0\0WAVE", "cannot identify image file"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("suffix, make, message", REFUSED.values(), ids=REFUSED)
def test_what_would_be_read_wrongly_is_refused(tmp_path, words, suffix, make, message):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(make(tmp_path, words))
    with pytest.raises(ValueError, match=rf"a{suffix}: cannot be read as .*: .*{message}"):
        read_image(path)


def test_bmp_of_five_and_six_bits_is_read_as_before(tmp_path):
    """Its layout is called BGR;16, of all together."""
    import struct

    pixels = np.array([[0xF800, 0x07E0, 0x001F, 0xFFFF]], "<u2")  # red, green, blue, white
    header = struct.pack("<IiiHHIIiiII3I", 40, 4, 1, 1, 16, 3, 8, 0, 0, 0, 0, 0xF800, 0x07E0, 0x001F)
    (tmp_path / "a.bmp").write_bytes(b"BM" + struct.pack("<IHHI", 74, 0, 0, 66) + header + pixels.tobytes())
    assert read_image(tmp_path / "a.bmp", raw=True)[0].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]


@pytest.mark.hostile
@pytest.mark.skipif(sys.platform != "linux", reason="addresses are limited as on Linux")
def test_memory_that_the_system_refuses_is_said_with_the_file(tmp_path):
    """A picture of 4000 x 4000 pixels takes 48 MB as bytes and 192 MB as numbers; 150 MB of addresses are allowed."""
    path = tmp_path / "large.png"
    Image.new("L", (4000, 4000)).convert("RGB").save(path, compress_level=1)
    camera = rb.camera_from_opencv(torch.eye(3), torch.eye(3), torch.zeros(3), 4000, 4000)
    photographs = rb.Photographs([path], [camera])
    before = resource.getrlimit(resource.RLIMIT_AS)
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    for call in (lambda: read_image(path), lambda: photographs[0]):
        resource.setrlimit(resource.RLIMIT_AS, (held + 150 * 2**20, before[1]))
        try:
            with pytest.raises(MemoryError, match=r"large\.png: the system refused the memory for its content"):
                call()
        finally:
            resource.setrlimit(resource.RLIMIT_AS, before)


def test_what_torch_says_of_refused_memory_names_the_file_and_other_errors_stay():
    with pytest.raises(MemoryError, match="a.png: the system refused the memory for its content; make it smaller") as caught:
        with memory_for("a.png"), memory_for("a.png"):
            torch.empty(2**50)
    assert isinstance(caught.value.__cause__, RuntimeError)
    with pytest.raises(RuntimeError, match="another"), memory_for("a.png"):
        raise RuntimeError("another")
