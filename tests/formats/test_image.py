"""Images in and out, against Mitsuba's reader and the formats' definitions."""

import struct
import tracemalloc
import zlib

import numpy as np
import pytest
import torch
from PIL import Image

import torch_radbp as rb
from tests.formats.exr_files import write_exr
from torch_radbp.formats.image import linear_to_srgb, read_image, save_image, srgb_to_linear

COMPRESSIONS = ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"]


@pytest.fixture
def pixels():
    return np.random.default_rng(0).uniform(0, 2, (9, 7, 3)).astype("f4")


@pytest.mark.parametrize("dtype", ["f4", "f2"])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_exr_of_every_compression(tmp_path, pixels, compression, dtype):
    write_exr(tmp_path / "a.exr", {"RGB": pixels.astype(dtype)}, compression)
    image = read_image(tmp_path / "a.exr")
    # Half has 11 significant bits; B44 is lossy by design (about 1/16 of a block's range) and so is PXR24 for float.
    tolerance = 0.15 if compression.startswith("B44") and dtype == "f2" else 1e-3 if dtype == "f2" else 2e-5
    assert image.dtype == torch.float32 and image.shape == (9, 7, 3)
    np.testing.assert_allclose(image.numpy(), pixels, atol=tolerance)


@pytest.mark.parametrize("names, shape", [
    (["Y"], (9, 7, 1)),
    (["R", "G", "B", "A"], (9, 7, 3)),
    (["A", "Y"], (9, 7, 1)),
    (["R", "G", "B", "Z", "normal.X"], (9, 7, 3)),
    (["beauty.R", "beauty.G", "beauty.B", "other.R", "other.G", "other.B"], (9, 7, 3)),
    (["ViewLayer.Combined.R", "ViewLayer.Combined.G", "ViewLayer.Combined.B", "ViewLayer.Depth.Z"], (9, 7, 3)),
    (["only.R", "only.G", "only.B"], (9, 7, 3)),
])
def test_exr_colour_is_found_among_channels(tmp_path, names, shape):
    values = {name: np.full((9, 7), number, "f4") for number, name in enumerate(names)}
    write_exr(tmp_path / "a.exr", values)
    image = read_image(tmp_path / "a.exr")
    assert image.shape == shape
    letters = ["R", "G", "B"] if shape[2] == 3 else ["Y"]
    assert image[0, 0].tolist() == [next(i for i, n in enumerate(names) if n.endswith(letter)) for letter in letters]


@pytest.mark.parametrize("channels, message", [
    (["Z"], "no colour among its channels Z"),
    (["Y", "RY", "BY"], "no colour"),
    (["a.R", "a.G", "a.B", "b.R", "b.G", "b.B"], "several layers have colours, a, b"),
])
def test_exr_without_one_clear_colour_is_refused(tmp_path, channels, message):
    write_exr(tmp_path / "a.exr", {name: np.zeros((2, 2), "f4") for name in channels})
    with pytest.raises(ValueError, match=rf"a\.exr: cannot be read as EXR: {message}"):
        read_image(tmp_path / "a.exr")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_png_agrees_with_mitsuba(mi, tmp_path, bits, channels):
    top = 2**bits - 1
    stored = np.random.default_rng(1).integers(0, top + 1, (6, 5, channels)).astype(f"u{bits // 8}")
    mi.Bitmap(stored).write(str(tmp_path / "a.png"))
    colours = stored[:, :, :3] / top
    np.testing.assert_allclose(read_image(tmp_path / "a.png", raw=True).numpy(), colours, atol=1e-7)
    if channels != 4:  # Mitsuba has no option to drop alpha here
        bitmap = mi.Bitmap(str(tmp_path / "a.png"))
        theirs = np.array(bitmap.convert(component_format=mi.Struct.Type.Float32, srgb_gamma=False))
        np.testing.assert_allclose(read_image(tmp_path / "a.png").numpy(), theirs.reshape(colours.shape), atol=1e-6)


@pytest.mark.parametrize("mode, channels", [("P", 3), ("1", 1), ("L", 1), ("LA", 1), ("RGBA", 3)])
def test_png_of_every_mode(tmp_path, mode, channels):
    Image.new("RGB", (3, 2), (255, 255, 255)).convert(mode).save(tmp_path / "a.png")
    assert torch.equal(read_image(tmp_path / "a.png"), torch.ones(2, 3, channels))


def test_jpeg_is_decoded(tmp_path):
    Image.new("RGB", (8, 8), (128, 128, 128)).save(tmp_path / "a.jpg", quality=95)
    torch.testing.assert_close(read_image(tmp_path / "a.jpg"), torch.full((8, 8, 3), 0.21586), atol=4e-3, rtol=0)


@pytest.mark.parametrize("mode, channels", [("RGB", 3), ("L", 1), ("P", 3), ("RGBA", 3)])
@pytest.mark.parametrize("name", ["a.bmp", "a.tga", "packed.tga"])
def test_bmp_and_tga_are_what_png_is(tmp_path, name, mode, channels):
    colours = Image.fromarray((np.random.default_rng(0).uniform(0, 1, (5, 9, 3)) * 255).astype("u1")).convert(mode)
    colours.save(tmp_path / name, **({"compression": "tga_rle"} if "packed" in name else {}))
    colours.save(tmp_path / "a.png")
    image = read_image(tmp_path / name)
    assert image.shape == (5, 9, channels) and torch.equal(image, read_image(tmp_path / "a.png"))


RGBE = b"#?RADIANCE\nEXPOSURE=1\nFORMAT=32-bit_rle_rgbe\n\n"
ROW = bytes([128, 64, 0, 129]) * 8  # 1, 0.5 and 0 with an exponent of 1
RUNS = b"\x02\x02\x00\x08" + b"\x88\x80" + b"\x05\x40\x40\x40\x40\x40\x83\x40" + b"\x88\x00" + b"\x88\x81"


@pytest.mark.parametrize("content", [RGBE + b"-Y 2 +X 8\n" + 2 * ROW, RGBE + b"-Y 2 +X 8\n" + 2 * RUNS,
                                     RGBE + b"-Y 2 +X 8\n" + RUNS + ROW], ids=["flat", "runs", "both"])
def test_hdr_is_mantissa_times_power_of_two(tmp_path, content):
    (tmp_path / "a.hdr").write_bytes(content)
    assert torch.equal(read_image(tmp_path / "a.hdr"), torch.tensor([1.0, 0.5, 0.0]).expand(2, 8, 3))


@pytest.mark.parametrize("header", [
    RGBE + b"-Y  2  +X  8\n", RGBE + b"-Y 2 +X 8 \n", RGBE + b"\n-Y 2 +X 8\n",
    (RGBE + b"-Y 2 +X 8\n").replace(b"\n", b"\r\n"),
    RGBE + b"VIEW= -vtv -vp 0 -1 0 -vd 0 1 0 -vh 45\n-Y 2 +X 8\n",
    b"#?RGBE\n# by hand, -Y 3 +X 3\nVIEW= -vtv -vh 45\nFORMAT=32-bit_rle_rgbe \nGAMMA=1\n\n-Y 2 +X 8\n",
], ids=["two blanks", "a blank at the end", "two empty lines", "line ends of Windows", "view after the header", "variables"])
@pytest.mark.parametrize("rows", [2 * ROW, 2 * RUNS], ids=["flat", "runs"])
def test_headers_of_hdr_may_be_written_as_people_do(tmp_path, header, rows):
    (tmp_path / "a.hdr").write_bytes(header + rows)
    assert torch.equal(read_image(tmp_path / "a.hdr"), torch.tensor([1.0, 0.5, 0.0]).expand(2, 8, 3))


def test_pfm_begins_with_the_lowest_row(tmp_path):
    (tmp_path / "a.pfm").write_bytes(b"Pf\n2 2\n1.0\n" + np.array([3, 4, 1, 2], ">f4").tobytes())
    assert read_image(tmp_path / "a.pfm")[..., 0].tolist() == [[1, 2], [3, 4]]
    (tmp_path / "b.pfm").write_bytes(b"PF\n1 2\n-1\n" + np.array([4, 5, 6, 1, 2, 300], "<f4").tobytes())
    assert read_image(tmp_path / "b.pfm")[:, 0].tolist() == [[1, 2, 300], [4, 5, 6]]


@pytest.mark.parametrize("name", ["a.hdr", "a.pfm"])
@pytest.mark.parametrize("width", [5, 23])
def test_hdr_and_pfm_of_mitsuba_are_read_as_it_reads_them(mi, tmp_path, name, width):
    pixels = np.random.default_rng(0).gamma(0.5, 2.0, (7, width, 3)).astype("f4")
    pixels[2:4] = 0.25
    mi.Bitmap(pixels).write(str(tmp_path / name))
    assert np.array_equal(read_image(tmp_path / name).numpy(), np.array(mi.Bitmap(str(tmp_path / name))))


@pytest.mark.parametrize("name, content, message", [
    ("a.hdr", RGBE + b"-Y 2 +X 8\n" + RUNS, "cannot be read as HDR: its pixels are cut short in row 1 of 2"),
    ("a.hdr", RGBE + b"-Y 2 +X 8\n" + RUNS + RUNS[:-1], "its pixels are cut short"),
    ("a.hdr", RGBE + b"-Y 1 +X 8\n" + RUNS.replace(b"\x83", b"\x85"), "its content is damaged"),
    ("a.hdr", RGBE + b"+Y 2 +X 8\n" + 2 * ROW, r"its size must read -Y height \+X width, got b'\+Y 2 \+X 8'"),
    ("a.hdr", RGBE.replace(b"rgbe", b"xyze") + b"-Y 2 +X 8\n", "its format must be 32-bit_rle_rgbe, got b'32-bit_rle_xyze'"),
    ("a.hdr", RGBE + b"-Y 200000000 +X 200000000\n", "an image may have 1 to"),
    ("a.hdr", b"PF\n1 1\n-1\n" + bytes(12), "the file begins as PFM does; change its extension"),
    ("a.pfm", b"PF\n2 2\n-1\n" + bytes(12), "its pixels take 48 bytes, it has 12"),
    ("a.pfm", b"PF\n2 x\n-1\n" + bytes(12), "its header must read PF or Pf, width, height and scale"),
    ("a.pfm", b"PF\n200000000 200000000\n-1\n", "an image may have 1 to"),
    ("a.bmp", b"BM" + bytes(20), "cannot be read as BMP"),
    ("a.tga", b"\x00" * 10, "cannot be read as TGA"),
])
def test_damaged_files_of_other_kinds_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=rf"a\.{name[2:]}.*{message}"):
        read_image(tmp_path / name)


@pytest.mark.parametrize("name", ["a.bmp", "a.tga"])
def test_bmp_and_tga_that_are_cut_short_are_refused(tmp_path, name):
    Image.fromarray((np.random.default_rng(0).uniform(0, 1, (5, 9, 3)) * 255).astype("u1")).save(tmp_path / name)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[:100])
    with pytest.raises(ValueError, match=f"{name}: cannot be read as {name[2:].upper()}"):
        read_image(tmp_path / name)


def test_srgb_follows_its_definition():
    torch.testing.assert_close(srgb_to_linear(torch.tensor([0.0, 0.04045, 0.5, 1.0])),
                               torch.tensor([0.0, 0.0031308, 0.21404114, 1.0]), atol=1e-7, rtol=1e-6)
    values = torch.linspace(0, 1, 1001, dtype=torch.float64)
    torch.testing.assert_close(srgb_to_linear(linear_to_srgb(values)), values, atol=1e-7, rtol=0)


def test_encoding_srgb_has_finite_derivatives_everywhere():
    values = torch.tensor([-1.0, 0.0, 0.001, 0.5, 2.0], requires_grad=True)
    linear_to_srgb(values).sum().backward()
    assert torch.isfinite(values.grad).all() and (values.grad > 0).all()


def test_written_images_are_read_back(tmp_path, pixels):
    image = torch.from_numpy(pixels).permute(2, 0, 1)
    save_image(tmp_path / "a.exr", image.double())
    assert torch.equal(read_image(tmp_path / "a.exr"), image.permute(1, 2, 0))
    save_image(tmp_path / "a.png", image)
    encoded = np.asarray(Image.open(tmp_path / "a.png"))
    expected = (linear_to_srgb(image.clamp(0, 1)) * 255).round().permute(1, 2, 0)
    np.testing.assert_array_equal(encoded, expected.numpy())


def test_a_mask_is_read_back_as_the_mask_of_a_photograph(tmp_path):
    mask = torch.linspace(0, 1, 12).view(1, 3, 4)
    save_image(tmp_path / "soft.png", mask, curve="linear")
    save_image(tmp_path / "hard.png", mask > 0.5)
    camera = rb.camera_from_opencv(torch.eye(3), torch.eye(3), torch.zeros(3), 4, 3)
    soft, hard = (rb.Photographs([torch.zeros(3, 3, 4)], [camera], [tmp_path / name])[0].mask
                  for name in ("soft.png", "hard.png"))
    torch.testing.assert_close(soft, mask, rtol=0, atol=0.5 / 255)
    assert torch.equal(hard, (mask > 0.5).float())


def test_depths_are_whole_numbers_of_a_unit(tmp_path):
    depth = torch.tensor([[[0.0, 0.0014, 1.2345], [30.0, 65.535, 80.0]]])
    save_image(tmp_path / "depth.png", depth, curve="linear", white=65.535, bits=16)
    stored = np.asarray(Image.open(tmp_path / "depth.png"))
    assert stored.tolist() == [[0, 1, 1234], [30000, 65535, 65535]]
    torch.testing.assert_close(read_image(tmp_path / "depth.png", raw=True)[..., 0] * 65.535, depth[0].clamp_max(65.535),
                               rtol=0, atol=0.00051)
    save_image(tmp_path / "shown.png", depth, white=80)
    levels = np.asarray(Image.open(tmp_path / "shown.png"))
    assert levels[1, 2] == 255 and abs(int(levels[1, 0]) - float(linear_to_srgb(torch.tensor(30 / 80))) * 255) <= 0.5


@pytest.mark.hostile
@pytest.mark.parametrize("name, image, settings, message", [
    ("a.png", torch.zeros(3, 2, 2), {"bits": 16}, r"16 bits is written of one channel, \(1, H, W\), got \(3, 2, 2\)"),
    ("a.png", torch.zeros(1, 2, 2), {"bits": 12}, "bits must be 8 or 16 and white greater than 0, got 12 and 1.0"),
    ("a.png", torch.zeros(1, 2, 2), {"white": 0.0}, "bits must be 8 or 16 and white greater than 0"),
    ("a.png", torch.zeros(1, 2, 2), {"curve": 2.2}, "curve must be srgb or linear, got 2.2"),
    ("a.exr", torch.zeros(1, 2, 2), {"white": 10.0}, "an .exr has the values as they are: leave bits and white out"),
])
def test_settings_that_do_not_fit_are_named(tmp_path, name, image, settings, message):
    with pytest.raises(ValueError, match=f"{name}: .*{message}"):
        save_image(tmp_path / name, image, **settings)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("extension", ["exr", "png"])
def test_an_image_that_is_not_finite_leaves_the_old_file_alone(tmp_path, extension):
    path = tmp_path / f"a.{extension}"
    save_image(path, torch.zeros(3, 2, 2))
    before = path.read_bytes()
    broken = torch.zeros(3, 2, 2)
    broken[1, 0, 0], broken[2, 1, 1] = torch.nan, torch.inf
    with pytest.raises(ValueError, match=rf"a\.{extension}: not written, 2 of 4 pixels are NaN or infinite"):
        save_image(path, broken)
    assert path.read_bytes() == before and [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("name, image, error, message", [
    ("a.tga", torch.zeros(3, 2, 2), ValueError, r"unknown kind of image '\.tga'; supported: \.exr, \.png"),
    ("a.png", torch.zeros(2, 2, 3), ValueError, r"\(3, H, W\), got \(2, 2, 3\); move the channels .*movedim\(-1, 0\)"),
    ("a.png", torch.zeros(1, 3, 2, 2), ValueError, r"got \(1, 3, 2, 2\), a batch of 1; pick one, image\[0\]"),
    ("a.exr", torch.zeros(5, 3, 2, 2), ValueError, r"got \(5, 3, 2, 2\), a batch of 5; pick one, image\[0\]"),
    ("a.exr", torch.full((3, 2, 2), 1e300, dtype=torch.float64), ValueError, "4 of 4 pixels are NaN or infinite in float32"),
    ("a.exr", torch.zeros(2, 2), ValueError, r"must have shape \(3, H, W\), got \(2, 2\)"),
    ("a.exr", torch.zeros(3, 0, 2), ValueError, r"must have shape \(3, H, W\), got \(3, 0, 2\)"),
    ("a.exr", np.zeros((3, 2, 2)), TypeError, "must be a tensor of floating point numbers, got ndarray"),
    ("a.exr", torch.zeros(3, 2, 2, dtype=torch.uint8), TypeError, "floating point numbers, got torch.uint8"),
    ("a.exr", torch.zeros(3, 2, 2, dtype=torch.complex64), TypeError, "floating point numbers, got torch.complex64"),
    ("no/a.png", torch.zeros(3, 2, 2), FileNotFoundError, "folder .* does not exist"),
])
def test_what_cannot_be_written_is_named(tmp_path, name, image, error, message):
    with pytest.raises(error, match=f"{name}: .*{message}"):
        rb.save_image(tmp_path / name, image)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name, content, error, message", [
    ("a.gif", b"", ValueError, r"supported: \.exr, \.png, \.jpg, \.jpeg, \.bmp, \.tga, \.hdr, \.pfm"),
    ("a.exr", b"not an image", ValueError, r"a\.exr: cannot be read as EXR"),
    ("a.png", b"\x89PNG\r\n\x1a\n", ValueError, r"a\.png: cannot be read as PNG"),
    ("a.jpg", b"", ValueError, r"a\.jpg: cannot be read as JPEG: the file is empty"),
    ("a.png", None, FileNotFoundError, r"a\.png: file not found"),
])
def test_what_cannot_be_read_is_named(tmp_path, name, content, error, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(error, match=message):
        read_image(tmp_path / name)


def test_a_truncated_png_is_named(tmp_path, pixels):
    save_image(tmp_path / "whole.png", torch.rand(3, 64, 64))
    (tmp_path / "half.png").write_bytes((tmp_path / "whole.png").read_bytes()[:5000])
    with pytest.raises(ValueError, match=r"half\.png: cannot be read as PNG: Truncated"):
        read_image(tmp_path / "half.png")


def cut(data, length):
    return data[:length]


def flipped(data, position):
    return data[:position] + bytes([data[position] ^ 0xFF]) + data[position + 1:]


@pytest.mark.parametrize("name, damage, message", [
    ("a.exr", lambda data: cut(data, 0), "the file is empty"),
    ("a.exr", lambda data: cut(data, 3), "the file begins with"),
    ("a.exr", lambda data: cut(data, 100), "."),
    ("a.exr", lambda data: cut(data, 400), "its pixels are damaged or cut short"),
    ("a.exr", lambda data: cut(data, len(data) - 1), "its pixels are damaged or cut short"),
    ("a.exr", lambda data: data.replace(b"dataWindow\0box2i\0\x10\0\0\0" + bytes(8), b"dataWindow\0box2i\0\x10\0\0\0"
                                        + bytes(4) + b"\0\0\0\x80"), "."),
    ("a.exr", lambda data: data.replace((63).to_bytes(4, "little") * 2, (99999).to_bytes(4, "little") * 2),
     "an image may have 1 to 134217728 pixels, this one has 100000 x 100000"),
    ("a.png", lambda data: cut(data, 0), "the file is empty"),
    ("a.png", lambda data: cut(data, 20), "."),
    ("a.png", lambda data: cut(data, len(data) // 2), "."),
    ("a.png", lambda data: flipped(data, len(data) // 2), "broken PNG file"),
    ("a.png", lambda data: flipped(data, 20), "."),
    ("a.png", lambda data: b"\x76\x2f\x31\x01" + data, "the file begins as EXR does; change its extension"),
    ("a.exr", lambda data: b"\x89PNG\r\n\x1a\n" + data, "the file begins as PNG does; change its extension"),
    ("a.jpg", lambda data: b"\x89PNG\r\n\x1a\n" + data, "the file begins as PNG does"),
    ("a.jpg", lambda data: b"\xff\xd8\xff" + data, "cannot identify image file"),
    ("a.png", lambda data: b"<html>404</html>", "the file begins with b'<html>40'"),
])
def test_damaged_images_are_refused_in_one_line(tmp_path, name, damage, message):
    source = name if name.endswith((".exr", ".png")) else "a.png"
    save_image(tmp_path / source, torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0)))
    (tmp_path / name).write_bytes(damage((tmp_path / source).read_bytes()))
    with pytest.raises(ValueError, match=rf"{name}: cannot be read as .*{message}") as caught:
        read_image(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_folder_is_not_an_image(tmp_path):
    (tmp_path / "a.png").mkdir()
    with pytest.raises(IsADirectoryError, match=r"a\.png: is a folder, not a file"):
        read_image(tmp_path / "a.png")


def png(width, height, rows, bits=8, colour=2, interlace=0):
    """A PNG file with right check sums whose pixels are `rows`, whatever its header says."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlace)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


@pytest.mark.parametrize("content, message", [
    (png(4, 4, bytes(13 * 3)), "its pixels take 52 bytes, it has 39"),
    (png(4, 4, b""), "its pixels take 52 bytes, it has 0"),
    (png(64, 851968, bytes(193)), "its pixels take 164429824 bytes, it has 193"),
    (png(20000, 20000, b""), "."),
    (png(0, 4, b""), "."),
    (png(4, 4, bytes(52)).replace(zlib.compress(bytes(52)), bytes(len(zlib.compress(bytes(52))))), "broken PNG file"),
])
def test_png_files_with_fewer_pixels_than_they_say_are_refused(tmp_path, content, message):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ValueError, match=rf"a\.png: cannot be read as PNG: .*{message}"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "LA", "P", "1", "I;16"])
@pytest.mark.parametrize("size", [(1, 1), (3, 2), (9, 17), (64, 5)])
def test_png_files_that_are_complete_are_read(tmp_path, mode, size):
    Image.new("RGB", size, (90, 90, 90)).convert("L" if mode == "I;16" else mode).convert(mode).save(tmp_path / "a.png")
    assert read_image(tmp_path / "a.png").shape[:2] == size[::-1]


@pytest.mark.parametrize("rest", [
    b"\0\0\0\0", b"\xff\0\0\0\0IEN", b"\xff\0\0\0IDAT", png(64, 64, b"")[8:], b"hello " * 9,
], ids=["zeros", "a chunk of 4 GB", "pixels of 4 GB", "another header", "text"])
def test_what_follows_the_end_of_a_png_file_is_left_alone(tmp_path, rest):
    (tmp_path / "a.png").write_bytes(png(4, 4, bytes(52)) + rest)
    tracemalloc.start()
    try:
        assert read_image(tmp_path / "a.png").shape == (4, 4, 3)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


def test_interlaced_png_files_are_read(tmp_path):
    passes = ((2, 1), (1, 1), (3, 1), (2, 2), (5, 1), (4, 3), (9, 2))  # columns and rows of 9 x 5 pixels
    rows = b"".join(bytes(rows * (1 + 3 * columns)) for columns, rows in passes)
    (tmp_path / "a.png").write_bytes(png(9, 5, rows, interlace=1))
    assert read_image(tmp_path / "a.png").shape == (5, 9, 3)
    (tmp_path / "a.png").write_bytes(png(9, 5, rows[:-1], interlace=1))
    with pytest.raises(ValueError, match="a.png: cannot be read as PNG: its pixels take 146 bytes, it has 145"):
        read_image(tmp_path / "a.png")
