"""What tests of every part use."""

import pytest


@pytest.fixture
def mi():
    """Mitsuba in its variant `scalar_rgb`; without it the test is skipped."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest starts first, so that workers end together."""
    items.sort(key=lambda item: "test_compile" not in item.nodeid)
