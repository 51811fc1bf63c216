"""The sampler of a sensor."""

from __future__ import annotations

from torch_radbp.plugin import Sampler, register


@register("sampler", "independent")
class Independent(Sampler):
    """Independent random numbers.

    Args:
        sample_count: default number of samples per pixel.
        seed: added to the seed of a call.
    """

    def __init__(self, *, sample_count: int = 4, seed: int = 0):
        super().__init__()
        if sample_count < 1:
            raise ValueError(f"sample_count must be at least 1, got {sample_count}")
        self.sample_count, self.seed = sample_count, seed
