"""Which edges are looked at from which points: each pair counts once in the mean, few edges are seen by many."""

import pytest
import torch

from torch_radbp.boundary.shadows.pairing import filled_to, pairing_of
from torch_radbp.sampling.sampler import SampleKey

SIZES = (4, 300, 12)  # edges of bodies


def pairs_of(seed: int, eyes: int, examined: int):
    """Edges, eyes and times of all pairs that there are."""
    body = torch.repeat_interleave(torch.tensor((7, 2, 9)), torch.tensor(SIZES)).int()
    key = SampleKey(torch.tensor(seed, dtype=torch.int32), torch.zeros((), dtype=torch.int32))
    pairing = pairing_of(torch.tensor(1.0, dtype=torch.float64), body, eyes, key, examined)
    edge, eye, exists, times = pairing(torch.arange(len(pairing.body), dtype=torch.int32))
    return edge[exists], eye[exists], times[exists]


@pytest.mark.parametrize("eyes, examined", [(40, 800), (40, 1 << 20), (7, 100)])
def test_every_pair_counts_once_in_the_mean(eyes, examined):
    total, largest, seeds = torch.zeros(sum(SIZES), eyes, dtype=torch.float64), 0.0, 3000
    for seed in range(seeds):
        edge, eye, times = pairs_of(seed, eyes, examined)
        total.index_put_((edge.long(), eye.long()), times, accumulate=True)
        largest = max(largest, float(times.max()))
    mean, variance = total / seeds, (largest - 1) / seeds  # of a pair that is there with the probability 1 / largest
    assert ((mean - 1).abs() <= 6 * variance**0.5).all()
    assert ((mean.mean(1) - 1).abs() <= 6 * (variance / eyes) ** 0.5).all()


def test_bodies_of_few_edges_are_seen_by_all_and_others_by_some():
    edge, eye, times = pairs_of(1, 40, 800)
    assert len(edge) <= 2 * 800
    for first, count in ((0, 4), (304, 12)):
        own = (edge >= first) & (edge < first + count)
        assert int(own.sum()) >= 40 * count * 0.4 and float(times[own].max()) <= 2.5
    large = (edge >= 4) & (edge < 304)
    assert len(eye[large].unique()) >= 16 and float(times[large].max()) > 10


def test_what_there_is_is_shared_out():
    wanted = torch.tensor([5.0, 100.0, 40.0], dtype=torch.float64)
    assert filled_to(wanted, 1000.0) == 100  # all have what they want
    assert filled_to(wanted, 105.0) == 60  # 5, 40, 60
    assert filled_to(wanted, 65.0) == 30  # 5, 30, 30
    assert filled_to(wanted, 9.0) == 3
