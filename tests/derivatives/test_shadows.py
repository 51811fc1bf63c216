"""What borders of shadows add to derivatives is that of finite differences, and of closed forms."""

from __future__ import annotations

import math

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.derivatives.in_expectation import Effort, Estimate, Row, assert_agrees
from tests.scenes import diffuse, load, overhead, rgb
from tests.scenes.shadows import FLOOR, LAMPS, PLATE, SHADOWS, VIEWED
from torch_radbp.boundary.terms import of_call as terms
from torch_radbp.boundary.terms.hidden_light import HiddenLight
from torch_radbp.io.values.transform import scale, translate

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

BATCHES = 8

# The bias that a batch of so many samples shows.
SHOWN = {
    (0.05, 64): ("camera, directional", "camera, constant", "floor, envmap", "camera, envmap", "lamp before a wall, spot",
                 "lamp before a wall, rectangle", "lamp before a wall, rectangle, four bounces"),
    (0.05, 128): ("lamp, spot", "camera, point", "floor, constant", "floor, directional",
                  "camera without perspective, point"),
    (0.05, 256): ("floor, point", "lamp, point", "camera, spot",
                  "floor under an instance, spot", "thin lens, point"),
    (0.05, 512): ("vertices of a plate, point", "plate, point", "attached, point", "camera, rectangle", "plate, spot",
                  "floor, spot", "camera before a wall, spot", "a window of a film, gaussian", "lamp, directional"),
    (0.05, 1024): ("plate of metal, point",),
    (0.1, 256): ("floor, rectangle", "vertices of a plate, rectangle"),
    (0.1, 512): ("lamp, rectangle", "cube, rectangle", "instance, rectangle", "ball, rectangle", "plate, rectangle",
                 "floor, ball", "plate, directional", "floor before a wall, rectangle", "floor of metal, rectangle",
                 "lamp, shadow in a mirror", "floor, shadow in a mirror"),
    (0.1, 1024): ("two lamps of different kinds", "instance, point", "plate before a wall, rectangle"),
    (0.2, 256): ("fisheye, directional", "camera, ball", "camera before a wall, rectangle",
                 "vertices of a cube, directional", "mirror, shadow in a mirror"),
    (0.2, 512): ("lamp, ball", "plate before a wall, rectangle, four bounces",
                 "camera before a wall, rectangle, four bounces", "many lamps", "camera, shadow in a mirror"),
    (0.2, 2048): ("plate, ball", "plate before a wall, spot"),
    (0.4, 1024): ("wall before a wall, spot", "plate, constant", "plate, envmap", "plate, shadow in a mirror",
                  "plate, compensated envmap"),
    (0.4, 2048): ("floor before a wall, spot",),
    (0.4, 4096): ("plate, rectangle of weight 0",),
    (0.1, 64): ("attached, plate of metal",),
    (0.05, 192): ("attached, floor under a sky", "attached, lamp before a wall"),
    (0.1, 192): ("attached, lamp", "attached, camera", "attached, camera before a wall", "attached, roughness of a floor",
                 "pane, of rough glass"),
    (0.2, 192): ("attached, plate under a rectangle",),
    (0.5, 192): ("attached, floor of metal", "attached, plate before a wall under a spot"),
    (0.2, 768): ("attached, plate under a sky", "attached, plate under an environment"),
    (0.6, 192): ("plate, through rough glass",),
    (0.8, 192): ("roughness of a pane",),
}
# Where moving surfaces meet, edges come near to vertices of paths, and rare samples are large: no such number tells.
RARE = {"wall before a wall, rectangle", "wall before a wall, rectangle, four bounces",
        "floor before a wall, rectangle, four bounces"}
ROWS = [Row(name, bias, spp) for (bias, spp), names in SHOWN.items() for name in names]
QUICK = ("lamp, spot", "camera, constant", "lamp before a wall, spot", "instance, rectangle", "attached, plate of metal")


def test_every_scene_is_examined():
    assert {row.name for row in ROWS} == set(SHADOWS) - RARE and len(ROWS) == len(SHADOWS) - len(RARE) >= 62


@pytest.mark.parametrize("row", deep_but([row for row in ROWS if row.name in QUICK], ROWS), ids=str)
def test_derivatives_are_those_of_finite_differences(row):
    """And if they were wrong by the stated bias, that would be noticed; of most rows shadows are more than that."""
    measured = Estimate(SHADOWS[row.name], Effort(row.spp, BATCHES))
    measured.add_round()
    assert_agrees(measured, row, ("agrees", "too noisy"))


HEIGHT, LAMP = 0.5, 2.0  # of the edge, and of the lamp, above the floor
ALBEDO, INTENSITY = 0.6, 5.0


def half_plane(**lamp) -> rb.Scene:
    """A floor seen from above without perspective, from -1 to 1; a plate hides the lamp from where x < 0 on the plate."""
    view = overhead()
    floor = {"type": "rectangle", "to_world": scale((9, 9, 1)), "bsdf": diffuse(ALBEDO, ALBEDO, ALBEDO)}
    # Out of the camera's sight: one cannot look through it from above.
    plate = {"type": "rectangle", "to_world": translate((-9 - 2.0, 0, HEIGHT)) @ scale((9, 9, 1)), "bsdf": diffuse(0.5)}
    return load(torch.float64, sensor=view, floor=floor, plate=plate, lamp=lamp)


@pytest.mark.parametrize("moving, along", [
    (("plate.to_world", "lamp.position"), 0), deep(("plate.to_world",), 0), deep(("lamp.position",), 0),
    deep(("plate.to_world",), 1)], ids=str)
def test_the_border_of_a_half_plane_before_a_point_light_moves_as_it_does_by_hand(moving, along):
    """The light lost is that of the border times its speed: by similar triangles H / (H - h), and -h / (H - h)."""
    speeds = {"plate.to_world": LAMP / (LAMP - HEIGHT), "lamp.position": -HEIGHT / (LAMP - HEIGHT)}
    speed = sum(speeds[name] for name in moving) if along == 0 else 0.0
    far = LAMP / (LAMP - HEIGHT)
    lamp_x = (0.35 + 2.0 * far) / (1.0 - far)  # so that the border, lamp + far (edge - lamp), falls at x = 0.35
    scene = half_plane(type="point", position=[lamp_x, 0.0, LAMP], intensity=rgb(INTENSITY, INTENSITY, INTENSITY))
    tangents = {name: torch.zeros_like(scene.get_parameter(name)) for name in moving}
    for tangent in tangents.values():
        (tangent if tangent.ndim == 1 else tangent[:, 3])[along] = 1.0
    whole, without = (torch.stack([rb.jvp(scene, tangents, seed=seed, spp=1024, max_depth=2, terms=chosen).mean()
                                   for seed in range(8)]) for chosen in (rb.Renderer(scene).terms, ("interior", "primary")))
    y = torch.linspace(-1, 1, 2001, dtype=torch.float64)
    squared = (0.35 - lamp_x) ** 2 + y**2 + LAMP**2
    radiance = ALBEDO / math.pi * INTENSITY * LAMP / squared**1.5
    expected = -speed * float(torch.trapezoid(radiance, y)) / 4.0  # of an area of 4
    found = whole - without
    error = found.std() / math.sqrt(len(found))
    assert abs(float(found.mean()) - expected) <= 4 * float(error) + 1e-3 * abs(expected) + 1e-12
    assert speed == 0.0 or float(error) < 0.02 * abs(expected)


def test_nothing_is_looked_for_where_nothing_moves(monkeypatch):
    monkeypatch.setattr(terms, "shadow_jumps", lambda *arguments: pytest.fail("shadows have been looked for"))
    scene = load(sensor=VIEWED, floor=FLOOR, plate=PLATE, lamp=LAMPS["rectangle"])
    for name in ("plate.bsdf.brdf_0.reflectance.value", "lamp.emitter.radiance.value"):
        scene.get_parameter(name).requires_grad_()
    image = rb.Renderer(scene, max_depth=2)(seed=1, spp=2)
    image.sum().backward()
    assert float(scene.get_parameter("lamp.emitter.radiance.value").grad.abs().sum()) > 0


def test_what_next_event_estimation_would_find_has_no_shadow_without_it():
    """Nothing finds a point light then, and a lamp has the shadow that it has with it."""
    tangents, found = {"plate.to_world": torch.eye(4)}, {}
    for lamp in ("point", "rectangle"):
        scene = load(sensor=VIEWED, floor=FLOOR, plate=PLATE, lamp=LAMPS[lamp])
        for nee in (True, False):
            whole, without = (rb.jvp(scene, tangents, seed=3, spp=256, max_depth=2, nee=nee, terms=chosen)
                              for chosen in (("interior", "primary", "shadow"), ("interior", "primary")))
            found[lamp, nee] = whole - without
    assert not found["point", False].any() and found["point", True].abs().max() > 0.1
    assert torch.equal(found["rectangle", True] == 0, found["rectangle", False] == 0)
    assert torch.allclose(found["rectangle", True], found["rectangle", False], atol=1e-4)
    assert found["rectangle", True].abs().max() > 0.1


def test_images_stay_what_they_are_and_threads_and_chunks_change_no_bit():
    found = []
    for settings in ({}, {"chunk": 512}, {"terms": ("interior", "primary")}):
        scene = load(torch.float32, sensor=VIEWED, floor=FLOOR, plate=PLATE, lamp=LAMPS["rectangle"])
        pose = scene.get_parameter("plate.to_world").requires_grad_()
        image = rb.Renderer(scene, max_depth=3, **settings)(seed=1, spp=16)
        image.square().sum().backward()
        found.append((image.detach(), pose.grad))
    assert torch.equal(found[0][0], found[1][0]) and torch.equal(found[0][0], found[2][0])
    assert torch.equal(found[0][1], found[1][1]) and not torch.allclose(found[0][1], found[2][1], rtol=1e-3)


@pytest.mark.parametrize("depth, sought", [(2, False), (3, True)])
def test_light_past_edges_is_sought_at_later_vertices_alone_where_lamps_have_the_rest(depth, sought, monkeypatch):
    """Borders of the light that the first surface gets from a lamp are sampled by themselves."""
    calls = []
    monkeypatch.setattr(HiddenLight, "samples", lambda *arguments: calls.append(arguments))
    scene = load(torch.float32, sensor=VIEWED, floor=FLOOR, plate=PLATE, lamp=LAMPS["rectangle"])
    pose = scene.get_parameter("plate.to_world").requires_grad_()
    rb.Renderer(scene, max_depth=depth)(seed=1, spp=4).sum().backward()
    assert bool(calls) == sought and pose.grad.any()
