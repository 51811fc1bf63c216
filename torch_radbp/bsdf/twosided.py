"""A one-sided material, or two, seen from both sides of a surface."""

from __future__ import annotations

from torch_radbp.plugin import BSDF, register


@register("bsdf", "twosided")
class TwoSided(BSDF):
    """Uses `brdf_0` on the side of the normal, and `brdf_1` or, without one, `brdf_0` again on the other.

    Raises:
        ValueError: unless one or two one-sided BSDFs are given.
    """

    def __init__(self, *, brdf: list[BSDF]):
        super().__init__()
        if not 1 <= len(brdf) <= 2 or any(isinstance(side, TwoSided) for side in brdf):
            raise ValueError(f"twosided takes one or two one-sided BSDFs, got {[side.type for side in brdf]}")
        for side in brdf:
            if side.kind().transmits:
                raise ValueError(f"twosided takes BSDFs that only reflect, got {side.type!r}, which has two sides already")
        for number, side in enumerate(brdf):
            self.add_module(f"brdf_{number}", side)
        self.count = len(brdf)

    @property
    def brdf(self) -> list[BSDF]:
        """The nested BSDFs, as given."""
        return [getattr(self, f"brdf_{number}") for number in range(self.count)]

    def sides(self) -> tuple[BSDF, BSDF]:
        """The BSDF in front and the one behind."""
        return self.brdf[0], self.brdf[-1]
