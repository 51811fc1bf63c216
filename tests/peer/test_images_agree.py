"""Our images against Mitsuba 3.9.1's, pixel by pixel, on scenes that use every supported plugin.

The references are stored (`mitsuba_images`), so that these tests need no Mitsuba; one of them renders with it if it is
installed. Both sides estimate their own noise from independent renders; the level of the test is `agreement.ALPHA`.
"""

from __future__ import annotations

import numpy as np
import pytest

import torch_radbp as rb
from tests.deep import deep_but_every
from tests.scenes.xml.cases import CASES
from tests.scenes.xml.files import Case
from tests.scenes.xml.gltf import load_asset

from .agreement import ALPHA, Comparison, compare, estimate
from .mitsuba_images import load_case
from .mitsuba_images import render as mitsuba_renders

BATCHES = 16


def our_renders(scene: rb.Scene, case: Case, first_seed: int = 16, **settings) -> list[np.ndarray]:
    """Independent (H, W, 3) renders of a scene by this renderer."""
    renderer = rb.Renderer(scene, spp=case.spp, **settings)
    return [renderer(seed=first_seed + batch)[0].permute(1, 2, 0).numpy() for batch in range(BATCHES)]


def against_reference(name: str, tmp_path, **settings) -> Comparison:
    case, path, theirs = load_case(name, tmp_path)
    ours = estimate(our_renders(rb.load(path, **case.variables), case, **settings), case.spp)
    return compare(ours, theirs, case.thin)


def assert_agrees(comparison: Comparison) -> None:
    """Fails with the figures of the comparison, also if its noise is too great for it to mean anything."""
    assert comparison.p > ALPHA, str(comparison)
    assert comparison.bias_error.max() < 0.006, f"too noisy to find an error of 2%: {comparison}"


@pytest.mark.parametrize("name", deep_but_every(7, CASES))
def test_image_agrees_with_mitsuba(name, tmp_path):
    assert_agrees(against_reference(name, tmp_path))


def test_a_gltf_asset_agrees_with_mitsuba(tmp_path):
    """The asset itself; "gltf" among the cases is the XML that is written of it."""
    case, path, theirs = load_case("gltf", tmp_path)
    ours = estimate(our_renders(load_asset(path.with_name("asset.glb")), case), case.spp)
    assert_agrees(compare(ours, theirs, case.thin))


@pytest.mark.parametrize("name", ["sky", "cornell_depth_3"])
def test_bsdf_sampling_alone_agrees_with_mitsuba(name, tmp_path):
    """Without next-event estimation, light is found by chance: hits of a small lamp are too rare for a normal law in a
    pixel, so pixels are judged where the sky is the light, and blocks and the whole image in the Cornell box."""
    case, path, theirs = load_case(name, tmp_path)
    case = case._replace(spp=2 * case.spp)
    ours = estimate(our_renders(rb.load(path, **case.variables), case, nee=False), case.spp)
    comparison = compare(ours, theirs, case.thin)
    if name == "sky":
        assert_agrees(comparison)
    else:
        assert min(comparison.worst_p["blocks"], comparison.worst_p["whole"]) > ALPHA, str(comparison)
        assert comparison.bias_error.max() < 0.02, str(comparison)


def test_bsdf_sampling_and_next_event_estimation_agree_with_each_other(tmp_path):
    """The two halves of multiple importance sampling estimate one integral; seeds differ, so the renders are independent."""
    case, path, _ = load_case("sky", tmp_path)
    scene = rb.load(path)
    with_nee, without = (estimate(our_renders(scene, case, first_seed=seed, nee=nee), case.spp)
                         for seed, nee in ((100, True), (200, False)))
    assert_agrees(compare(with_nee, without))


def cornell_dict(to_matrix=lambda matrix: matrix) -> dict:
    """A part of the Cornell box as a dict; transforms are 4 x 4 arrays for us, made into Mitsuba's by `to_matrix`."""
    def turned(axis: str, degrees: float, x: float = 0, y: float = 0, z: float = 0, scale=(1, 1, 1)):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        rotation = {"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]]}[axis]
        matrix = np.eye(4)
        matrix[:3, :3] = np.asarray(rotation) * np.asarray(scale)
        matrix[:3, 3] = x, y, z
        return to_matrix(matrix)

    return {
        "type": "scene", "integrator": {"type": "path", "max_depth": 3},
        "sensor": {"type": "perspective", "fov": 39.3, "to_world": turned("y", 180, z=3.9),
                   "sampler": {"type": "independent", "sample_count": 16},
                   "film": {"type": "hdrfilm", "width": 24, "height": 24, "pixel_format": "rgb",
                            "rfilter": {"type": "box"}}},
        "white": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.88, 0.7, 0.67]}},
        "back": {"type": "rectangle", "to_world": turned("y", 0, z=-1), "bsdf": {"type": "ref", "id": "white"}},
        "floor": {"type": "rectangle", "to_world": turned("x", -90, y=-1), "bsdf": {"type": "ref", "id": "white"}},
        "red-wall": {"type": "rectangle", "to_world": turned("y", 90, x=-1),
                     "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.57, 0.04, 0.04]}}},
        "box": {"type": "cube", "to_world": turned("y", 20, x=0.2, y=-0.6, scale=(0.3, 0.4, 0.3)),
                "bsdf": {"type": "ref", "id": "white"}},
        "light": {"type": "rectangle", "to_world": turned("x", 90, y=0.9, scale=(0.4, 0.4, 1)),
                  "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [6.0, 5.0, 3.0]}}},
    }


def test_a_dict_rendered_by_mitsuba_now_agrees(mi):
    """Live, with Mitsuba's own reading of the same dict."""
    theirs = mi.load_dict(cornell_dict(mi.ScalarTransform4f))
    peer = [np.array(mi.render(theirs, spp=64, seed=seed)) for seed in range(32)]
    case = Case(None)
    ours = our_renders(rb.load_dict(cornell_dict()), case)
    assert_agrees(compare(estimate(ours, case.spp), estimate(peer, 64)))


def test_an_xml_scene_rendered_by_mitsuba_now_agrees(tmp_path):
    """Live, on another seed than the stored reference."""
    pytest.importorskip("mitsuba")
    case, path, _ = load_case("cornell_depth_3", tmp_path)
    peer = estimate(mitsuba_renders(path, case, 64, 32, first_seed=9000), 64)
    ours = estimate(our_renders(rb.load(path, **case.variables), case, first_seed=500), case.spp)
    assert_agrees(compare(ours, peer))
