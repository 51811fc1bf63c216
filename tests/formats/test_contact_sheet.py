"""Images of several views beside each other: where they lie, at which size, and with which labels."""

import pytest
import torch

import torch_radbp as rb
from torch_radbp.formats.contact_sheet import GAP, LETTERS, SMALLEST
from torch_radbp.formats.image import read_image


def images(count, height=40, width=100, channels=3):
    return torch.rand(count, channels, height, width, generator=torch.Generator().manual_seed(count))


def at(sheet, row, column, image, left, top):
    """The part of a sheet where an image of a grid should be."""
    height, width = image.shape[-2:]
    y, x = top + row * (height + GAP), left + column * (width + GAP)
    return sheet[:, y:y + height, x:x + width]


def test_images_lie_in_rows_and_columns_and_keep_their_values():
    rows = {"": images(3), " ": images(3) ** 2}
    sheet = rb.contact_sheet({"": rows[""]})
    assert sheet.shape == (3, 2 * GAP + 40, GAP + 3 * (100 + GAP)) and sheet.dtype == torch.float32
    for column in range(3):
        # 8 bits of sRGB.
        torch.testing.assert_close(at(sheet, 0, column, rows[""][0], GAP, GAP), rows[""][column], rtol=0, atol=0.006)
    assert (sheet[:, :GAP] == 1).all() and (sheet[:, :, :GAP] == 1).all()


def test_labels_of_rows_are_left_of_them_and_those_of_views_above():
    sheet = rb.contact_sheet({"before": images(2), "after": images(2)}, views=["left", "right"])
    left, top = sheet.shape[2] - 2 * (100 + GAP), LETTERS + 2 * GAP
    assert sheet.shape[1] == top + 2 * (40 + GAP) and left > 30
    torch.testing.assert_close(at(sheet, 1, 1, images(2)[0], left, top), images(2)[1], rtol=0, atol=0.006)
    ink = sheet.amin(0) < 0.5
    for part in (ink[:top, left:left + 100], ink[:top, left + 106:], ink[top:top + 40, :left], ink[top + 46:, :left]):
        assert part.any(), "a label"
    assert not ink[:top, :left].any()


def test_small_images_are_enlarged_and_grey_ones_are_grey():
    mask = (images(1, 8, 10, 1) > 0.5).float()
    sheet = rb.contact_sheet({"": mask})
    zoom = -(-SMALLEST // 10)
    found = sheet[:, GAP:GAP + 8 * zoom, GAP:GAP + 10 * zoom]
    assert torch.equal(found, mask[0].expand(3, -1, -1).repeat_interleave(zoom, 1).repeat_interleave(zoom, 2))


def test_lists_have_images_of_several_sizes_and_rows_several_lengths():
    sheet = rb.contact_sheet({"": [images(1)[0], images(1, 100, 40)[0]], " ": images(1)})
    assert sheet.shape[2] >= GAP + 2 * (100 + GAP)
    assert (sheet[:, -40 - GAP:, -100 - GAP:] == 1).all(), "nothing in the second column of the second row"


def test_a_sheet_is_written_as_it_is(tmp_path):
    sheet = rb.contact_sheet({"target": images(2)}, views=["a name that is much too long to stand above its image", "b"])
    rb.save_image(tmp_path / "sheet.png", sheet)
    torch.testing.assert_close(read_image(tmp_path / "sheet.png").movedim(-1, 0), sheet, rtol=0, atol=1e-6)


@pytest.mark.hostile
@pytest.mark.parametrize("rows, views, error, message", [
    ({}, (), ValueError, "a contact sheet needs images"), ({"a": []}, (), ValueError, "a contact sheet needs images"),
    ({"a": images(2)}, ["one"], ValueError, "views must be a label for each of 2 columns, got 1"),
    ({"a": images(2)[0]}, (), ValueError, r"rows\['a'\]\[0\] must have shape .* got \(40, 100\); rows are \(B, 3, H, W\)"),
    ({"a": images(2).byte()}, (), TypeError, r"must be a tensor of floating point numbers, got torch.uint8"),
    ({"a": images(2) / 0}, (), ValueError, "has values that are NaN or infinite"),
])
def test_what_is_no_sheet_is_said(rows, views, error, message):
    with pytest.raises(error, match=message):
        rb.contact_sheet(rows, views)
