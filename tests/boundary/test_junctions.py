"""A vertex on an edge of another triangle: the surface goes on there, and no image jumps."""

import pytest
import torch

from tests.boundary.closed_forms import DARK, GLOW, JUMP, SIZE, along, assert_close, derivative, parallel
from tests.scenes import load
from torch_radbp.boundary.curve.edges import edges_of

# A square whose left half is one rectangle; the right half is several, one above the other.
HALF = 0.55
LEFT = [[-1, -1, 0], [0, -1, 0], [0, 1, 0], [-1, 1, 0]]


def square(steps: int, gap: float = 0.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Vertices and triangles: a half of 2 triangles that meets one of 2 `steps`, at a distance of `gap`."""
    vertices, faces = [list(map(float, place)) for place in LEFT], [[0, 1, 2], [0, 2, 3]]
    for step in range(steps):
        low, high = 2 * step / steps - 1, 2 * (step + 1) / steps - 1
        faces += [[len(vertices) + corner for corner in triangle] for triangle in ([0, 1, 2], [0, 2, 3])]
        vertices += [[gap, low, 0], [1, low, 0], [1, high, 0], [gap, high, 0]]
    return torch.tensor(vertices), torch.tensor(faces)


def turned(vertices: torch.Tensor) -> torch.Tensor:
    """In some direction, some way off the origin."""
    axes = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(4)))[0]
    return vertices @ axes + torch.tensor([3.0, -2.0, 5.0])


@pytest.mark.parametrize("steps", [1, 2, 3, 50])
@pytest.mark.parametrize("place", [lambda vertices: vertices, turned], ids=["axes", "turned"])
def test_only_the_outline_of_a_square_is_border(steps, place):
    vertices, faces = square(steps)
    edges = edges_of(place(vertices), faces)
    meeting = edges.count
    # Left three edges, on the right `steps`, above and below one each; inside a diagonal of each rectangle, `steps` pieces
    # of the edge in the middle, and what is between the rectangles on the right.
    assert (meeting == 1).sum() == 3 + steps + 2
    assert (meeting == 2).sum() == 1 + steps + steps + (steps - 1) and meeting.max() == 2
    for opposite, corner in zip(edges.opposite, edges.corner):  # in the very triangles
        assert torch.equal(vertices[opposite], vertices[faces.reshape(-1)[corner]])


def test_the_pieces_of_an_edge_lie_on_it_end_to_end():
    vertices, faces = square(7)
    edges = edges_of(turned(vertices), faces)
    a, b = vertices[edges.a], vertices[edges.b]
    middle = (a[:, 0] == 0) & (b[:, 0] == 0)
    spans = torch.stack([a[middle, 1], b[middle, 1]]).sort(0).values
    spans = spans[:, spans[0].argsort()]
    assert middle.sum() == 7 and torch.equal(spans[0, 1:], spans[1, :-1])
    assert spans[0, 0] == -1 and spans[1, -1] == 1


def test_a_gap_is_two_borders():
    vertices, faces = square(2, gap=1e-3)
    assert (edges_of(vertices, faces).count == 1).sum() == 3 + 2 + 2 + 1 + 2


def test_a_square_moves_as_a_whole():
    """Before the dark, parallel to the film: moved to the right, its left border darkens and its right one brightens. Pixels
    are counted by their columns, so that both do not cancel, and an edge in the middle would show."""
    vertices, faces = square(2)
    scene = load(camera=parallel(), sky=DARK,
                 square={"type": "mesh", "vertex_positions": HALF * vertices, "faces": faces, **GLOW})
    weight = torch.zeros(SIZE, SIZE, dtype=torch.float64)
    weight[:, :SIZE // 2 + 2] = 1.0  # the left border and the middle
    assert_close(derivative(scene, "square.to_world", along(0), weight, spp=256), -JUMP * HALF * SIZE / (2 / SIZE), 0.03)
