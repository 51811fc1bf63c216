"""What is wider than a screen, or than its box of code, is found in Chromium."""

import pytest

from docs.widths import CHROMIUM, too_wide

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: widths of pages are not looked at")
CODE = '<pre style="overflow: auto; width: 50px">a long line</pre>'
PAGE = '<!doctype html><meta name="viewport" content="width=device-width"><body style="margin: 0"><main>{}</main>'


def test_what_does_not_fit_is_told_with_its_page_and_what_fits_is_not(tmp_path):
    pages = {"fits.html": "<p>few words</p>", "wide.html": '<p style="width: 500px">wide</p>',
             "hidden.html": '<div style="overflow: hidden"><p style="width: 500px">cut off</p></div>',
             "scrolls.html": '<div style="overflow: auto"><p style="width: 5000px">a box that scrolls</p></div>',
             "tutorials/code.html": CODE, "plugins/code.html": CODE}
    for folder in ("tutorials", "plugins"):
        (tmp_path / folder).mkdir()
    for name, body in pages.items():
        (tmp_path / name).write_text(PAGE.format(body))
    found = too_wide(tmp_path, list(pages))
    assert [each.partition(",")[0] for each in found] == [
        "/wide.html at 390 pixels: wider than the screen", "/hidden.html at 390 pixels: wider than the screen",
        "/tutorials/code.html at 1280 pixels: code is wider than its box: a long line"]
    assert "cut off" in found[1]
