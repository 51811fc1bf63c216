"""Mitsuba's projective integrators, rendered with the boundary terms of `Renderer`."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

from torch_radbp.integrator.path import PathReplay
from torch_radbp.integrator.settings import IntegratorSettings
from torch_radbp.plugin import boolean, integer, nearest, register

GUIDING = ("none", "grid", "octree")
SEEDS = ("both", "bsdf", "emitter")


class ProjectiveSampling(NamedTuple):
    """Mitsuba's settings of the sampling of boundary terms."""

    sppc: int | None  # samples of the interior
    sppp: int | None  # of edges in view
    sppi: int | None  # of other edges, as are the settings below
    guiding: str
    guiding_proj: bool
    guiding_rounds: int
    project_seed: str


def checked_sampling(name: str, plain: str, given: ProjectiveSampling) -> dict[str, Any]:
    """Checks the settings of Mitsuba's projective sampling, and warns that they are without effect.

    Args:
        name: of the integrator.
        plain: of the one that it is rendered as.
        given: the settings.
    """
    for key, value, supported in (("guiding", given.guiding, GUIDING), ("project_seed", given.project_seed, SEEDS)):
        if value not in supported:
            raise ValueError(f"{key} {value!r} is not known; {nearest(str(value), supported)}")
    counts: dict[str, Any] = {
        key: value if value is None else integer(key, value, 0) for key, value in zip(given._fields, given[:3])}
    settings = given._replace(**counts, guiding_proj=boolean("guiding_proj", given.guiding_proj),
                              guiding_rounds=integer("guiding_rounds", given.guiding_rounds, 1))._asdict()
    warnings.warn(f"{name} is rendered as {plain}: derivatives have the interior, the edges in view and the borders of "
                  "shadows, as Renderer(terms=) says; what edges contribute that surfaces see by reflection is missing, "
                  "and Renderer warns where it does; sppc, sppp, sppi, guiding and project_seed are without effect",
                  stacklevel=3)
    return settings


@register("integrator", "prb_projective")
class ProjectivePathReplay(PathReplay):
    """`prb`, with the boundary terms that `Renderer` has: those of edges in view and of borders of shadows.

    Args:
        sppc, sppp, sppi, guiding, guiding_proj, guiding_rounds, project_seed: how Mitsuba samples boundaries; without
            effect.
    """

    def __init__(self, *, max_depth: int = 6, rr_depth: int = 5, hide_emitters: bool = False, sppc: int | None = None,
                 sppp: int | None = None, sppi: int | None = None, guiding: str = "octree", guiding_proj: bool = True,
                 guiding_rounds: int = 1, project_seed: str = "both", block_size: int = 0, samples_per_pass: int = -1,
                 timeout: float = -1.0):
        super().__init__(max_depth=max_depth, rr_depth=rr_depth, hide_emitters=hide_emitters, block_size=block_size,
                         samples_per_pass=samples_per_pass, timeout=timeout)
        self.__dict__ |= checked_sampling("prb_projective", "prb", ProjectiveSampling(
            sppc, sppp, sppi, guiding, guiding_proj, guiding_rounds, project_seed))


@register("integrator", "direct_projective")
class ProjectiveDirect(IntegratorSettings):
    """`direct`, with the boundary terms that `Renderer` has: those of edges in view and of borders of shadows.

    Args:
        sppc, sppp, sppi, guiding, guiding_proj, guiding_rounds, project_seed: how Mitsuba samples boundaries; without
            effect.
    """

    max_depth = 2

    def __init__(self, *, hide_emitters: bool = False, sppc: int | None = None, sppp: int | None = None,
                 sppi: int | None = None, guiding: str = "octree", guiding_proj: bool = True, guiding_rounds: int = 1,
                 project_seed: str = "both", block_size: int = 0, samples_per_pass: int = -1, timeout: float = -1.0):
        super().__init__(hide_emitters=hide_emitters, block_size=block_size, samples_per_pass=samples_per_pass,
                         timeout=timeout)
        self.__dict__ |= checked_sampling("direct_projective", "direct", ProjectiveSampling(
            sppc, sppp, sppi, guiding, guiding_proj, guiding_rounds, project_seed))

    def alpha(self) -> str:
        return "hit"
