"""Mitsuba's projective integrators, rendered with the boundary terms of `Renderer`."""

from __future__ import annotations

import warnings
from typing import Any

from torch_radbp.integrator.path import PathReplay
from torch_radbp.integrator.settings import IntegratorSettings
from torch_radbp.plugin import boolean, integer, nearest, register

GUIDING = ("none", "grid", "octree")
SEEDS = ("both", "bsdf", "emitter")


def sampling_of_boundaries(name: str, plain: str, sppc: int | None, sppp: int | None, sppi: int | None, guiding: str,
                           guiding_proj: bool, guiding_rounds: int, project_seed: str) -> dict[str, Any]:
    """Checks the settings of Mitsuba's projective sampling, and warns that they are without effect.

    Args:
        name: of the integrator.
        plain: of the one that it is rendered as.
        sppc, sppp, sppi: samples of the interior, of edges in view, and of others.
        guiding, guiding_proj, guiding_rounds, project_seed: how others are found.
    """
    for key, value, known in (("guiding", guiding, GUIDING), ("project_seed", project_seed, SEEDS)):
        if value not in known:
            raise ValueError(f"{key} {value!r} is not known; {nearest(str(value), known)}")
    counts = {"sppc": sppc, "sppp": sppp, "sppi": sppi}
    settings: dict[str, Any] = {key: value if value is None else integer(key, value, 0) for key, value in counts.items()}
    settings |= {"guiding": guiding, "guiding_proj": boolean("guiding_proj", guiding_proj),
                 "guiding_rounds": integer("guiding_rounds", guiding_rounds, 1), "project_seed": project_seed}
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
        self.__dict__ |= sampling_of_boundaries("prb_projective", "prb", sppc, sppp, sppi, guiding, guiding_proj,
                                                guiding_rounds, project_seed)


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
        self.__dict__ |= sampling_of_boundaries("direct_projective", "direct", sppc, sppp, sppi, guiding, guiding_proj,
                                                guiding_rounds, project_seed)

    def alpha(self) -> str:
        return "hit"
