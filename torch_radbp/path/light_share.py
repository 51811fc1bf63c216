"""Which light is that of paths from the camera, and which that of paths from lamps, so that none counts twice.

Between lamp and camera light passes vertices x_1, ..., x_n. A path from a lamp can be connected to the camera where x_n
scatters widely; it is good at what comes by way of a narrow x_1, a mirror, glass or a glossy surface beside the lamp, which
a path from the camera finds by chance, or not at all. Narrow are ideal lobes, and all of a material whose roughness is small
(`MaterialTable.narrow`). Of each path either side knows both ends: how the vertex scattered that it has met first, and the
one that it is at. With "caustics" light is that of paths from lamps if n > 1, x_1 is narrow and x_n is not; with "all" if
x_n is not.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.path.state import PathState, Settings
from torch_radbp.scene.tables.scene_tensors import Layout, SceneTensors
from torch_radbp.tensors.lookup import lookup

# `PathState.first`: not scattered yet, or this plus 1 if the first vertex was narrow, plus 2 if the last one was.
NOT_YET, SCATTERED = 0, 1


def narrowly(pdf: Tensor, narrow: Tensor | None) -> Tensor:
    """(N,) bool: lobes from which directions of density `pdf` come are narrow: ideal, or of a material that is
    (`narrow`)."""
    return torch.isinf(pdf) if narrow is None else torch.isinf(pdf) | narrow


def first_was_narrow(state: PathState) -> Tensor:
    """(N,) bool: the first vertex at which paths scattered was narrow."""
    return (state.first > NOT_YET) & (((state.first - SCATTERED) & 1) == 1)


def next_first(state: PathState, pdf: Tensor, narrow: Tensor | None) -> Tensor | None:
    """(N,) int32: whether the first and the latest vertex of paths are narrow, as `PathState.first` has it, once paths
    scatter at another vertex, with density `pdf`; args as for `narrowly`."""
    if state.first is None:
        return None
    here = narrowly(pdf, narrow).to(torch.int32)
    first = torch.where(state.first == NOT_YET, here, (state.first - SCATTERED) & 1)
    return SCATTERED + first + 2 * here


def meets_lamps(settings: Settings, state: PathState, on_surface: Tensor) -> Tensor | None:
    """(N,) bool: emission that camera paths hit counts for them, not for paths from lamps; None: all of it does.

    Args:
        settings: of the integrand, with `light_paths`.
        state: of the paths.
        on_surface: (N,) bool: a surface emits, not the environment, whose caustics are left to camera paths.
    """
    if state.first is None:
        return None
    if settings.light_paths == "all":
        return (state.first == NOT_YET) | first_was_narrow(state)
    return ~((state.first == SCATTERED + 2) & on_surface)  # the last vertex was narrow, the first was not


def connects(settings: Settings, layout: Layout, state: PathState, narrow: Tensor | None) -> Tensor | None:
    """(N,) bool: vertices may connect to a light (on paths from lamps: the camera); None: all may. `narrow`: see
    `narrowly`."""
    if state.first is None:
        return None
    here = torch.zeros_like(state.first, dtype=torch.bool) if narrow is None else narrow
    if layout.from_lamps:  # this is x_n
        return ~here if settings.light_paths == "all" else first_was_narrow(state) & ~here
    if settings.light_paths == "all":
        return torch.where(state.first == NOT_YET, here, first_was_narrow(state))
    return (state.first == NOT_YET) | first_was_narrow(state) | ~here  # this is x_1


def ends_lamp_paths(scene: SceneTensors, prim: Tensor) -> Tensor:
    """(N,) bool: with "all" light from lamps, paths from lamps end on triangles `prim`, int32, whose material is not
    narrow."""
    material, narrow = lookup(scene.triangles.material, prim.clamp_min(0)), scene.materials.narrow
    if narrow is None:
        return prim >= 0
    return (prim >= 0) & ~(lookup(narrow, material) | lookup(narrow, material + scene.materials.count))


def may_go_on(settings: Settings, layout: Layout, state: PathState, pdf: Tensor, narrow: Tensor | None) -> Tensor | None:
    """(N,) bool: the rest of paths may contribute to the image; None: all may. Args as for `connects` and `narrowly`."""
    if state.first is None or (settings.light_paths == "all") == layout.from_lamps or layout.emitting_media:
        return None
    return (state.first != NOT_YET) | narrowly(pdf, narrow)
