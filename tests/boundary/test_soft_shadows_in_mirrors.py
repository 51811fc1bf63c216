"""Borders of soft shadows that cameras see by way of one ideal vertex: scans of the film find them, and they alone do; by
default in coats, and everywhere in these tests."""

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.scenes import diffuse, load, look_at, rectangle, rgb, sensor
from tests.scenes.shadows import FLOOR, LAMPS, PLATE, PUSH
from torch_radbp.boundary.terms.covered_lights import Lights
from torch_radbp.boundary.terms.hidden_light import HiddenLight
from torch_radbp.io.values.transform import scale, translate

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

SIZE, SEEDS, WALL = 16, 8, 2.2  # where the mirror stands
EYE, TARGET = (0.3, 0.6, 2.2), (0.15, WALL, 0.95)
MIRROR = rectangle((0.0, WALL, 0.9), 3.0, (1, 0, 0), 90, bsdf={"type": "conductor", "material": "none"})
PLASTIC = FLOOR | {"bsdf": {"type": "plastic", "diffuse_reflectance": rgb(0.5, 0.4, 0.3)}}
FLOORS, LAMP = {"diffuse": FLOOR, "plastic": PLASTIC}, "rectangle"
ONLY_SHARP, SCANNED = (staticmethod(lambda call, soft=soft: Lights(True, soft, False)) for soft in (False, True))


def shaded(floor: str = "diffuse", lamp: str = LAMP, **objects) -> rb.Scene:
    """A floor under a lamp, a plate between, seen by way of the mirror if it is among the objects."""
    return load(torch.float64, floor=FLOORS[floor], plate=PLATE, lamp=LAMPS[lamp], **objects)


def in_a_mirror(*given: str) -> rb.Scene:
    """The floor and the shadow there, which are seen in a mirror alone."""
    return shaded(*given, sensor=sensor(SIZE, EYE, TARGET, 24), mirror=MIRROR)


def from_behind_it(*given: str) -> rb.Scene:
    """The same by the mirror's image of the camera, whose up is the other's down: rows are in the other order."""
    return shaded(*given, sensor=sensor(SIZE, (EYE[0], 2 * WALL - EYE[1], EYE[2]), TARGET, 24))


def derivatives(scene: rb.Scene, name: str, tangent: Tensor, **settings) -> Tensor:
    """(SEEDS, SIZE, SIZE) derivatives of the image by seeds, mean over colours."""
    return torch.stack([rb.jvp(scene, {name: tangent}, seed=seed, **settings)[0].mean(0) for seed in range(SEEDS)])


def assert_agree(one: Tensor, other: Tensor, noise: float) -> None:
    """Sums by smooth weights agree, by their standard errors, which are a small share of them."""
    ramp = torch.linspace(-1.0, 1.0, SIZE, dtype=torch.float64)
    weights = torch.stack([torch.ones(SIZE, SIZE).double(), ramp.expand(SIZE, SIZE), ramp[:, None].expand(SIZE, SIZE)])
    sums = [torch.einsum("sij,wij->sw", part, weights) for part in (one, other)]
    error = (sum(part.var(0) for part in sums) / SEEDS).sqrt()
    scales = (one.mean(0).abs() * weights.abs()).sum((1, 2))
    assert (error < noise * scales).all()
    assert ((sums[0].mean(0) - sums[1].mean(0)).abs() < 4 * error).all()


@pytest.mark.parametrize("moving, floor, lamp, noise", [
    *(deep(moving, "diffuse", LAMP, 0.05) for moving in ("plate", "lamp", "floor")),
    ("plate", "plastic", LAMP, 0.1), ("plate", "plastic", "point", 0.02)])
def test_a_shadow_in_a_mirror_has_the_derivative_of_what_the_mirrored_camera_sees(moving, floor, lamp, noise, monkeypatch):
    """Which `DirectShadows` has, whose borders are projected. On a coat they count whether paths go on from there or not."""
    monkeypatch.setattr(Lights, "mirrored", SCANNED)
    scene, name = in_a_mirror(floor, lamp), f"{moving}.to_world"
    tangent = PUSH[moving](scene.get_parameter(name).detach())
    terms = "interior", "shadow"  # without what jumps in view: the lamp, and the plate before it, in coats
    seen = derivatives(scene, name, tangent, spp=64, max_depth=3, terms=terms)
    expected = derivatives(from_behind_it(floor, lamp), name, tangent, spp=64, max_depth=2, terms=terms)
    assert_agree(expected.flip(1), seen, noise)


def test_vertices_seen_in_a_mirror_look_for_no_lamp_past_edges(monkeypatch):
    found, samples = [], HiddenLight.samples
    monkeypatch.setattr(HiddenLight, "samples", lambda *given: found.append(samples(*given)) or found[-1])
    scene = in_a_mirror()
    tangent = PUSH["plate"](scene.get_parameter("plate.to_world").detach())
    for mirrored in (SCANNED, ONLY_SHARP):
        monkeypatch.setattr(Lights, "mirrored", mirrored)
        rb.jvp(scene, {"plate.to_world": tangent}, spp=64, max_depth=3)
    assert found[0] is None and found[1] is not None


def room(**things) -> rb.Scene:
    """A floor under a lamp, seen at once, and in what stands on it."""
    return load(torch.float64, sensor=sensor(SIZE, (0, -2.6, 1.6), (0, 0, 0.4), 45, "gaussian"),
                floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                lamp=rectangle((0.6, 0.3, 3.0), 0.4, (0, 1, 0), 190, emitter={"type": "area", "radiance": rgb(20, 18, 16)}),
                **things)


ROOMS = {
    "plastic ball": {"thing": {"type": "sphere", "center": [0, 0, 0.7], "radius": 0.5, "bsdf": {
        "type": "plastic", "diffuse_reflectance": rgb(0.5, 0.4, 0.3)}}},
    "glass ball beside a cube": {
        "glass": {"type": "sphere", "center": [0.5, 0, 0.6], "radius": 0.4, "bsdf": {"type": "dielectric"}},
        "thing": {"type": "cube", "to_world": translate((-0.4, 0, 0.6)) @ scale((0.2, 0.25, 0.3)),
                  "bsdf": diffuse(0.5, 0.3, 0.2)}},
    "mirror behind a plate": {
        "mirror": rectangle((0, 1.2, 0.9), 0.8, (1, 0, 0), 95, bsdf={"type": "conductor", "material": "none"}),
        "thing": {"type": "rectangle", "to_world": translate((0, 0.4, 0.6)) @ look_at((0, 0, 0), (0.2, 0.4, 1), (0, 1, 0))
                  @ scale((0.3, 0.25, 1)), "bsdf": {"type": "twosided", "one": diffuse(0.5, 0.6, 0.4)}}},
}


@pytest.mark.parametrize("name", deep_but(["mirror behind a plate"], ROOMS))
def test_nothing_is_lost_or_counted_twice_where_scans_find_what_vertices_found(name, monkeypatch):
    """With all vertices looking for lamps past edges, and no scan for their shadows, derivatives are as noisy as they were,
    and the same."""
    scene = room(**ROOMS[name])
    tangent = torch.zeros(4, 4, dtype=torch.float64)
    tangent[:3, 3] = torch.tensor([0.5, 0.3, 0.8])
    monkeypatch.setattr(Lights, "mirrored", SCANNED)
    settings = {"spp": 32, "max_depth": 5, "light_paths": "camera"}
    scanned = derivatives(scene, "thing.to_world", tangent, **settings)
    monkeypatch.setattr(Lights, "mirrored", ONLY_SHARP)
    looked = derivatives(scene, "thing.to_world", tangent, **settings)
    assert_agree(scanned, looked, 0.2)


@pytest.mark.parametrize("name", ROOMS)
def test_by_default_the_film_is_scanned_for_shadows_in_coats(name, monkeypatch):
    said, mirrored = [], Lights.mirrored
    monkeypatch.setattr(Lights, "mirrored", staticmethod(lambda call: said.append(mirrored(call)) or said[-1]))
    tangent = torch.eye(4, dtype=torch.float64)
    rb.jvp(room(**ROOMS[name]), {"thing.to_world": tangent}, spp=1, max_depth=3, light_paths="camera", compile=False)
    assert said and set(said) == {Lights(True, name == "plastic ball", False)}
