"""The samplers of sensors: the same means, images and gradients, with less noise by default."""

from functools import cache

import pytest
import torch

from tests.gradients import image_and_gradients
from tests.scenes import cornell, sensor
from torch_radbp.plugin import REGISTRY

BATCHES = 24


@cache
def batches(kind: str | None):
    """(BATCHES, ...) images of a Cornell box, and the gradients of their sums by the colours of a wall and the lamp."""
    chosen = {} if kind is None else {"sampler": {"type": kind, "sample_count": 16}}
    names = ("white.reflectance.value", "light.emitter.radiance.value")
    scene = cornell(sensors={"camera": sensor(6, **chosen)})
    found = [image_and_gradients(scene, names, seed=seed, spp=16, max_depth=3, share_samples=True,
                                   adj_image=torch.ones(1, 3, 6, 6))
             for seed in range(BATCHES)]
    return torch.stack([image for image, _ in found]), torch.stack([torch.cat(gradients) for _, gradients in found])


def test_samplers_differ_in_noise_only():
    for points, independent in zip(batches("ldsampler"), batches("independent")):
        error = ((points.var(0) + independent.var(0)) / BATCHES).sqrt()
        z = (points.mean(0) - independent.mean(0)) / error.clamp_min(1e-12)
        assert independent.mean(0).abs().max() > 0 and z.abs().max() < 5
        assert points.std(0).mean() < 0.75 * independent.std(0).mean()


def test_points_of_low_discrepancy_are_the_default():
    for default, points in zip(batches(None), batches("ldsampler")):
        assert torch.equal(default, points)


@pytest.mark.parametrize("kind", ["stratified", "multijitter", "orthogonal"])
def test_samplers_of_other_even_points_have_those_of_low_discrepancy(kind):
    points, others = (cornell(sensors={"camera": sensor(6, sampler={"type": name, "sample_count": 9})})
                      for name in ("ldsampler", kind))
    names = ("white.reflectance.value",)
    assert torch.equal(*(image_and_gradients(scene, names, seed=1, max_depth=2)[0] for scene in (points, others)))
    with pytest.raises(ValueError, match="jitter must be True, got False"):
        cornell(sensors={"camera": sensor(6, sampler={"type": kind, "jitter": False})})


@pytest.mark.parametrize("kind", REGISTRY["sampler"])
def test_a_sampler_without_samples_is_refused(kind):
    with pytest.raises(ValueError, match="sample_count must be at least 1, got 0"):
        cornell(sensors={"camera": sensor(6, sampler={"type": kind, "sample_count": 0})})
