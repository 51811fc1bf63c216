"""What tests of every part use."""

import pytest


@pytest.fixture
def mi():
    """Mitsuba in its variant `scalar_rgb`; without it the test is skipped."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba
