"""The times of recipes are written into the rows of their table, and the gallery shows each."""

import re

import pytest

from benchmarks.recipe_times import PICTURES, ROOT, TABLE, with_seconds
from torch_radbp.training.commands.bundled import bundled_recipes


def test_every_recipe_has_a_row_whose_last_cell_alone_is_rewritten():
    before = TABLE.read_text(encoding="utf-8")
    after = with_seconds(before, dict.fromkeys(bundled_recipes(), 4.24))
    assert after.count("| 4.2 |\n") == len(bundled_recipes())
    for old, new in zip(before.splitlines(), after.splitlines(), strict=True):
        assert old == new or re.sub(r"\| [^|]* \|$", "", old) == re.sub(r"\| 4\.2 \|$", "", new)


def test_a_recipe_without_a_row_is_refused():
    with pytest.raises(ValueError, match="other.toml must have one row, found 0"):
        with_seconds(TABLE.read_text(encoding="utf-8"), {"other": 1.0})


def test_every_recipe_has_a_small_picture_in_the_gallery():
    gallery = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for name in bundled_recipes():
        picture = PICTURES / f"{name}.webp"
        assert f"(../{picture.relative_to(ROOT).as_posix()})\n\n**`{name}`**: " in gallery
        assert picture.stat().st_size < 100_000
