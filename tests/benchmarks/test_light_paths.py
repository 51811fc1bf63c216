"""The rows of `benchmarks.light_paths`: nothing is left out, and a wrong image is called wrong."""

import numpy as np

from benchmarks.light_paths import BATCHES, CAMERAS, LIGHTS, MATERIALS, SIZE, Row, compared, described, rows
from tests.scenes.description import load
from torch_radbp.plugin import REGISTRY


def test_every_lamp_material_and_camera_has_a_row():
    for field, pieces in {"lamp": LIGHTS, "material": MATERIALS, "camera": CAMERAS}.items():
        assert set(pieces) == {getattr(row, field) for row in rows()}, field
    used = {part["type"] for lamp in LIGHTS.values() for part in (lamp, lamp.get("emitter", lamp))}
    assert set(REGISTRY["emitter"]) - {"attributes"} <= used


def test_rows_differ_and_are_as_many_as_promised():
    assert len(rows()) == len(set(rows())) >= 60


def test_every_scene_can_be_loaded():
    for row in rows():
        load(**{name: part for name, part in described(row).items() if name != "type"})


def test_paths_from_the_camera_judge_where_they_find_all_light():
    assert Row("point", "diffuse", "thinlens").found_from_the_camera
    assert Row("area", "glass", "thinlens").found_from_the_camera
    assert not Row("point", "glass", "thinlens").found_from_the_camera


def batches(mean: float, seed: int) -> list[np.ndarray]:
    return list(np.random.default_rng(seed).normal(mean, 0.1, (BATCHES, SIZE, SIZE, 3)))


def test_images_are_called_equal_only_if_they_are():
    assert compared(batches(1.0, 0), batches(1.0, 1))[1]
    assert not compared(batches(1.0, 0), batches(1.02, 1))[1]


def test_a_block_that_differs_is_found_in_images_of_equal_means():
    other = batches(1.0, 1)
    for image in other:
        image[:4, :4] += 0.5
        image[8:, 8:] -= 0.125
    assert not compared(batches(1.0, 0), other)[1]
