"""Tests of the compiler compile: nothing comes from disk unless a test says so."""

import pytest


@pytest.fixture(autouse=True)
def nothing_kept(monkeypatch):
    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off")
