"""Media that emit light: closed forms and integrals; the gradient of every strategy, stride and way of running against the
tape's; forward mode; differences, also where extinction or emission is 0."""

from __future__ import annotations

import math

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import EXACT, REPLAY, assert_informative, assert_transposed, image_and_gradients, relative_error
from tests.rendering.taped import assert_recorded_alike
from tests.scenes import load, overhead, rgb
from tests.scenes.smoke import MOVING, NAMES, SETTINGS, box, grid, placed, room, varied

KINDS = ("homogeneous", "heterogeneous")
E, SIGMA, LENGTH = (0.5, 1.0, 2.0), (0.7, 0.35, 1.4), 2.0
EMISSION = "box.interior.emission"


def glowing(kind: str, sigma=SIGMA, emission=E, albedo: float = 0.0, **more) -> dict:
    """A medium that is the same everywhere."""
    even = torch.tensor(sigma, dtype=torch.float64).expand(9, 5, 12, 3).contiguous()
    sigma_t = rgb(*sigma) if kind == "homogeneous" else {"type": "gridvolume", "data": even, "to_world": placed()}
    return {"type": kind, "albedo": albedo, "sigma_t": sigma_t, "emission": rgb(*emission), **more}


def alone(medium: dict):
    """A box of it, of which a camera from afar sees the middle; there is no other light."""
    return load(torch.float64, camera=overhead(2, 40.0, 0.04), box=box(medium))


def means(scene, batches: int = 8, **settings) -> torch.Tensor:
    """(B, 3) the mean colours of independent images."""
    return torch.stack([rb.render(scene, seed=seed, **settings).mean((0, 2, 3)) for seed in range(batches)])


def assert_mean(samples: torch.Tensor, wanted, most: float = 0.02) -> None:
    """The mean of batches is as wanted, and known well enough to tell. Rays begin a little off surfaces: by 1e-5 at most."""
    wanted = torch.as_tensor(wanted, dtype=samples.dtype)
    error = samples.std(0) / math.sqrt(len(samples))
    assert bool((wanted != 0).all()) and bool((error < most * wanted.abs()).all())
    assert bool(((samples.mean(0) - wanted).abs() <= 4 * error + 1e-5 * wanted.abs()).all()), samples.mean(0)


@pytest.mark.parametrize("compile", [deep(False, id="eager"), pytest.param(True, id="compiled")])
@pytest.mark.parametrize("depth", [1, 3], ids=["last", "flies"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_slab_that_absorbs_emits_what_the_integral_says(kind, depth, compile):
    """e (1 - exp(-sigma l)) / sigma."""
    wanted = [e * (1 - math.exp(-s * LENGTH)) / s for e, s in zip(E, SIGMA)]
    assert_mean(means(alone(glowing(kind)), spp=2048, max_depth=depth, compile=compile), wanted)


@pytest.mark.parametrize("depth", [1, 3], ids=["last", "flies"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_slab_that_absorbs_nothing_emits_by_its_length(kind, depth):
    samples = means(alone(glowing(kind, (0.0, 0.0, 0.0))), spp=2048, max_depth=depth)
    assert_mean(samples, [e * LENGTH for e in E])


def test_of_one_colour_an_even_medium_emits_without_noise():
    image = rb.render(alone(glowing("homogeneous", (0.7, 0.7, 0.7))), spp=4, max_depth=1, seed=1)
    wanted = torch.tensor(E, dtype=torch.float64) * (1 - math.exp(-0.7 * LENGTH)) / 0.7
    torch.testing.assert_close(image, wanted[:, None, None].expand(1, 3, 2, 2), rtol=1e-5, atol=0)


def flame(emission=None, kind: str = "heterogeneous") -> dict:
    """Smoke, or fog, that glows from point to point; nowhere without extinction, since replay is wrong there."""
    if emission is None:
        emission = {"type": "gridvolume", "data": 1.5 * grid(3, (4, 6, 5)), "to_world": placed()}
    if kind == "heterogeneous":
        dense = {"type": "gridvolume", "data": 0.1 + grid(3), "to_world": placed()}
        return {**varied(3), "sigma_t": dense, "emission": emission}
    return {"type": kind, "albedo": rgb(0.9, 0.6, 0.3), "sigma_t": rgb(0.7, 0.4, 0.9), "scale": 2.0, "emission": emission,
            "phase": {"type": "hg", "g": 0.4}}


def both(kind: str) -> list[str]:
    own = {"heterogeneous": ["sigma_t.data", "albedo.data"], "homogeneous": ["sigma_t.value.value", "albedo.value.value"]}
    return [f"{EMISSION}.data", *(f"box.interior.{name}" for name in own[kind]), *NAMES[2:]]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_every_strategy_and_stride_gives_the_gradient_of_the_tape(compile, kind):
    names, scene = both(kind), room(flame(kind=kind))
    image, expected = image_and_gradients(scene, names, **SETTINGS | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    for adjoint in (*EXACT[:-1], *REPLAY):
        found, gradients = image_and_gradients(scene, names, compile=compile, **SETTINGS | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(names, gradients, expected):
            assert relative_error(gradient, wanted) < 1e-10, (adjoint, name)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", range(3), ids=["emission", "extinction", "albedo"])
def test_forward_mode_is_the_transpose_of_backward(number, kind):
    assert_transposed(room(flame(kind=kind)), both(kind)[number], **SETTINGS | {"compile": True})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sampling", deep_but(["hybrid"], ["detached", "hybrid", "attached"]))
@pytest.mark.parametrize("compile", [deep(False, id="eager"), pytest.param(True, id="compiled")])
def test_every_strategy_gives_the_gradient_of_the_tape_of_what_moves(compile, sampling, kind):
    names, settings = [*MOVING, *both(kind)[:3]], SETTINGS | {"sampling": sampling}
    scene = room(flame(kind=kind), half=0.9)
    image, expected = image_and_gradients(scene, names, **settings | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    for adjoint in (rb.MemoizedAdjoint(1), rb.MemoizedAdjoint("log", keep_hits=False), rb.QuadraticAdjoint(), *REPLAY):
        found, gradients = image_and_gradients(scene, names, compile=compile, **settings | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(names, gradients, expected):
            assert (gradient - wanted).abs().max() <= 1e-10 * wanted.abs().max(), (adjoint, name)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", MOVING)
def test_forward_mode_is_the_transpose_of_backward_of_what_moves(name, kind):
    assert_transposed(room(flame(kind=kind), half=0.9), name, **SETTINGS | {"terms": ("interior",), "compile": True})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("settings", [{}, {"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)}, {"chunk": 40},
                                      {"nee": False, "spp": 99}], ids=str)
def test_bounces_that_are_recorded_have_the_bits_of_single_operations(settings, kind, monkeypatch):
    assert_recorded_alike(lambda: room(flame(kind=kind)).to(torch.float32), both(kind), monkeypatch, **SETTINGS | settings)
