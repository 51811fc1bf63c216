"""Scenes that come with the package, by name."""

import pytest

import torch_radbp as rb


def test_a_scene_of_the_package_is_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert rb.load(rb.asset("cornell_box/scene.xml"), resolution=8).get_parameter("green.reflectance.value").shape == (3,)


@pytest.mark.parametrize("name", ["cornel_box/scene.xml", "cornell_box", "../setup.py/none"])
def test_a_wrong_name_is_an_error_that_lists_the_scenes(name):
    with pytest.raises(FileNotFoundError, match="known: .*cornell_box/scene.xml.*pot/pot.glb"):
        rb.asset(name)
