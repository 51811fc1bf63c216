"""Light found by next-event estimation, by BSDF sampling, and by both with weights: one integral, three estimates.

Reference: Veach 1997, section 9.2. Images that look alike can hide a quarter of the light, hence each piece on its own.
"""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.emitter.lanes import cast, detached, light_numbers, mean_and_error, on_the_floor, uniform
from tests.scenes import load, sensor
from tests.scenes.lights import EMITTERS, FINDABLE, FLOOR, scene_of
from torch_radbp.connection.light import sample_light
from torch_radbp.sampling.mis import power_heuristic
from torch_radbp.sampling.warp import cosine_hemisphere_pdf, square_to_cosine_hemisphere
from torch_radbp.tensors.vec import Ray, rows
from torch_radbp.vertex.emission import (
    emitted,
    emitted_by_surface,
    emitted_by_surround,
    emitted_pdf,
    pdf_of_surface,
    pdf_of_surround,
)
from torch_radbp.vertex.interaction import surface_interaction

COUNT = 100_000


def irradiance(scene: rb.Scene) -> dict[str, torch.Tensor]:
    """(N, 3) estimates of the irradiance / pi over a patch of the floor, by each technique."""
    tensors = detached(scene)
    si = on_the_floor(scene, tensors, COUNT, 1).si

    # Nothing stands between the floor and the lights.
    light = sample_light(tensors, tensors, si.p, light_numbers(COUNT, 2))
    wo = si.frame.to_local(light.d)
    usable = (light.pdf > 0) & (wo.z > 0)
    bsdf_pdf = cosine_hemisphere_pdf(wo)
    by_light = light.radiance * (bsdf_pdf * usable / light.pdf.clamp_min(1e-30))
    weight = power_heuristic(light.weighing.clamp_min(1e-30), bsdf_pdf * light.findable)

    wo = square_to_cosine_hemisphere(*uniform(COUNT, 3, dimensions=2))
    d = si.frame.to_world(wo)
    view = cast(scene, tensors, Ray(si.offset(d), d))
    by_bsdf = emitted(tensors, view.ray, view.si)
    other = power_heuristic(cosine_hemisphere_pdf(wo), emitted_pdf(tensors, view.ray, view.si))
    return {"nee": by_light.stack(), "bsdf": by_bsdf.stack(), "mis": (by_light * weight + by_bsdf * other).stack()}


@pytest.mark.parametrize("name", FINDABLE)
def test_every_technique_estimates_the_same(name):
    found = {technique: mean_and_error(values) for technique, values in irradiance(scene_of(name)).items()}
    reference, reference_error = found["mis"]
    assert (reference > 0).all()
    for technique in ("nee", "bsdf"):
        mean, error = found[technique]
        if name == "envmap_compensated" and technique == "nee":
            assert (mean < reference).all()  # which leaves the dark parts to BSDF sampling
            continue
        # Three channels: beyond 4.5 by chance in one run of 50,000; the seeds are fixed.
        assert ((mean - reference).abs() / torch.hypot(error, reference_error)).max() < 4.5, technique
        assert (error < 0.02 * mean).all(), technique


@pytest.mark.parametrize("name", FINDABLE)
def test_an_emitter_of_weight_zero_is_left_to_chance(name):
    """As in Mitsuba: never picked, it counts in full where a ray meets it. A point light of weight 0 sheds no light."""
    more = {"other": {"type": "point", "position": [0.0, 2.0, 0.0], "intensity": 0.0}}
    scene = scene_of(name, **more)
    carrier = scene.get_submodule("lamp")
    (getattr(carrier, "emitter", None) or carrier).sampling_weight = 0.0
    weighted, alone = (rb.render(scene, spp=16, max_depth=3, nee=nee) for nee in (True, False))
    assert alone.max() > 0
    torch.testing.assert_close(weighted, alone, rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", ["all", "area", "constant", "point"])
def test_lanes_that_met_a_surface_and_lanes_that_met_nothing_can_be_asked_apart(name):
    scene = scene_of(name)
    tensors, count = detached(scene), 2000
    floor = on_the_floor(scene, tensors, count, 1, spread=2.0).si
    d = floor.frame.to_world(square_to_cosine_hemisphere(*uniform(count, 3, dimensions=2)))
    ray, hit, si = cast(scene, tensors, Ray(floor.offset(d), d))
    radiance, pdf = emitted(tensors, ray, si).stack(), emitted_pdf(tensors, ray, si)
    met, missed = (chosen.nonzero().squeeze(1) for chosen in (si.valid, ~si.valid))
    assert len(missed) > 0 and (len(met) > 0) == (name in ("all", "area"))
    there = surface_interaction(tensors, rows(ray, met), rows(hit, met))
    assert torch.equal(emitted_by_surface(tensors, there).stack(), radiance[met])
    assert torch.equal(pdf_of_surface(tensors, there, tensors), pdf[met])
    assert torch.equal(emitted_by_surround(tensors, rows(ray, missed)).stack(), radiance[missed])
    assert torch.equal(pdf_of_surround(tensors, rows(ray, missed)), pdf[missed])


@pytest.mark.parametrize("name", ["all", "envmap", "envmap_compensated", "area"])
def test_images_with_and_without_next_event_estimation_agree(name):
    scene = scene_of(name)
    if name == "all":
        for lamp in ("point", "spot_image", "projector", "directional"):  # which chance cannot find
            with torch.no_grad():
                next(p for n, p in scene.named_parameters() if n.startswith(f"{lamp}_lamp.") and n.endswith(
                    ("value", "irradiance.data"))).zero_()

    def blocks(seeds, **settings):
        renderer = rb.Renderer(scene, max_depth=4, rr_depth=100, **settings)
        return torch.nn.functional.avg_pool2d(torch.cat([renderer(seed=seed) for seed in seeds]), 4)

    by_chance, with_nee = blocks(range(16), nee=False, spp=256), blocks(range(100, 116), nee=True, spp=64)
    error = ((by_chance.var(0) + with_nee.var(0)) / 16).sqrt()
    mean, difference = by_chance.mean(0), with_nee.mean(0) - by_chance.mean(0)
    lit = mean > 0
    assert lit.sum() >= 6 and (difference.abs() / error)[lit].max() < 5.5 and (difference[~lit] == 0).all()
    assert error[lit].square().mean().sqrt() < 0.05 * mean[lit].mean()


def test_importance_sampling_pays():
    """A small sun overhead: next-event estimation knows where it is."""
    image = np.full((33, 64, 3), 0.2)
    image[5, 20] = 500
    found = irradiance(load(sensor=sensor(2), **FLOOR, sky={"type": "envmap", "bitmap": image}))
    assert (found["nee"].std(0) < 0.1 * found["bsdf"].std(0)).all()
    assert (found["mis"].std(0) < 0.2 * found["bsdf"].std(0)).all()


@pytest.mark.parametrize("name", EMITTERS)
def test_single_and_double_precision_agree(name):
    """One image from the same decisions, but for those that rounding changes."""
    single, double = (rb.render(scene_of(name, dtype), spp=16, max_depth=3, rr_depth=100)
                      for dtype in (torch.float32, torch.float64))
    differs = ((single.double() - double).abs() > 1e-3 * double.max()).any(dim=1).sum()
    assert double.max() > 0 and differs <= 6
