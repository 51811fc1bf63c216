"""What `benchmarks.caustic_noise` measures."""

import pytest
import torch

from benchmarks.caustic_noise import FLOOR, SCENES, Samples, Way, measured


def test_cost_is_variance_times_seconds():
    way = Way(*SCENES["glossy ball"], "camera", ("interior",))
    way.samples = Samples([torch.tensor([1.0, 5.0]), torch.tensor([3.0, 5.0])], [[torch.tensor(2.0)], [torch.tensor(6.0)]],
                          [0.5, 0.5])
    assert way.costs() == [1.0, 4.0]
    mean, variance = way.derivative()
    assert mean.tolist() == [4.0] and variance.tolist() == [4.0]


@pytest.mark.filterwarnings("ignore")
def test_ways_differ_in_who_brings_the_light_not_in_what_they_bring():
    description, names = SCENES["glossy ball"]
    found = measured(description, names, ("camera", "caustics"), 3, ("interior",), "")
    images = [torch.stack(way.samples.images).mean() for way in found.values()]
    assert images[0] > 0 and abs(images[1] / images[0] - 1) < 0.1
    floor = names.index(FLOOR)
    sums = [way.derivative()[0][floor] for way in found.values()]
    assert sums[0] > 0 and abs(sums[1] / sums[0] - 1) < 0.2
    assert not torch.equal(*(way.samples.images[0] for way in found.values()))
