"""The triangle of each texel: closed forms on the unit square, and an independent search for the closest points."""

import pytest
import torch

from torch_radbp.bake.texels import REACH, texels_of
from torch_radbp.optim.closest import closest_points

SQUARE = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), torch.tensor([[0, 1, 2], [0, 2, 3]])


def centres(height, width):
    v, u = torch.meshgrid(*((torch.arange(side).double() + 0.5) / side for side in (height, width)), indexing="ij")
    return torch.stack([u, v], 2)


def test_texels_of_a_square_are_where_their_centres_are():
    uv, faces = SQUARE
    texels = texels_of(uv, faces, 5, 7)
    torch.testing.assert_close(texels.of_vertices(uv.double(), faces), centres(5, 7), rtol=0, atol=1e-12)
    assert texels.shared == 0


def test_what_lies_beside_a_triangle_continues_its_plane_and_farther_away_repeats():
    """A column of triangles on the left quarter of the square."""
    uv, faces = SQUARE
    uv = uv * torch.tensor([0.25, 1.0])
    texels = texels_of(uv, faces, 32, 32)
    found, wanted = texels.of_vertices(uv.double(), faces), centres(32, 32)
    near = 8 + int(REACH)
    torch.testing.assert_close(found[:, :near], wanted[:, :near], rtol=0, atol=1e-12)
    torch.testing.assert_close(found[:, near:], wanted[:, 7:8].expand(-1, 32 - near, -1), rtol=0, atol=1e-12)


def test_a_triangle_without_a_centre_in_it_has_the_texel_of_its_middle():
    uv, faces = SQUARE
    small = torch.tensor([[0.71, 0.72], [0.715, 0.72], [0.71, 0.725]])
    uv, faces = torch.cat([uv * 0.5, small]), torch.cat([faces, torch.tensor([[4, 5, 6]])])
    texels = texels_of(uv, faces, 16, 16)
    row, column = (int(value) for value in (small.mean(0) * 16).floor().flip(0))
    assert texels.triangle[row, column] == 2
    torch.testing.assert_close(texels.weights.sum(2), torch.ones(16, 16, dtype=torch.float64))


def test_texels_in_several_triangles_are_counted():
    """A whole square, and a quarter of it once more."""
    uv, faces = SQUARE
    texels = texels_of(torch.cat([uv, 0.5 * uv]), torch.cat([faces, faces + 4]), 8, 8)
    assert texels.shared >= 12  # of the 16 in the quarter, those that lie on a diagonal may not be


def test_texels_agree_with_a_search_for_the_closest_points():
    """A fan of triangles with a hole, and a mirrored one: where the closest point of a texel is itself, it is inside."""
    generator = torch.Generator().manual_seed(0)
    angle = torch.arange(9) * (2 * torch.pi / 9)
    rim = 0.5 + 0.45 * torch.stack([angle.cos(), angle.sin()], 1) * (0.5 + 0.5 * torch.rand(9, 1, generator=generator))
    uv = torch.cat([rim, torch.tensor([[0.5, 0.5]])])
    faces = torch.tensor([[9, k, (k + 1) % 9] if k % 2 else [9, (k + 1) % 9, k] for k in range(9) if k != 4])
    texels, where = texels_of(uv, faces, 48, 40), centres(48, 40).view(-1, 2)
    flat = torch.nn.functional.pad(uv.double(), (0, 1))
    closest = closest_points(torch.nn.functional.pad(where, (0, 1)), flat, faces)
    distance = (closest.of_vertices(flat, faces)[:, :2] - where).norm(dim=1)
    inside = (closest.weights.min(1).values > 1e-6) & (distance < 1e-9)
    assert 200 < inside.sum() < 1500
    assert torch.equal(texels.triangle.view(-1)[inside], closest.triangle[inside])
    torch.testing.assert_close(texels.weights.view(-1, 3)[inside], closest.weights[inside], rtol=0, atol=1e-9)
    assert (texels.weights.view(-1, 3)[distance > 1e-3].min(1).values < 0).any()


def test_degenerate_coordinates_are_an_error():
    _, faces = SQUARE
    with pytest.raises(ValueError, match="all triangles are degenerate in surface coordinates"):
        texels_of(torch.zeros(4, 2), faces, 8, 8)
