"""Maps and volumes that are optimised at a growing resolution."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.plugin import boolean, integer


class CoarseToFine(nn.Module):
    """A parametrisation x = base + upsampled(u): a map as it was, and a coarse grid of changes that is optimised.

        paint, data = scene.wall.bsdf.reflectance, rb.optim.CoarseToFine((8, 8))
        parametrize.register_parametrization(paint, "data", data)  # changes nothing
        ...                                                        # broad shapes first
        rb.optim.refine(paint, "data", optimizer)                  # 16 x 16; changes nothing

    A step in a cell of the grid moves many texels together, so that noise averages out and large shapes are found first.
    `refine` adds what has been found to the base and starts a finer grid at 0, so that the value stays what it is, bit by
    bit, whatever the sizes; at the size of the map itself, every texel is free.

    Args:
        size: of the first grid: rows and columns of a bitmap or an environment (H, W, C); depth, rows and columns of a
            volume (D, H, W, C). It need not divide that of the map, and is cut off at it.
        wrap_rows, wrap_columns: whether the last row, or column, is the neighbour of the first: both of a bitmap that
            repeats, columns alone of an environment.
        within: a parametrisation of the range that values keep to, such as `rb.optim.Sigmoid()` for a reflectance or
            `rb.optim.Log()` for an environment: base and grid are then those of its u. None: values have no bounds.

    Raises:
        ValueError: if a size is no integer of at least 1, or there are more than three.
    """

    def __init__(self, size: Sequence[int], wrap_rows: bool = False, wrap_columns: bool = False,
                 within: nn.Module | None = None):
        super().__init__()
        self.size = tuple(integer("size", side, 1) for side in size)
        if len(self.size) not in (2, 3):
            raise ValueError(f"size must be rows and columns, or depth, rows and columns, got {tuple(size)}")
        wraps = boolean("wrap_rows", wrap_rows), boolean("wrap_columns", wrap_columns)
        self.wraps = (*[False] * (len(self.size) - 2), *wraps)
        self.within = nn.Identity() if within is None else within
        self.register_buffer("base", torch.empty(0))

    def forward(self, grid: Tensor) -> Tensor:
        """The map, (H, W, C) or (D, H, W, C), of the grid, attached."""
        return self.within(self.changed(grid))

    def changed(self, grid: Tensor) -> Tensor:
        """The base plus the upsampled changes of a grid, without bounds; attached."""
        return self.base + resampled(grid, self.base.shape[:-1], self.wraps)

    def right_inverse(self, values: Tensor) -> Tensor:
        """A grid of zeros; `values` become the base.

        Raises:
            ValueError: if they have another number of axes.
        """
        if values.ndim != len(self.size) + 1:
            raise ValueError(f"a map for a grid of {' x '.join(map(str, self.size))} must have {len(self.size) + 1} axes, "
                             f"the last of channels, got shape {tuple(values.shape)}")
        bounded = not isinstance(self.within, nn.Identity)
        self.base = (self.within.right_inverse(values) if bounded else values).detach().clone()
        self.size = tuple(min(side, whole) for side, whole in zip(self.size, values.shape))
        return values.new_zeros(*self.size, values.shape[-1])

    @property
    def is_finest(self) -> bool:
        """True if the grid has the resolution of the map."""
        return self.size == tuple(self.base.shape[:-1])


def refine(module: nn.Module, name: str, optimizer: torch.optim.Optimizer | None = None, factor: int = 2) -> bool:
    """Refines the grid of a map that is parametrised by `CoarseToFine`, without changing the map's values.

    Args:
        module: that has the map, such as `scene.wall.bsdf.reflectance`.
        name: of the map in it, such as "data".
        optimizer: what holds the grid. Its moments, which are of other entries, are forgotten; None: nothing holds it.
        factor: by which each side grows, up to the size of the map.

    Returns:
        True if the grid has become finer; False if it was as fine as the map.

    Raises:
        ValueError: if the map has no such parametrisation.
    """
    held = module.parametrizations[name] if parametrize.is_parametrized(module, name) else []
    if not len(held) or not isinstance(held[0], CoarseToFine):
        raise ValueError(f"{name} of {type(module).__name__} is not parametrized by CoarseToFine; register that first")
    grid, coarse = held.original, held[0]
    if coarse.is_finest:
        return False
    with torch.no_grad():
        coarse.base = coarse.changed(grid)
        coarse.size = tuple(min(factor * side, whole) for side, whole in zip(coarse.size, coarse.base.shape))
        grid.set_(grid.new_zeros(*coarse.size, grid.shape[-1]))
    grid.grad = None
    if optimizer is not None:
        optimizer.state.pop(grid, None)
    return True


def resampled(grid: Tensor, size: Sequence[int], wraps: Sequence[bool]) -> Tensor:
    """Resamples a grid at the centres of another grid's cells, by linear interpolation; attached.

    Args:
        grid: (..., C), with as many axes before the last as `size` has sides.
        size: of the other grid.
        wraps: of each axis, whether the last cell is beside the first; else values go on as they are at the border.
    """
    for axis, (count, wrap) in enumerate(zip(size, wraps)):
        cells = grid.shape[axis]
        if cells == count:
            continue
        at = (torch.arange(count, dtype=torch.float64, device=grid.device) + 0.5) * (cells / count) - 0.5
        low = at.floor()
        share = (at - low).to(grid.dtype).view(-1, *[1] * (grid.ndim - 1 - axis))
        below, above = (index.long() % cells if wrap else index.long().clamp(0, cells - 1) for index in (low, low + 1))
        grid = torch.lerp(grid.index_select(axis, below), grid.index_select(axis, above), share)
    return grid
