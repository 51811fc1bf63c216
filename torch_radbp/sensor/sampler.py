"""The sampler plugins."""

from __future__ import annotations

from torch_radbp.plugin import Sampler, boolean, integer, register


@register("sampler", "independent")
class Independent(Sampler):
    """Independent random numbers for every sample."""

    low_discrepancy = False


@register("sampler", "ldsampler")
class LowDiscrepancy(Sampler):
    """A low-discrepancy sequence for the samples of each pixel, and of pixels beside each other; the default of sensors.

    Unbiased for any number of samples, and best for powers of two. Different seeds and sensors are
    independent; pixels of one image are not: their noise cancels in what sums over them. See
    `torch_radbp.sampling.sampler`. Mitsuba's plugin of this name serves the same purpose with other numbers.
    """

    low_discrepancy = True


class Jittered(LowDiscrepancy):
    """Jittered sampling in Mitsuba; here the points of `ldsampler`.

    Args:
        sample_count: default number of samples per pixel. Mitsuba rounds it up to what its points can be; here it is kept.
        seed: added to the seed of a call.
        jitter: true; points that are the same in every pixel are not supported.
    """

    def __init__(self, *, sample_count: int = 4, seed: int = 0, jitter: bool = True):
        super().__init__(sample_count=sample_count, seed=seed)
        self.jitter = boolean("jitter", jitter)
        if not self.jitter:
            raise ValueError("jitter must be True, got False: the points of a pixel are always random; take it away")


@register("sampler", "stratified")
class Stratified(Jittered):
    """Stratified sampling in Mitsuba; here the points of `ldsampler`."""


@register("sampler", "multijitter")
class MultiJitter(Jittered):
    """Multi-jittered sampling in Mitsuba; here the points of `ldsampler`."""


@register("sampler", "orthogonal")
class Orthogonal(Jittered):
    """Orthogonal-array sampling in Mitsuba; here the points of `ldsampler`.

    Args:
        strength: of Mitsuba's points; without effect here.
    """

    def __init__(self, *, sample_count: int = 4, seed: int = 0, jitter: bool = True, strength: int = 2):
        super().__init__(sample_count=sample_count, seed=seed, jitter=jitter)
        self.strength = integer("strength", strength, least=1)
