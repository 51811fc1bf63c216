"""Surfaces that go on smoothly, over which what is seen in mirrors changes without a jump."""

from __future__ import annotations

import pytest
import torch

import torch_radbp as rb
from tests.scenes import load
from tests.scenes.mirrors import CUBE, IN_MIRROR, METAL, MIRROR, SKY
from torch_radbp.boundary.eye.surfaces import Surfaces, connected, surfaces_of
from torch_radbp.boundary.terms import of_call as terms
from torch_radbp.io.values.transform import scale


def surfaces(scene: rb.Scene, monkeypatch) -> Surfaces:
    """Those that mirrors are looked into with, of a call in which the camera moves."""
    found = []

    def looked_into(call, reflected):
        still = call.still()
        found.append(surfaces_of(still, reflected.meshes, reflected.lines))
        return torch.zeros(())

    monkeypatch.setattr(terms, "reflected_jumps", looked_into)
    scene.get_parameter("sensor.to_world").requires_grad_()
    rb.Renderer(scene, max_depth=3)(seed=1, spp=1)
    return found[0]


BALL = {"type": "sphere", "to_world": scale((0.3, 0.3, 0.3)), "bsdf": METAL}


@pytest.mark.parametrize("thing, parts, sizes", [(CUBE, 6, 2), (BALL, 1, None)], ids=["cube", "ball"])
def test_sides_of_a_cube_are_smooth_parts_and_so_is_a_ball(thing, parts, sizes, monkeypatch):
    scene = load(sensor=IN_MIRROR, mirror=MIRROR, thing=thing, sky=SKY)
    found = surfaces(scene, monkeypatch).smooth
    _, counts = found.part.unique(return_counts=True)
    assert len(counts) == 1 + parts and (sizes is None or counts.tolist() == [sizes] * (1 + parts))
    near = found.continues >= 0
    here = torch.div(near.nonzero().squeeze(1), 3, rounding_mode="floor")
    assert near.any() and torch.equal(found.part[here], found.part[found.continues[near].long()])


def test_smooth_parts_are_found_anew_only_if_other_edges_are_smooth(monkeypatch):
    flat = {"type": "mesh", "vertex_positions": torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]),
            "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]), "bsdf": METAL}
    scene = load(sensor=IN_MIRROR, mirror=MIRROR, thing=flat, sky=SKY)
    first, second = (surfaces(scene, monkeypatch).smooth for _ in range(2))
    assert first is second and int((first.part == first.part[-1]).sum()) == 2
    positions = scene.get_parameter("thing.vertex_positions").data
    positions[:, 2] += 0.5
    assert surfaces(scene, monkeypatch).smooth is first
    positions[3, 2] += 0.5  # the square has a crease
    folded = surfaces(scene, monkeypatch).smooth
    assert folded is not first and int((folded.part == folded.part[-1]).sum()) == 1


def test_what_hangs_together_has_the_least_number_among_it():
    generator = torch.Generator().manual_seed(3)
    joints = torch.randint(200, (2, 150), generator=generator)
    label = list(range(200))
    for _ in range(200):
        for one, other in joints.T.tolist():
            label[one] = label[other] = min(label[one], label[other])
    assert 20 < len(set(label)) < 150 and connected(joints, 200).tolist() == label
    assert connected(joints[:, :0], 3).tolist() == [0, 1, 2]
