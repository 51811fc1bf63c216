"""Media that shapes enclose end where rays meet nothing: rounding has put these beyond the boundary already. Else such a ray
collects and loses without limit. Balls far from the origin have coarse numbers, so that many rays are of that kind."""

from __future__ import annotations

import pytest
import torch

import torch_radbp as rb
from tests.scenes import load, rectangle, sensor
from tests.scenes.meshes import icosphere
from torch_radbp.connection.light import FAR
from torch_radbp.io.values.transform import scale, translate
from torch_radbp.path.passage import ways_at_first
from torch_radbp.path.shadow_passage import ShadowPassage, next_shadow_segment
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.packing.pack import pack
from torch_radbp.tensors.vec import Ray, Vec3

NULL = {"type": "null"}
FOG = {"type": "homogeneous", "sigma_t": 0.0, "albedo": 0.8}
AIR = {"type": "ref", "id": "air"}
SHEET = rectangle((0, 0, 0), 1.0, bsdf=NULL)


def ball(radius: float = 0.7, center: float = 0.0, **more) -> dict:
    return {"type": "sphere", "center": [center, 0, 0], "radius": radius, "bsdf": NULL, **more}


def seen_from(center: float, **more) -> dict:
    """A ball and a camera that looks at it; no ray misses it."""
    return {"camera": sensor(4, (center, 0.0, 3.0), (center, 0.0, 0.0), 18.0), "ball": ball(center=center, **more)}


def test_what_a_ball_emits_has_the_derivative_of_one_at_the_origin_wherever_it_is():
    """By an extinction of 0, where all that a ray collects on its way counts."""
    found = []
    for center in (0.0, 4096.0):
        scene = load(torch.float32, **seen_from(center, interior=FOG | {"emission": 1.0}))
        name = "ball.interior.sigma_t.value.value"
        tangent = torch.ones_like(dict(scene.named_parameters())[name])
        changes = torch.stack([rb.jvp(scene, {name: tangent}, seed=seed, spp=4096, max_depth=4).mean()
                               for seed in range(8)])
        found.append((float(changes.mean()), float(changes.std()) / 8**0.5))
    (expected, noise), (away, noise_away) = found
    assert expected < -0.1 and 0 < max(noise, noise_away) < 0.02 * abs(expected)
    assert abs(away - expected) < 0.05 * abs(expected)  # that it is a ball is rounded, too


def test_in_a_furnace_radiance_is_1_where_rounding_is_coarse():
    """Rays that have left without a boundary bring the sky's light."""
    fog = {"type": "homogeneous", "sigma_t": 3.0, "albedo": 1.0}
    scene = load(torch.float32, sky={"type": "constant"}, **seen_from(16384.0, interior=fog))
    means = torch.stack([rb.render(scene, spp=1 << 14, max_depth=64, rr_depth=64, nee=False, seed=seed).mean()
                         for seed in range(4)]).double()
    assert 0 < float(means.std()) / 2 < 1e-4 and abs(float(means.mean()) - 1.0) < 3e-4


@pytest.mark.parametrize("shape, far", [(ball(interior=FOG), 0.0), (SHEET | {"interior": FOG}, FAR)],
                         ids=["enclosed", "without end"])
def test_light_from_far_away_comes_to_places_behind_the_boundary(shape, far):
    """A connection that meets nothing, to a sun and to a lamp nearby, which may be in the medium."""
    scene = pack(load(torch.float64, sky={"type": "constant"}, camera=sensor(4, (0, 0, 3.0)), emitting=ball(
        0.1, 5.0, interior={"type": "homogeneous", "emission": 1.0}), body=shape))
    distance = torch.tensor([FAR, 2.0], dtype=torch.float64)
    nothing, none = torch.zeros(2, dtype=torch.float64), torch.zeros(2, dtype=torch.int32)
    medium = none + scene.layout.media.index(next(kind for kind in scene.layout.media if kind.emission is None))
    ray = Ray(Vec3(nothing + 1.0, nothing, nothing), Vec3(nothing + 1.0, nothing, nothing))
    passed = ShadowPassage(ray, medium, none, none == 0, ways_at_first(scene, nothing), None)
    on, passes = next_shadow_segment(scene, ray, distance, passed, Hit(none - 1, nothing, nothing, nothing), None,
                                     torch.arange(2, dtype=torch.int32))
    assert on.free.all() and not passes.any()
    assert on.ways[int(medium[0])].length.tolist() == [far, 2.0]


def layout(**objects):
    sky, camera = {"type": "constant"}, sensor(4, (0, 0, 3.0))
    return pack(load(torch.float64, **{"air": FOG, "sky": sky, "camera": camera, **objects})).layout


def mesh(count: int | None = None, **more) -> dict:
    """The first of the triangles of a ball."""
    vertices, faces = icosphere(1)
    return {"type": "mesh", "vertex_positions": vertices, "faces": faces[:count], "bsdf": NULL, **more}


@pytest.mark.parametrize("shape", [
    ball(interior=AIR), {"type": "cube", "bsdf": NULL, "interior": AIR}, mesh(interior=AIR),
    ball(interior=AIR, to_world=scale((1.0, 2.0, 3.0))), ball(exterior=AIR, flip_normals=True),
    ball(exterior=AIR, to_world=scale((-1.0, 2.0, 3.0)))], ids=str)
def test_closed_shapes_enclose_what_is_in_them(shape):
    assert layout(body=shape).enclosed_media == (0,)


@pytest.mark.parametrize("shape", [
    ball(exterior=AIR), ball(interior=AIR, flip_normals=True), ball(interior=AIR, to_world=scale((-1.0, 2.0, 3.0))),
    SHEET | {"interior": AIR},
    {"type": "cylinder", "bsdf": NULL, "interior": AIR}, {"type": "disk", "bsdf": NULL, "interior": AIR},
    mesh(79, interior=AIR)], ids=str)
def test_others_do_not(shape):
    """Behind them, and outside of bodies, a medium goes on without end."""
    assert layout(body=shape).enclosed_media == ()
    assert layout(body=shape, other=ball(interior=AIR, radius=0.1)).enclosed_media == ()


def test_sensors_stand_in_no_medium_that_is_enclosed():
    assert layout(body=ball(interior=AIR), camera=sensor(4, (0, 0, 3.0)) | {"medium": AIR}).enclosed_media == ()


@pytest.mark.parametrize("radius, enclosed", [(0.3, (0, 1)), (1.3, (1,))], ids=["in it", "around it"])
def test_a_medium_around_a_body_is_enclosed_if_the_body_is_in_it(radius, enclosed):
    core = ball(radius, interior={"type": "homogeneous", "sigma_t": 2.0}, exterior=AIR)
    assert layout(body=ball(interior=AIR), core=core).enclosed_media == enclosed


def test_boundaries_of_what_a_body_moves_out_of_are_found_again():
    scene = load(torch.float64, air=FOG, sky={"type": "constant"}, camera=sensor(4, (0, 0, 3.0)), body=ball(interior=AIR),
                 core=ball(0.3, interior={"type": "homogeneous"}, exterior=AIR))
    assert pack(scene).layout.enclosed_media == (0, 1)
    with torch.no_grad():
        scene.core.to_world.copy_(torch.as_tensor(translate((1.0, 0.0, 0.0))) @ scene.core.to_world)
    assert pack(scene).layout.enclosed_media == (1,)
