"""The comparison itself: it accepts what agrees and finds small errors, before any renderer is judged by it."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

from tests.plugin.plugin_table import beyond_mitsuba
from tests.scenes.xml import media
from tests.scenes.xml.cases import CASES
from tests.scenes.xml.files import Folder
from torch_radbp.plugin import REGISTRY

from .agreement import ALPHA, compare, estimate
from .mitsuba_images import load_case

SHAPE, SPP, BATCHES = (24, 32, 3), 64, 16


def noisy_renders(seed: int, mean: np.ndarray, batches: int = BATCHES) -> list[np.ndarray]:
    """Renders with the skewed noise of path tracing: means of SPP exponential samples of coefficient of variation 1.5."""
    shape = SPP / 1.5**2
    generator = np.random.default_rng(seed)
    return [mean * generator.gamma(shape, 1 / shape, mean.shape) for _ in range(batches)]


def ramp() -> np.ndarray:
    y, x, channel = np.mgrid[: SHAPE[0], : SHAPE[1], : SHAPE[2]]
    return 0.2 + 0.02 * x + 0.01 * y + 0.1 * channel


def p_of(ours: list[np.ndarray], theirs: list[np.ndarray]) -> float:
    return compare(estimate(ours, SPP), estimate(theirs, SPP)).p


def test_equal_means_are_rarely_rejected():
    """Of 200 pairs with skewed noise 5% at most have p < 0.05, up to four standard deviations of that count."""
    p = np.array([p_of(noisy_renders(2 * k, ramp()), noisy_renders(2 * k + 1, ramp())) for k in range(200)])
    assert (p < 0.05).sum() < 10 + 4 * np.sqrt(10)
    assert p.min() > ALPHA


@pytest.mark.parametrize("change", [
    lambda image: 0.98 * image,  # 2% too dark
    lambda image: image[::-1],  # upside down
    lambda image: image[:, :, ::-1],  # blue for red
    lambda image: np.roll(image, 1, axis=1),  # a pixel aside
    lambda image: np.where(np.indices(SHAPE)[0] == 5, 1.4 * image, image),  # one bright row
    lambda image: np.where((np.indices(SHAPE)[0] == 5) & (np.indices(SHAPE)[1] == 7), 2 * image, image),  # one pixel
], ids=["darker", "flipped", "channels", "shifted", "row", "pixel"])
def test_a_wrong_image_is_rejected(change):
    assert p_of(noisy_renders(1, np.ascontiguousarray(change(ramp()))), noisy_renders(2, ramp())) < ALPHA


def test_noise_of_the_wrong_size_is_noticed():
    """Renders that are not independent look more certain than they are; the uniformity of p-values tells."""
    same = noisy_renders(3, ramp(), batches=2)
    result = compare(estimate(same * 8, SPP), estimate(noisy_renders(4, ramp()), SPP))
    assert result.uniform_p < ALPHA


def test_values_without_noise_need_not_be_equal_to_the_last_bit():
    flat = [np.full(SHAPE, 0.2)] * BATCHES
    assert p_of(flat, [image * (1 + 5e-6) for image in flat]) > ALPHA
    assert p_of(flat, [image * 1.001 for image in flat]) < ALPHA


def test_images_of_different_shape_are_refused():
    with pytest.raises(ValueError, match="one shape"):
        compare(estimate(noisy_renders(1, ramp()), SPP), estimate(noisy_renders(2, ramp()[:20]), SPP))


def test_values_that_are_not_finite_are_refused():
    broken = noisy_renders(1, ramp())
    broken[0][3, 4, 0] = np.nan
    with pytest.raises(ValueError, match="1 of"):
        estimate(broken, SPP)


@pytest.mark.parametrize("name", ["cornell_depth_8", "bitmaps", "shapes"])
def test_mitsuba_agrees_with_itself_and_not_with_a_darker_self(name, tmp_path):
    """New seeds of Mitsuba against the stored ones: the whole chain, on an image that is right by definition."""
    pytest.importorskip("mitsuba")
    from .mitsuba_images import render

    case, path, theirs = load_case(name, tmp_path)
    images = render(path, case, case.peer_spp, 16, first_seed=5000)
    assert compare(estimate(images, case.peer_spp), theirs).p > ALPHA
    assert compare(estimate([0.98 * image for image in images], case.peer_spp), theirs).p < ALPHA
    assert compare(estimate([image[:, ::-1] for image in images], case.peer_spp), theirs).p < ALPHA


COMPARED = ("shape", "bsdf", "texture", "emitter", "sensor", "film", "rfilter")
# Not Mitsuba's, of several images, spectra that Mitsuba's RGB modes do not evaluate, and what occurs in scenes with media.
WITHOUT = (*beyond_mitsuba(), "batch", "blackbody", "regular", "irregular", "volume")


def test_the_cases_use_every_supported_plugin(tmp_path):
    """Every registered plugin, but `WITHOUT`, occurs in at least one case, and so do these attributes."""
    text = []
    for k, name in enumerate(CASES):
        (tmp_path / str(k)).mkdir()
        text.append(load_case(name, tmp_path / str(k))[1].read_text())
    text = " ".join(text)
    types = ["path", "independent", *(name for category in COMPARED for name in REGISTRY[category] if name not in WITHOUT)]
    assert [each for each in types if f'type="{each}"' not in text] == []
    words = ["<rgb ", 'name="raw"', "repeat", "mirror", "clamp", "nearest", ".png", ".jpg", ".exr", "to_uv",
             "flip_normals", "face_normals", "hide_emitters", "max_depth", "rr_depth", "focal_length", "near_clip",
             "far_clip", "crop_offset_x", "principal_point_offset_x", "sample_border", "<ref ", "<default ", "<lookat ",
             "<matrix ", "<rotate ", "<scale ", "<translate ", *(f'name="{attribute}"' for attribute in (
                 "material", "eta", "k", "int_ior", "ext_ior", "specular_reflectance", "specular_transmittance",
                 "distribution", "nonlinear", "weight", "opacity", "use_shadowing_function", "alpha", "alpha_u", "alpha_v",
                 "mis_compensation", "cutoff_angle", "irradiance"))]
    assert [each for each in words if each not in text] == []
    axes = ["x", "y", "diagonal", "smaller", "larger"]
    assert [each for each in axes if f'name="fov_axis" value="{each}"' not in text] == []


def test_the_scenes_with_media_combine_every_plugin_with_every_other(tmp_path):
    """All pairs of their pieces occur, but lamps in glass, which connections do not reach; and every registered plugin."""
    rows = media.rows()
    assert len(rows) >= 60 and len(set(rows)) == len(rows)
    pieces = (media.MEDIA, media.PHASES, media.BOUNDARIES, media.CAMERAS, media.LIGHTS, media.DEPTHS)
    absent = {pair for i, j in combinations(range(6), 2) for pair in
              set(product(pieces[i], pieces[j])) - {(row[i], row[j]) for row in rows}}
    assert absent == {*product(("dielectric", "roughdielectric"), ("lamp", "bulb"))}
    text = " ".join(media.case_of(row).build(Folder(tmp_path)).read_text() for row in rows)
    types = [name for category in ("medium", "phase", "volume") for name in REGISTRY[category]]
    assert [each for each in types if f'type="{each}"' not in text] == ["constvolume"]  # which rgb is read as
