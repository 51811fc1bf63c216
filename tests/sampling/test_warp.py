"""Each mapping from the unit square against its density: chi-square over cells of its range (Subr and Arvo 2007)."""

import math

import numpy as np
import pytest
import torch

from torch_radbp.bsdf.diffuse import DiffuseKind
from torch_radbp.check.chi_square import SIGNIFICANCE, p_value
from torch_radbp.sampling.warp import (
    UNIFORM_SPHERE_PDF,
    cosine_hemisphere_pdf,
    square_to_cosine_hemisphere,
    square_to_uniform_sphere,
    square_to_uniform_triangle,
)
from torch_radbp.tensors.vec import Vec3

DIFFUSE, WHITE = DiffuseKind(), (Vec3(*torch.ones(3, 1, dtype=torch.float64)),)
COUNT = 200_000
CELLS = (16, 32)  # cosine of the polar angle, azimuth


def square(dtype=torch.float64):
    generator = torch.Generator().manual_seed(7)
    return torch.rand(2, COUNT, generator=generator, dtype=dtype).unbind()


def directions(pdf) -> np.ndarray:
    """Expected samples per cell of the sphere: the density integrated by 8 x 8 midpoints a cell."""
    fine = 8
    z = -1 + 2 * (np.arange(CELLS[0] * fine) + 0.5) / (CELLS[0] * fine)
    phi = 2 * math.pi * (np.arange(CELLS[1] * fine) + 0.5) / (CELLS[1] * fine)
    z, phi = (torch.from_numpy(a) for a in np.meshgrid(z, phi, indexing="ij"))
    r = torch.sqrt(1 - z * z)
    density = pdf(Vec3(r * torch.cos(phi), r * torch.sin(phi), z))
    cell = 4 * math.pi / (CELLS[0] * CELLS[1] * fine**2)
    return COUNT * cell * density.reshape(CELLS[0], fine, CELLS[1], fine).sum((1, 3)).numpy()


def histogram(w: Vec3) -> np.ndarray:
    phi = torch.atan2(w.y, w.x) % (2 * math.pi)
    return np.histogram2d(w.z.numpy(), phi.numpy(), CELLS, [(-1, 1), (0, 2 * math.pi)])[0]


def diffuse_sample(u, v) -> Vec3:
    viewer = Vec3(torch.zeros_like(u), torch.zeros_like(u), torch.ones_like(u))
    return DIFFUSE.sample((), viewer, DIFFUSE.choose((), viewer, u, u, v), u, v)


def below(wi_z):
    return lambda w: DIFFUSE.pdf(WHITE, Vec3(torch.zeros_like(w.x), torch.zeros_like(w.x), torch.full_like(w.x, wi_z)), w)


SPHERICAL = {
    "cosine_hemisphere": (square_to_cosine_hemisphere, cosine_hemisphere_pdf),
    "diffuse": (diffuse_sample, below(0.3)),
    "uniform_sphere": (square_to_uniform_sphere, lambda w: torch.full_like(w.z, UNIFORM_SPHERE_PDF)),
}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("sample, pdf", SPHERICAL.values(), ids=SPHERICAL)
def test_directions_follow_their_density(sample, pdf, dtype):
    w = sample(*square(dtype))
    expected = directions(pdf)
    assert abs(expected.sum() / COUNT - 1) < 1e-3  # the density is one: midpoints of a linear function
    torch.testing.assert_close(w.x**2 + w.y**2 + w.z**2, torch.ones(COUNT, dtype=dtype), rtol=0, atol=1e-6)
    assert p_value(histogram(w), expected) > SIGNIFICANCE


def test_the_test_notices_a_wrong_density():
    w = square_to_cosine_hemisphere(*square())
    wrong = directions(lambda v: cosine_hemisphere_pdf(v) * (1 + 0.05 * v.x))  # five per cent, to one side
    assert p_value(histogram(w), wrong) < SIGNIFICANCE


def test_triangles_are_covered_uniformly():
    b = square_to_uniform_triangle(*square())
    assert (b.x >= 0).all() and (b.y >= 0).all() and (b.x + b.y <= 1 + 1e-12).all()
    cells = 12
    observed = np.histogram2d(b.x.numpy(), b.y.numpy(), cells, [(0, 1), (0, 1)])[0]
    row, column = np.mgrid[:cells, :cells]
    share = np.where(row + column < cells - 1, 1.0, np.where(row + column == cells - 1, 0.5, 0.0))  # of a cell inside
    assert p_value(observed, COUNT * share / share.sum()) > SIGNIFICANCE


def test_corners_of_the_square_are_mapped_to_finite_values():
    largest = 1 - 2.0**-24
    for u in (0.0, largest):
        for v in (0.0, largest):
            for dtype in (torch.float32, torch.float64):
                numbers = torch.tensor([u], dtype=dtype), torch.tensor([v], dtype=dtype)
                w = square_to_cosine_hemisphere(*numbers)
                assert torch.isfinite(w.stack()).all() and w.z > 0 and DIFFUSE.pdf(WHITE, w, w) > 0
                assert torch.isfinite(square_to_uniform_sphere(*numbers).stack()).all()


def test_a_diffuse_surface_reflects_what_its_reflectance_says():
    """White furnace: the mean of eval / pdf is the reflectance, here on every sample."""
    wo = diffuse_sample(*square())
    wi = Vec3(torch.full_like(wo.x, 0.6), torch.zeros_like(wo.x), torch.full_like(wo.x, 0.8))
    colour = Vec3(*(torch.full_like(wo.x, value) for value in (0.0, 0.5, 1.0)))
    weight = DIFFUSE.eval((colour,), wi, wo).stack() / DIFFUSE.pdf(WHITE, wi, wo)[:, None]
    torch.testing.assert_close(weight, torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64).expand_as(weight))


def test_a_diffuse_surface_is_reciprocal_and_black_below_the_horizon():
    a, b = diffuse_sample(*square()), diffuse_sample(*(1 - u for u in square()))
    colour = Vec3(*(torch.full_like(a.x, value) for value in (0.2, 0.5, 1.0)))
    forwards = DIFFUSE.eval((colour,), a, b).stack() / b.z[:, None]
    backwards = DIFFUSE.eval((colour,), b, a).stack() / a.z[:, None]
    assert forwards.max() > 0
    torch.testing.assert_close(forwards, backwards)
    down = a._replace(z=-a.z)
    for wi, wo in ((a, down), (down, a), (down, down)):
        assert DIFFUSE.eval((colour,), wi, wo).stack().abs().max() == 0 and DIFFUSE.pdf(WHITE, wi, wo).abs().max() == 0
