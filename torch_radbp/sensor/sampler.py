"""The samplers of sensors."""

from __future__ import annotations

from torch_radbp.plugin import Sampler, register


@register("sampler", "independent")
class Independent(Sampler):
    """Independent random numbers for every sample. Args as for every sampler."""

    low_discrepancy = False


@register("sampler", "ldsampler")
class LowDiscrepancy(Sampler):
    """Samples of a pixel that keep out of each other's way; the default of sensors. Args as for every sampler.

    Without bias for any number of samples, best for powers of two. Different pixels and seeds are independent. See
    `torch_radbp.sampling.sampler`. Mitsuba's plugin of this name differs in the numbers, not in the purpose.
    """

    low_discrepancy = True
