"""Integrators that nest another one, which makes the image."""

from __future__ import annotations

from collections.abc import Iterable

from torch_radbp.integrator.path import Path
from torch_radbp.integrator.settings import IntegratorSettings
from torch_radbp.plugin import BSDF, Integrator


class Nesting(IntegratorSettings):
    """Base class of integrators that add AOVs to the image of a nested integrator.

    Args:
        integrators: one, or none for outputs without an image of a name.
        hide_emitters: that of the nested integrator.

    Raises:
        ValueError: if there are several, or `hide_emitters` is set but not in the nested one.
    """

    def __init__(self, *, integrators: dict[str, Integrator] | None = None, hide_emitters: bool = False, block_size: int = 0,
                 samples_per_pass: int = -1, timeout: float = -1.0):
        super().__init__(hide_emitters=hide_emitters, block_size=block_size, samples_per_pass=samples_per_pass,
                         timeout=timeout)
        self.integrators = dict(integrators or {})
        if len(self.integrators) > 1:
            raise ValueError(f"{self.type} with several integrators ({', '.join(self.integrators)}) is not supported, since "
                             "a rendering has one image: keep one")
        nested = next(iter(self.integrators.values()), None)
        self.inner = (Path() if nested is None else nested,)  # a tuple, so that it is no submodule
        self.max_depth, self.rr_depth, self.nee = self.inner[0].max_depth, self.inner[0].rr_depth, self.inner[0].nee
        if self.hide_emitters and not self.inner[0].hide_emitters:
            raise ValueError(f"hide_emitters of {self.type} has no effect in Mitsuba, where outputs show emitters; set "
                             "it in the nested integrator, whose image it changes")
        self.hide_emitters = self.inner[0].hide_emitters

    def nested_outputs(self) -> dict[str, str]:
        """The AOVs of all nested integrators, with the name of the integrator before that of the AOV."""
        return {f"{name}.{output}": quantity for name, integrator in self.integrators.items()
                for output, quantity in integrator.outputs().items()}

    def alpha(self) -> str:
        return self.inner[0].alpha()

    def check(self, materials: Iterable[BSDF]) -> None:
        self.inner[0].check(materials)
