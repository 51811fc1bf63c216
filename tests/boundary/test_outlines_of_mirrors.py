"""Beside their outlines smooth bodies reflect what lies beyond: rays that interpolated normals turn below a triangle run
along it, instead of into the body. So nothing jumps where that begins."""

import pytest
import torch

import torch_radbp as rb
from benchmarks import caustic_noise
from tests.scenes import load, sensor
from torch_radbp.boundary.terms import curves, reflections, scans

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

MIRROR = {"type": "twosided", "bsdf": {"type": "conductor", "material": "none"}}
CORNERS = 37 * 37  # of the pixels of that room and of those beside them, as far as the filter reaches
WIDTH = 1.4e-4  # by which triangles of a sphere lie off it, as a share of its radius


def beside_the_outline(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Parallel rays that pass the axis of the unit sphere at distances around its radius."""
    generator = torch.Generator().manual_seed(1)
    turn = 2.0 * torch.pi * torch.rand(count, generator=generator, dtype=torch.float64)
    away = 1.0 - 2.0 * WIDTH * torch.rand(count, generator=generator, dtype=torch.float64)
    origins = torch.stack([away * turn.cos(), torch.full_like(turn, -5.0), away * turn.sin()], 1)
    return origins, torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64).expand(count, 3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_a_mirror_ball_under_an_even_sky_is_not_seen(dtype):
    """At a distance of half a strip from the outline nearly every other ray was led into the ball."""
    scene = load(dtype, sensor=sensor(8, (0, 0, 5), (0, 0, 0), 40), sky={"type": "constant", "radiance": 1.0},
                 ball={"type": "sphere", "bsdf": MIRROR})
    origins, directions = (part.to(dtype) for part in beside_the_outline(4000))
    renderer = rb.Renderer(scene, spp=1, max_depth=4)
    met = renderer.radiance(origins, directions, seed=1)
    assert torch.allclose(met, torch.ones_like(met), rtol=1e-5)


def ball_in_a_room(bsdf: dict) -> dict:
    """The description of a ball over a floor, under a lamp."""
    return caustic_noise.room(lamp=caustic_noise.ABOVE, ball=caustic_noise.ball([0, 0, 0.7], 0.5, bsdf=bsdf))


def kinds_of_curves(monkeypatch, bsdf: dict) -> list[int]:
    """The kinds of curves that scans cross of what a ball shows whose place is differentiated."""
    found, jumping = [], reflections.jumping

    def noted(*arguments):
        result = jumping(*arguments)
        found.extend([] if result is None else result.curves.kind.tolist())
        return result

    with monkeypatch.context() as patched:
        patched.setattr(reflections, "jumping", noted)
        scene = rb.load_dict(ball_in_a_room(bsdf))
        scene.ball.to_world.requires_grad_()
        rb.render(scene, spp=64, seed=1, terms=("primary",), light_paths="camera").mean().backward()
    return found


@pytest.mark.parametrize("bsdf", [caustic_noise.PLASTIC, caustic_noise.MIRROR, caustic_noise.GLASS],
                         ids=lambda bsdf: bsdf["type"])
def test_what_a_ball_reflects_ends_nowhere_before_its_outline(bsdf, monkeypatch):
    """Of a coat a few dozen places of this kind had most of the noise of all that moves with it."""
    found = kinds_of_curves(monkeypatch, bsdf)
    assert found.count(curves.EDGE) > 50 and curves.HORIZON not in found


def test_corners_of_pixels_see_the_same_together_as_in_turns(monkeypatch):
    """Where corners are so many that they would not be looked at together, they are in as many turns as fit."""
    passes, weights, corner_passes, pixel_weights = [], [], scans.corner_passes, scans.pixel_weights
    monkeypatch.setattr(scans, "corner_passes", lambda *arguments: passes.append(arguments[1]) or corner_passes(*arguments))
    monkeypatch.setattr(scans, "pixel_weights", lambda *arguments: weights.append(pixel_weights(*arguments)) or weights[-1])
    scene = rb.load_dict(ball_in_a_room(caustic_noise.PLASTIC))
    scene.ball.to_world.requires_grad_()
    for together in (scans.CORNERS, 3 * CORNERS, 1):
        monkeypatch.setattr(scans, "CORNERS", together)
        rb.render(scene, spp=64, seed=1, max_depth=3, light_paths="camera").mean().backward()
    assert [len(turns) for turns in passes] == [4, 3, 1, 1, 1, 1, 1]
    assert weights[0].max() > 0.2 and all(torch.equal(weights[0], own) for own in weights[1:])
