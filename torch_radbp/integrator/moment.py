"""The integrator `moment`: second moments of samples, from which variances follow."""

from __future__ import annotations

from torch_radbp.integrator.nested import Nesting
from torch_radbp.plugin import register


@register("integrator", "moment")
class Moment(Nesting):
    """The image of a nested integrator; beside it, as in Mitsuba, all its outputs and the image in CIE XYZ, and of each of
    these, under a name that begins with m2_, the mean square of the samples.
    """

    def outputs(self) -> dict[str, str]:
        first = {**self.nested_outputs(), **{name: "xyz" for name in self.integrators}}
        return {**first, **{f"m2_{name}": f"m2_{quantity}" for name, quantity in first.items()}}
