"""Parallel light from a surface: beams of closed form, and Mitsuba's particle tracer."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.emitter.lanes import at, cast, detached, light_numbers, uniform
from tests.scenes import load, rectangle, rgb, sensor
from tests.scenes.lights import FLOOR, scene_of, slide, turned
from torch_radbp.connection.light import LightSample, sample_light
from torch_radbp.emitter.area import AreaKind
from torch_radbp.io.values.transform import scale, translate
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.vertex.emission import emitted, emitted_pdf

POSE = translate((0.3, 1.1, -0.2)) @ turned(70, 20, -10) @ scale((0.5, 0.3, 1))
AXIS = POSE[:3, 2]
INSIDE = np.array([[-0.9, -0.8], [0.3, 0.6], [0.1, -0.7], [0.95, -0.2], [-0.4, 0.9]])  # of the rectangle, from -1 to 1
COUNT = 400


def beam(**emitter) -> rb.Scene:
    return load(sensor=sensor(2), **FLOOR, lamp={"type": "rectangle", "to_world": POSE,
                                                 "emitter": {"type": "directionalarea", **emitter}})


def arriving(scene: rb.Scene, points: np.ndarray) -> tuple[LightSample, torch.Tensor]:
    """Light samples at points, `COUNT` each, and the mean of radiance / probability, (points, 3)."""
    tensors = detached(scene)
    light = sample_light(tensors, tensors, at(np.repeat(points, COUNT, 0)), light_numbers(COUNT * len(points), 1))
    usable = light.pdf > 0
    mean = (light.radiance * (usable / torch.where(usable, light.pdf, 1.0))).stack().reshape(len(points), COUNT, 3).mean(1)
    return light, mean


def points_at(uv: np.ndarray, distance: float) -> np.ndarray:
    """The points in front of places of the lamp."""
    return np.c_[uv, np.zeros(len(uv))] @ POSE[:3, :3].T + POSE[:3, 3] + distance * AXIS


@pytest.mark.parametrize("distance", [1e-3, 0.7, 300.0])
def test_the_irradiance_across_the_beam_is_the_radiance_at_any_distance(distance):
    light, mean = arriving(beam(radiance=rgb(1, 2, 3)), points_at(INSIDE, distance))
    # Each triangle is picked half of the time, give or take what numbers other than those of `light_numbers` would.
    torch.testing.assert_close(mean, torch.tensor([1.0, 2, 3]).double().expand(5, 3), rtol=0.15, atol=0)
    chosen = light.pdf > 0
    assert set(light.pdf[chosen].tolist()) == {0.5} and not light.findable.any() and light.distant is None
    torch.testing.assert_close(light.d.stack(), torch.as_tensor(-AXIS).expand(len(chosen), 3), rtol=0, atol=1e-6)
    foot = torch.as_tensor(np.repeat(points_at(INSIDE, 0.0), COUNT, 0))
    torch.testing.assert_close(light.target.stack()[chosen], foot[chosen], rtol=0, atol=1e-6 * max(distance, 1))


def test_beside_and_behind_the_beam_there_is_no_light():
    beside = points_at(np.array([[1.05, 0.0], [-1.05, 0.3], [0.2, 1.1], [0.0, -1.04]]), 0.5)
    light, _ = arriving(beam(), np.concatenate([beside, points_at(INSIDE, -0.3)]))
    assert (light.pdf == 0).all() and torch.isfinite(light.target.stack()).all()


def test_the_beam_carries_the_picture():
    image = torch.as_tensor(slide(8, 8)["data"])
    light, _ = arriving(beam(radiance=slide(8, 8) | {"filter_type": "nearest"}), points_at(INSIDE, 0.8))
    texel = np.repeat((4 * (INSIDE + 1)).astype(int), COUNT, 0)
    chosen = light.pdf > 0
    expected = image[texel[:, 1], texel[:, 0]].double()
    torch.testing.assert_close(light.radiance.stack()[chosen], expected[chosen], rtol=1e-6, atol=0)


def test_beside_an_area_light_each_keeps_its_own_light():
    """A ray sees the area light, with half of the density that it has alone, and the other one black."""
    glow = {"type": "area", "radiance": rgb(1, 2, 3)}
    lamps = {name: rectangle((x, 1, 0), 0.4, (1, 0, 0), 90, emitter=glow | {"type": kind})
             for name, x, kind in (("a", -0.5, "area"), ("b", 0.5, "directionalarea"))}
    both, alone = (load(sensor=sensor(2), **FLOOR, **chosen) for chosen in (lamps, {"a": lamps["a"]}))
    u, v, _ = uniform(200, 3)
    x = torch.where(u < 0.5, -0.5, 0.5) + 0.3 * (v - 0.5)
    ray = Ray(Vec3(x, torch.full_like(x, -0.2), 0.3 * (v - 0.5)), Vec3(0 * x, 0 * x + 1, 0 * x))
    views = {name: cast(scene, detached(scene), ray) for name, scene in (("both", both), ("alone", alone))}
    light = emitted(detached(both), ray, views["both"].si).stack()
    expected = torch.tensor([1.0, 2, 3]).double() * (u < 0.5)[:, None]
    assert views["both"].si.valid.all() and torch.equal(light, expected)
    density = emitted_pdf(detached(both), ray, views["both"].si)
    before = emitted_pdf(detached(alone), ray, views["alone"].si)
    torch.testing.assert_close(density, before / 2 * (u < 0.5), rtol=1e-12, atol=0)
    assert detached(both).layout.lights[0] == AreaKind()  # in an order that does not depend on the scene's


def test_images_are_those_of_mitsubas_particle_tracer():
    """Its path tracer never meets this light. Blocks of pixels, level 1e-6: |z| < 4.9."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    pose, film = mi.ScalarTransform4f, {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    eye, down = sensor(8, (0, 3, 3), (0, 0, 0), 40), rectangle((0, 0, 0), 2.0, angle=-90)["to_world"]
    lamp = translate((0.2, 1.5, -0.1)) @ turned(80, 0, 15) @ scale((0.5, 0.4, 1))

    def scene(matrix) -> dict:
        return {"type": "scene",
                "eye": {"type": "perspective", "fov": 40.0, "to_world": matrix(eye["to_world"]), "film": film},
                "floor": {"type": "rectangle", "to_world": matrix(down),
                          "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.6, 0.7]}}},
                "lamp": {"type": "rectangle", "to_world": matrix(lamp), "bsdf": {"type": "diffuse", "reflectance": 0.0},
                         "emitter": {"type": "directionalarea", "radiance": {"type": "rgb", "value": [1.0, 2, 3]}}}}

    theirs = mi.load_dict(scene(lambda matrix: pose(matrix)) | {"integrator": {"type": "ptracer", "max_depth": 3}})
    theirs = np.stack([np.array(mi.render(theirs, spp=1500, seed=seed)) for seed in range(8)])
    ours = rb.Renderer(rb.load_dict(scene(lambda matrix: matrix)), spp=256, max_depth=3)
    ours = np.stack([ours(seed=seed)[0].permute(1, 2, 0).numpy() for seed in range(8)])
    mean, other = ours.mean(0), theirs.mean(0)
    error = np.sqrt((ours.var(0, ddof=1) + theirs.var(0, ddof=1)) / 8)
    lit = other > 0.01
    assert lit.sum() >= 15 and (error[lit] < 0.05 * other[lit] + 0.01).all()
    assert (np.abs(mean - other)[lit] < 4.9 * 1.6 * error[lit]).all()  # 1.6: Student's t of 14 degrees of freedom at 1e-6
    assert abs(mean.sum() / other.sum() - 1) < 0.01


def test_a_shape_with_smooth_normals_is_refused():
    scene = load(sensor=sensor(2), lamp={"type": "sphere", "emitter": {"type": "directionalarea"}})
    with pytest.raises(ValueError, match="directionalarea emitter belongs to a shape with flat faces"):
        rb.render(scene, spp=1, max_depth=2)


def test_a_camera_sees_the_surface_black_and_its_light_on_the_floor():
    scene = scene_of("directionalarea")
    assert rb.render(scene, spp=16, max_depth=1).max() == 0
    assert rb.render(scene, spp=16, max_depth=2).max() > 0.01
