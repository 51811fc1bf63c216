"""Docstrings become the lists of the reference."""

import pytest

pytest.importorskip("griffe", reason="the packages of the documentation are not installed")


def test_what_is_returned_is_one_entry_however_many_lines_it_has():
    from docs.docstring import markdown

    text = markdown("Renders.\n\nReturns:\n    Images; if quantities are asked for, these, too,\n    in a dict.\n")
    assert text.endswith("**Returns**\n\n- Images; if quantities are asked for, these, too,\n  in a dict.")
