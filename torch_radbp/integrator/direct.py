"""The integrator `direct`: path tracing to a depth of 2."""

from __future__ import annotations

import warnings

from torch_radbp.integrator.settings import IntegratorSettings
from torch_radbp.plugin import integer, register


@register("integrator", "direct")
class Direct(IntegratorSettings):
    """Emission and direct light, by next-event estimation and BSDF sampling with multiple importance sampling.

    Args:
        shading_samples: for both of the next two.
        emitter_samples: samples of lights for each camera ray: 1 is what is done, and 0 turns next-event estimation off.
            More are taken as 1, and a warning says so: the image is the same in expectation, `spp` makes it quieter.
        bsdf_samples: samples of the BSDF for each camera ray; 0, by which Mitsuba leaves out lights seen in mirrors, is not
            supported. More than 1 are taken as 1, likewise.

    Raises:
        ValueError: for numbers of samples that contradict each other, or are not supported.
    """

    max_depth = 2

    def __init__(self, *, shading_samples: int | None = None, emitter_samples: int | None = None,
                 bsdf_samples: int | None = None, hide_emitters: bool = False, block_size: int = 0,
                 samples_per_pass: int = -1, timeout: float = -1.0):
        super().__init__(hide_emitters=hide_emitters, block_size=block_size, samples_per_pass=samples_per_pass,
                         timeout=timeout)
        if shading_samples is not None and (emitter_samples is not None or bsdf_samples is not None):
            raise ValueError("shading_samples stands for both emitter_samples and bsdf_samples; give it, or them")
        self.shading_samples, self.emitter_samples, self.bsdf_samples = shading_samples, emitter_samples, bsdf_samples
        both = 1 if shading_samples is None else integer("shading_samples", shading_samples, 0)
        of_emitters, of_bsdf = (both if count is None else integer(name, count, 0) for name, count in
                                (("emitter_samples", emitter_samples), ("bsdf_samples", bsdf_samples)))
        if of_bsdf == 0:
            raise ValueError("bsdf_samples=0, sampling lights alone, is not supported: mirrors and glass would be black; "
                             "leave it out, and both are sampled, with the same expectation elsewhere")
        self.nee = of_emitters > 0
        if max(of_emitters, of_bsdf) > 1:
            warnings.warn(f"direct with {of_emitters} samples of emitters and {of_bsdf} of BSDFs takes one of each for "
                          "every camera ray: the image is the same in expectation; raise spp or sample_count to make it "
                          "quieter", stacklevel=2)

    def alpha(self) -> str:
        return "hit"
