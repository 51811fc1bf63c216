"""The integrator `aov`: AOVs beside an image."""

from __future__ import annotations

from torch_radbp.integrator.nested import Nesting
from torch_radbp.plugin import Integrator, nearest, register

QUANTITIES = ("albedo", "depth", "position", "uv", "geo_normal", "sh_normal", "dp_du", "dp_dv", "prim_index", "shape_index")
MISSING = ("duv_dx", "duv_dy")  # of Mitsuba's


@register("integrator", "aov")
class ArbitraryOutputVariables(Nesting):
    """The image of a nested integrator, and outputs beside it: `renderer.aovs()` gives those that are listed here.

    Args:
        aovs: name:quantity pairs, separated by commas: `dd.y:depth,nn:sh_normal`.

    Raises:
        ValueError: if a pair is none, a quantity is not known, or a name is given twice.
    """

    def __init__(self, *, aovs: str, integrators: dict[str, Integrator] | None = None, hide_emitters: bool = False,
                 block_size: int = 0, samples_per_pass: int = -1, timeout: float = -1.0):
        super().__init__(integrators=integrators, hide_emitters=hide_emitters, block_size=block_size,
                         samples_per_pass=samples_per_pass, timeout=timeout)
        self.aovs = aovs
        self.listed = _listed(aovs)

    def outputs(self) -> dict[str, str]:
        return {**self.nested_outputs(), **dict(self.listed)}


def _listed(aovs: str) -> tuple[tuple[str, str], ...]:
    """Parses a list of AOVs such as "dd.y:depth,nn:sh_normal"; raises ValueError as the class says."""
    pairs: dict[str, str] = {}
    for item in aovs.replace(",", " ").split():
        name, colon, quantity = item.rpartition(":")
        if not name or not colon or not quantity:
            raise ValueError(f"aovs must be name:quantity pairs separated by commas, such as \"dd:depth,nn:sh_normal\", got "
                             f"{item!r}; known quantities: {', '.join(sorted(QUANTITIES))}")
        if quantity not in QUANTITIES:
            problem = "is not supported" if quantity in MISSING else "is not known"
            raise ValueError(f"aovs: the quantity {quantity!r} of {name!r} {problem}; {nearest(quantity, QUANTITIES)}")
        if name in pairs:
            raise ValueError(f"aovs: the name {name!r} is given twice; use another")
        pairs[name] = quantity
    return tuple(pairs.items())
