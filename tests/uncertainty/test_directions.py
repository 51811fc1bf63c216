"""Words for directions that images do not tell."""

import torch

from torch_radbp.uncertainty.directions import in_words, sparse_basis

NAMES = ["colour", "light", "gain"]


def words(change: list[float], values: list[float]) -> str:
    return in_words(torch.tensor(change).double(), torch.tensor(values).double(), NAMES, torch.ones(3).double())


def test_pairs():
    assert words([0.5, -1.0, 0], [0.5, 1.0, 3.0]) == "colour and light only as a product"
    assert words([0.5, 1.0, 0], [0.5, 1.0, 3.0]) == "colour and light only as a ratio"
    assert words([1.0, -1.0, 0], [0.0, 2.0, 3.0]) == "colour and light only as a sum"
    assert words([1.0, 1.0, 0], [0.0, 2.0, 3.0]) == "colour and light only as a difference"
    assert words([0.5, -2.0, 0], [1.0, 1.0, 3.0]) == "colour and light only as the first times the second to the power 0.25"
    assert words([1.0, -0.4, 0], [0.0, 2.0, 3.0]) == "colour and light only but for +1 of the first and -0.4 of the second"


def test_one_and_three():
    assert words([0, 0, 1.0], [1.0, 1.0, 1.0]) == "gain is not seen at all"
    assert words([1.0, -2.0, 3.0], [1.0, 2.0, 3.0]) == "colour and gain up and light down by one factor make the same images"
    assert words([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]) == "colour and light and gain by one factor make the same images"
    assert words([1.0, -0.5, 0.5], [1.0, 2.0, 3.0]) == "+1 colour -0.5 light +0.5 gain makes the same images"


def test_mixed_directions_are_told_apart():
    """Two pairs, of which eigenvectors may be any rotation."""
    pairs = torch.tensor([[1.0, 0], [-1.0, 0], [0, 1.0], [0, 1.0]]).double() / 2 ** 0.5
    turned = pairs @ torch.tensor([[0.6, 0.8], [-0.8, 0.6]]).double()
    basis = sparse_basis(turned)
    assert sorted((basis != 0).sum(0).tolist()) == [2, 2]
    assert torch.linalg.matrix_rank(torch.cat([basis, pairs], 1)) == 2
