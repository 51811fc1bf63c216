"""Which light is that of paths from the camera, and which that of paths from lamps, so that none counts twice.

Between lamp and camera light passes vertices x_1, ..., x_n. A path from a lamp can be connected to the camera where x_n
scatters by a smooth lobe; it is good at what comes by way of an ideal x_1, a mirror or glass, where a path from the camera
can connect to no light. Of each path either side knows both ends: how the vertex scattered that it has met first, and the
one that it is at.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.path.state import PathState, Settings
from torch_radbp.scene.tables.scene_tensors import Layout

NOT_YET, SMOOTHLY, IDEALLY = range(3)  # `PathState.first`


def next_first(state: PathState, pdf: Tensor) -> Tensor | None:
    """`PathState.first` of paths that go on in directions sampled with a density, (N,); infinite: by an ideal lobe."""
    if state.first is None:
        return None
    return torch.where(state.first == NOT_YET, torch.where(torch.isinf(pdf), IDEALLY, SMOOTHLY).to(torch.int32), state.first)


def meets_lamps(settings: Settings, state: PathState, on_surface: Tensor) -> Tensor | None:
    """(N,) bool: the light that paths from the camera meet is theirs; None: all is.

    Args:
        settings: of the integrand.
        state: of the paths.
        on_surface: (N,) bool: it is that of a surface, not of the surroundings, whose caustics are left to the camera.
    """
    if state.first is None:
        return None
    smooth = state.first == SMOOTHLY
    return ~smooth if settings.light_paths == "all" else ~(smooth & torch.isinf(state.pdf) & on_surface)


def connects(settings: Settings, layout: Layout, state: PathState) -> Tensor | None:
    """(N,) bool: paths may be connected here to what is at the other end; None: all may."""
    return state.first == IDEALLY if only_ideally(settings, layout, state) else None


def may_go_on(settings: Settings, layout: Layout, state: PathState, pdf: Tensor) -> Tensor | None:
    """(N,) bool: paths that go on in directions sampled with a density may bring something; None: all may."""
    return (state.first != NOT_YET) | torch.isinf(pdf) if only_ideally(settings, layout, state) else None


def only_ideally(settings: Settings, layout: Layout, state: PathState) -> bool:
    """True if these paths count only if they are scattered ideally first."""
    return state.first is not None and (settings.light_paths == "all") != layout.from_lamps
