"""Running sums in one order: those of torch, and sorted."""

import pytest
import torch

from torch_radbp.sampling import running_sum as module
from torch_radbp.sampling.running_sum import running_sum


@pytest.fixture
def in_one_order(monkeypatch):
    """As on a GPU where torch is told to be deterministic."""
    monkeypatch.setattr(torch, "are_deterministic_algorithms_enabled", lambda: True)
    monkeypatch.setattr(module, "sums_in_any_order", lambda device: True)
    monkeypatch.setattr(torch.Tensor, "cumsum", None)


@pytest.mark.parametrize("shape, dim", [((1,), 0), ((2,), 0), ((1000,), 0), ((7, 33), 1), ((33, 5), 0)])
def test_sums_are_those_of_torch(shape, dim, request):
    weights = torch.rand(shape, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    expected = torch.cumsum(weights, dim)
    request.getfixturevalue("in_one_order")
    torch.testing.assert_close(running_sum(weights, dim), expected, rtol=1e-14, atol=0)


def test_sums_of_weights_of_all_sizes_are_sorted(in_one_order):
    weights = 10 ** (40 * torch.rand(5000, generator=torch.Generator().manual_seed(5), dtype=torch.float64) - 30)
    weights[::3] = 0
    assert (running_sum(weights).diff() >= 0).all()
