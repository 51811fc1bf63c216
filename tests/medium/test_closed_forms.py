"""Images of media that are known in closed form, or by an integral of one variable.

Slabs seen at an angle, a furnace of every phase function, and half spaces: light scattered once, and, of isotropic
scattering, as often as it takes, by these and by slabs. Half spaces are slabs of great optical thickness.

References: Chandrasekhar 1960, "Radiative Transfer", sections 33 to 38 (H functions); Hapke 1981, "Bidirectional Reflectance
Spectroscopy 1. Theory", equation 35 (what a half space reflects of an even sky, 1 - sqrt(1 - albedo) H); Heaslet and
Warming 1965, "Radiative Transport and Wall Temperature Slip in an Absorbing Planar Medium" (what passes slabs).
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.special import expn
from torch import Tensor

import torch_radbp as rb
from tests.deep import deep
from tests.scenes import load, overhead, rgb
from tests.scenes.media import haze
from torch_radbp.io.values.transform import rotate, scale
from torch_radbp.plugin import REGISTRY

NULL = {"type": "null"}
ALBEDO = (0.5, 0.9, 0.7)
ANGLES = (0.0, 40.0, 60.0)  # between the view, from above, and the normal of a slab


def slab(thickness: float, angle: float, medium: dict) -> dict:
    """A wide box of a medium, whose normal is turned from +z about x, towards -y."""
    return {"type": "cube", "to_world": rotate((1, 0, 0), angle) @ scale((60, 60, thickness / 2)), "bsdf": NULL,
            "interior": medium}


def assert_mean(scene: rb.Scene, expected: Tensor, most: float = 0.01, renderings: int = 1, **settings) -> None:
    """The mean of an image is `expected`, (3,), by four standard errors, of which each is at most `most` of it.

    Pixels are independent, and have one expectation.
    """
    renderer = rb.Renderer(scene, **settings)
    pixels = torch.cat([renderer(seed=seed)[0].flatten(1).T for seed in range(renderings)]).double()
    mean, error = pixels.mean(0), pixels.std(0) / math.sqrt(len(pixels))
    assert (error < most * expected).all(), (error, expected)
    assert ((mean - expected).abs() < 4 * error + 1e-6).all(), (mean, expected, error)


@pytest.mark.parametrize("angle", ANGLES)
def test_a_slab_seen_at_an_angle_is_thicker_by_its_cosine(angle):
    sigma = (0.25, 0.5, 1.0)
    scene = load(torch.float64, camera=overhead(4, 9.0, 0.01), slab=slab(0.8, angle, haze(sigma, (0, 0, 0))),
                 sky={"type": "constant"})
    expected = torch.exp(-torch.tensor(sigma, dtype=torch.float64) * 0.8 / math.cos(math.radians(angle)))
    assert_mean(scene, expected, renderings=3, spp=4095, max_depth=2)


PHASES = {
    "isotropic": {}, "hg": {"g": 0.7}, "rayleigh": {}, "tabphase": {"values": "0.2, 0.1, 0, 0.4, 1.5"},
    "sggx": {"S": [0.9, 0.3, 0.5, 0.2, -0.1, 0.15]},
    "blendphase": {"weight": 0.3, "phase_0": {"type": "hg", "g": -0.5}, "phase_1": {"type": "rayleigh"}},
}


def test_every_phase_function_is_in_a_furnace():
    assert set(PHASES) == set(REGISTRY["phase"])


@pytest.mark.parametrize("names", [tuple(PHASES), *(deep((name,)) for name in PHASES)], ids=" ".join)
def test_in_a_furnace_no_phase_function_gains_or_loses_light(names):
    """In a ball of shells, each of a medium with one of them."""
    media = {f"in_{name}": {"type": "homogeneous", "sigma_t": rgb(0.8, 1.0, 1.5), "albedo": rgb(1, 1, 1),
                            "phase": {"type": name} | PHASES[name]} for name in names}
    outside, shells = {}, {}
    for number, medium in enumerate(media):
        within, radius = {"type": "ref", "id": medium}, 1.0 - 0.15 * number
        shells[f"shell_{number}"] = {"type": "sphere", "radius": radius, "bsdf": NULL, "interior": within, **outside}
        outside = {"exterior": within}
    scene = load(torch.float64, camera=overhead(4, 4.0, 0.5), sky={"type": "constant"}, **media, **shells)
    assert_mean(scene, torch.ones(3, dtype=torch.float64), spp=1536, max_depth=64, rr_depth=64)


PHASE = {0.0: lambda cosine: 0.25 / math.pi, 0.6: lambda cosine: 0.64 / (4 * math.pi * (1.36 - 1.2 * cosine)**1.5)}


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("g", PHASE)
def test_a_half_space_scatters_light_once_as_the_integral_says(g, angle):
    """Of a beam of irradiance E on a plane across it, albedo E p mu0 / (mu + mu0); the beam is aslant to the view, too."""
    turned = math.radians(angle)
    normal = np.array([0.0, -math.sin(turned), math.cos(turned)])
    beam = np.array([0.3, 0.1, -1.0]) / math.sqrt(1.1)
    mu, mu0, cosine = normal[2], -float(normal @ beam), float(beam[2])  # the view sees light that goes along +z
    scene = load(torch.float64, camera=overhead(4, 30.0, 0.01), slab=slab(20.0, angle, haze((2, 2, 2), ALBEDO, g)),
                 sun={"type": "directional", "direction": beam.tolist(), "irradiance": rgb(1, 1, 1)})
    expected = torch.tensor(ALBEDO, dtype=torch.float64) * PHASE[g](cosine) * mu0 / (mu + mu0)
    assert_mean(scene, expected, renderings=2, spp=3072, max_depth=2)


def h_function(albedo: float, mu: np.ndarray, count: int = 64) -> np.ndarray:
    """Chandrasekhar's H of isotropic scattering, by its integral equation, iterated at the places of a Gauss rule."""
    places, weights = np.polynomial.legendre.leggauss(count)
    places, weights = 0.5 * (places + 1), 0.5 * weights
    values = np.ones(count)

    def inverse(at):
        return math.sqrt(1 - albedo) + 0.5 * albedo * (weights * places * values / (at[:, None] + places)).sum(1)

    for _ in range(1000):
        values = 0.5 * (values + 1 / inverse(places))
    return 1 / inverse(mu)


def test_the_h_function_is_that_of_the_tables():
    """H(1) without absorption is 2.9078 (Chandrasekhar 1960, table XI), the mean of H 2 (1 - sqrt(1 - albedo)) / albedo."""
    assert h_function(1.0, np.ones(1)) == pytest.approx(2.9078, abs=2e-3)
    places, weights = np.polynomial.legendre.leggauss(48)
    for albedo in ALBEDO:
        mean = 0.5 * (weights * h_function(albedo, 0.5 * (places + 1))).sum()
        assert mean == pytest.approx(2 / albedo * (1 - math.sqrt(1 - albedo)), rel=1e-4)


@pytest.mark.parametrize("angle, rr_depth", [*((angle, 5) for angle in ANGLES), (40.0, 1000)])
def test_a_half_space_reflects_of_an_even_sky_what_chandrasekhar_says(angle, rr_depth):
    scene = load(torch.float64, camera=overhead(4, 30.0, 0.01), slab=slab(20.0, angle, haze((2, 2, 2), ALBEDO, 0.0)),
                 sky={"type": "constant"})
    mu = np.cos(np.radians([angle]))
    reflected = [1 - math.sqrt(1 - albedo) * h_function(albedo, mu)[0] for albedo in ALBEDO]
    expected = torch.tensor(reflected, dtype=torch.float64)
    assert_mean(scene, expected, spp=1536, max_depth=200, rr_depth=rr_depth)


def plane_albedo(albedo: float, thickness: float, mu: np.ndarray, count: int = 400) -> np.ndarray:
    """What a slab of isotropic scattering before a black plane reflects of a beam at each cosine `mu`, or, seen there, of an
    even sky of 1: by the integral equation of the source function, S = a/2 (E2 + integral of E1 S), even in each layer."""
    edges = np.linspace(0.0, thickness, count + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    above, below = (expn(2, np.abs(middles[:, None] - side)) for side in (edges[:-1], edges[1:]))
    kernel = np.where(middles[:, None] < edges[:-1], above - below, below - above)
    np.fill_diagonal(kernel, 2.0 - 2.0 * expn(2, 0.5 * thickness / count))
    source = np.linalg.solve(np.eye(count) - 0.5 * albedo * kernel, 0.5 * albedo * expn(2, middles))
    through = np.exp(-edges / mu[:, None])
    return ((through[:, :-1] - through[:, 1:]) * source).sum(1)


@pytest.mark.parametrize("thickness, passes", [(0.1, 0.9157), (0.5, 0.7040), (1.0, 0.5532), (2.0, 0.3900)])
def test_what_a_slab_reflects_is_that_of_the_tables(thickness, passes):
    """Without absorption what diffuse light is not reflected passes to the plane; by the tables, so much of it."""
    places, weights = np.polynomial.legendre.leggauss(32)
    places = 0.5 * (places + 1)
    assert (weights * places * plane_albedo(1.0, thickness, places)).sum() == pytest.approx(1 - passes, abs=3e-4)


@pytest.mark.parametrize("thickness, angle", [(0.5, 0.0), (2.0, 40.0), (2.0, 60.0)])
def test_a_slab_reflects_of_an_even_sky_what_its_integral_equation_says(thickness, angle):
    medium = haze((2, 2, 2), ALBEDO, 0)
    scene = load(torch.float64, camera=overhead(4, 30.0, 0.01), slab=slab(0.5 * thickness, angle, medium),
                 plane={"type": "rectangle", "to_world": rotate((1, 0, 0), angle) @ placed(-0.25 * thickness - 1e-3),
                        "bsdf": {"type": "diffuse", "reflectance": 0.0}}, sky={"type": "constant"})
    mu = np.cos(np.radians([angle]))
    expected = torch.tensor([plane_albedo(albedo, thickness, mu)[0] for albedo in ALBEDO], dtype=torch.float64)
    assert_mean(scene, expected, renderings=2, spp=3072, max_depth=200)


def placed(height: float) -> np.ndarray:
    """The pose of a wide rectangle at a height."""
    pose = scale((60, 60, 1))
    pose[2, 3] = height
    return pose


def test_an_empty_grid_lets_all_light_through():
    pose = scale((1, 1, 1))
    pose[:3, 3] = -0.5
    empty = {"type": "gridvolume", "data": torch.zeros(16, 16, 16), "to_world": pose}
    scene = load(torch.float64, camera=overhead(4, 4.0, 0.4), sky={"type": "constant"}, box={
        "type": "cube", "to_world": scale((0.5, 0.5, 0.5)), "bsdf": NULL,
        "interior": {"type": "heterogeneous", "sigma_t": empty, "albedo": 0.5}})
    assert_mean(scene, torch.ones(3, dtype=torch.float64), spp=3072, max_depth=2)
