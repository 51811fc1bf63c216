"""The samplers of sensors."""

from __future__ import annotations

from torch_radbp.plugin import Sampler, register


@register("sampler", "independent")
class Independent(Sampler):
    """Independent random numbers for every sample. Arguments: see `Sampler`."""

    low_discrepancy = False


@register("sampler", "ldsampler")
class LowDiscrepancy(Sampler):
    """A low-discrepancy sequence in each pixel; the default of sensors. Arguments: see `Sampler`.

    Unbiased for any number of samples, and best for powers of two. Different pixels and seeds are independent. See
    `torch_radbp.sampling.sampler`. Mitsuba's plugin of this name serves the same purpose with other numbers.
    """

    low_discrepancy = True
