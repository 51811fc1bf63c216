"""Black strips beside outlines of curved mirrors and glass: which scenes have them; they are searched there alone."""

from __future__ import annotations

from typing import Any

import pytest
import torch

import torch_radbp as rb
from benchmarks import caustic_noise
from benchmarks.caustic_noise import GLASS, MIRROR, PLASTIC
from torch_radbp.boundary.eye import black_strips
from torch_radbp.boundary.terms import crossings, of_call, reflections, scans
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.scene.packing.pack import pack
from torch_radbp.shape.sphere import unit_sphere
from torch_radbp.tensors.differentiated import detached

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

DIFFUSE = {"type": "diffuse"}
FINE_ENOUGH = 160, 80  # facets around a mesh and from pole to pole, by 2.25 degrees each
SEEDS = 12


def ball(bsdf: dict) -> dict[str, Any]:
    return caustic_noise.ball([0, 0, 0.7], 0.5, bsdf=bsdf)


def mesh(bsdf: dict, segments: int = 24, rings: int = 12, normals: bool = True) -> dict[str, Any]:
    """A tessellated ball at the same place."""
    unit = unit_sphere(segments, rings)
    more = {"vertex_normals": unit.normals.float()} if normals else {}
    place = torch.tensor([0.0, 0.0, 0.7])
    return {"type": "mesh", "vertex_positions": 0.5 * unit.vertices.float() + place, "faces": unit.faces.int(), "bsdf": bsdf,
            **more}


def shown(thing: dict, pose) -> dict[str, Any]:
    """Things in a room, of which one is shown by an instance of a group."""
    return {"group": {"type": "shapegroup", "thing": thing},
            "instance": {"type": "instance", "to_world": pose, "group": {"type": "ref", "id": "group"}}}


TURNED = translate((0.2, 0.1, 0)) @ rotate((1, 2, 0.5), 40) @ scale((0.6, 0.6, 0.6))
HAVE = {
    "coarse coat": {"ball": mesh(PLASTIC)},
    "coarse mirror, seen from both sides": {"ball": mesh({"type": "twosided", "bsdf": MIRROR})},
    "coarse coat on the back": {"ball": mesh({"type": "twosided", "one": DIFFUSE, "other": PLASTIC})},
    "glass": {"ball": ball(GLASS)},
    "flat ellipsoid": {"ball": {"type": "sphere", "to_world": scale((1, 1, 0.1)), "bsdf": PLASTIC}},
    "coarse coat, shown by an instance": shown(mesh(PLASTIC), TURNED),
    "fine coat, shown by an instance that distorts it": shown(ball(PLASTIC), TURNED @ scale((1, 1, 0.9))),
}
HAVE_NOT = {
    "fine coat": {},
    "fine mirror": {"ball": ball(MIRROR)},
    "fine mesh": {"ball": mesh(PLASTIC, *FINE_ENOUGH)},
    "coarse, but not ideal": {"other": mesh(DIFFUSE)},
    "coarse, but not smooth": {"other": mesh(PLASTIC, normals=False)},
    "flat glass": {"other": {"type": "cube", "bsdf": GLASS}},
    "fine coat, shown by an instance": shown(ball(PLASTIC), TURNED),
    "not ideal, shown by an instance that distorts it": shown(ball(DIFFUSE), TURNED @ scale((1, 1, 0.9))),
}


@pytest.mark.parametrize("things, expected", [*((things, True) for things in HAVE.values()),
                                              *((things, False) for things in HAVE_NOT.values())], ids=[*HAVE, *HAVE_NOT])
def test_coarse_mirrors_and_curved_glass_have_them(things, expected):
    scene = rb.load_dict(caustic_noise.room(lamp=caustic_noise.ABOVE, **({"coated": ball(PLASTIC)} | things)))
    assert black_strips.black_strips(detached(pack(scene))) is expected


def test_they_are_looked_for_again_where_vertices_have_moved_alone(monkeypatch):
    found, look = [], black_strips.black_strips
    monkeypatch.setattr(black_strips, "black_strips", lambda scene: found.append(look(scene)) or found[-1])
    scene = rb.load_dict(caustic_noise.room(lamp=caustic_noise.ABOVE, ball=mesh(PLASTIC, *FINE_ENOUGH)))
    renderer = rb.Renderer(scene, spp=4, max_depth=3, terms=("primary",), light_paths="camera")
    vertices = scene.get_parameter("ball.vertex_positions").requires_grad_()
    for factor in (1.0, 1.0, 0.5, 0.5):
        vertices.data[:, 2] *= factor  # the normals stay
        scene.floor.bsdf.reflectance.value.data *= 0.9
        renderer(seed=1).mean().backward()
    assert found == [False, True, True]


def gradients(thing: dict[str, Any], name: str, monkeypatch, seeds: int) -> torch.Tensor:
    """(seeds, 3) derivatives of what a thing in a room reflects by its place."""
    with monkeypatch.context() as patched:
        patched.setattr(of_call, "image_jumps", lambda call, jumps: 0.0)
        scene = rb.load_dict(caustic_noise.room(lamp=caustic_noise.ABOVE, ball=thing))
        moving = scene.get_parameter(name).requires_grad_()
        renderer = rb.Renderer(scene, spp=64, terms=("primary",), light_paths="camera")
        losses = (caustic_noise.loss_of(renderer(seed=seed)) for seed in range(seeds))
        found = [torch.autograd.grad(loss, moving)[0].double() for loss in losses]
    return torch.stack([each[:3, 3] if name == "ball.to_world" else each.sum(0) for each in found])


@pytest.mark.parametrize("thing, name, searches", [
    (ball(PLASTIC), "ball.to_world", False), (ball(GLASS), "ball.to_world", True),
    (mesh(PLASTIC), "ball.vertex_positions", True)], ids=["fine coat", "glass", "coarse coat"])
def test_they_are_searched_where_they_are(thing, name, searches, monkeypatch):
    steps, divided_at_outlines = [], crossings.divided_at_outlines

    def noted(searched, points, path, pairs, turn):
        steps.append(len(pairs.times))
        return divided_at_outlines(searched, points, path, pairs, turn)

    monkeypatch.setattr(crossings, "divided_at_outlines", noted)
    gradients(thing, name, monkeypatch, 1)
    assert (sum(steps) > 100) is searches and bool(steps) is searches


def test_a_fine_coat_has_the_same_derivative_without_the_search_and_less_noise(monkeypatch):
    """Its outline, which is found otherwise, drew most of the scans to pixels in which nothing jumps."""
    points, corner_passes = [], scans.corner_passes

    def noted(searched, *arguments):
        likely, seen = corner_passes(searched, *arguments)
        points.append(float(likely.sum()))
        return likely, seen

    monkeypatch.setattr(scans, "corner_passes", noted)
    found = gradients(ball(PLASTIC), "ball.to_world", monkeypatch, SEEDS)
    monkeypatch.setattr(reflections, "has_black_strips", lambda call: True)
    searched = gradients(ball(PLASTIC), "ball.to_world", monkeypatch, SEEDS)
    error = ((found.var(0) + searched.var(0)) / SEEDS).sqrt()
    assert ((found.mean(0) - searched.mean(0)).abs() < 4.0 * error).all()
    assert found.var(0).sum() < 0.5 * searched.var(0).sum()
    assert sum(points[:len(points) // 2]) < sum(points[len(points) // 2:])
