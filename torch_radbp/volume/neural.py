"""Any module as a volume: a network from positions to values."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from torch_radbp.plugin import Matrix4, Plugin
from torch_radbp.texture.neural import check_parameters_of
from torch_radbp.transforms import affine, transform_points
from torch_radbp.volume.on_grid import OnGrid

BLOCK = 1 << 16  # points that a module gets at a time
MOST_CELLS = 1 << 27
LATEST: WeakKeyDictionary[NeuralVolume, tuple[list, Tensor]] = WeakKeyDictionary()  # with what the values depend on


class NeuralVolume(OnGrid):
    """The values of a module in space, in the place of any volume, such as the extinction or the albedo of a medium.

    Parameters: those of the module, as `module.NAME`. Derivatives: with respect to them. Once for each rendering the module
    is evaluated at the centres of the cells of a grid in the unit cube [0, 1]^3 under `to_world`; between these values are
    interpolated, and outside they are the nearest, as those of a `gridvolume`. So bounds of what is sampled are exact, a
    rendering costs as many evaluations as there are cells, however many collisions, and detail that is finer than cells is
    not seen. Of many cells the module's intermediate results are computed again in the backward pass.

    Args:
        module: from (N, 3) positions in the world to (N, 1) or (N, 3), of the scene's dtype; not negative.
        resolution: cells along x, y and z, or of all alike.
        to_world: the pose of the cube, no parameter.

    Raises:
        TypeError: unless `module` is an `nn.Module`.
        ValueError: on a resolution that is none; when rendered, if values are negative, not finite or of another shape.
    """

    def __init__(self, module: nn.Module, resolution: int | tuple[int, int, int] = 64, to_world: Matrix4 | None = None):
        super().__init__()
        if not isinstance(module, nn.Module) or isinstance(module, Plugin):
            raise TypeError(f"module must be an nn.Module from (N, 3) to values, got {type(module).__name__}")
        check_parameters_of(module, "position")
        self.resolution = (resolution,) * 3 if isinstance(resolution, int) else tuple(resolution)
        if len(self.resolution) != 3 or min(self.resolution) < 1 or torch.Size(self.resolution).numel() > MOST_CELLS:
            raise ValueError(f"resolution must be a number of cells, or three along x, y and z, of at most {MOST_CELLS:,} "
                             f"cells, got {resolution}")
        self.module = module
        self.register_buffer("to_world", affine("to_world", to_world).to(torch.get_default_dtype()))

    def channels(self) -> int:
        """The number of values that the module returns at a point: 1, or 3 of linear RGB."""
        return self.values_at(self.centres()[:1]).shape[1]

    def samples(self) -> Tensor:
        """(Z, Y, X, C) the values at the centres of cells; attached to the module's parameters where gradients are recorded.

        Raises:
            ValueError: if values are negative, not finite or of another shape.
        """
        state = [(id(tensor), tensor._version) for tensor in (*self.module.parameters(), *self.module.buffers())]
        latest = LATEST.get(self)
        if latest is not None and latest[0] == state and not torch.is_grad_enabled():
            return latest[1]
        values = self.evaluated()
        LATEST[self] = state, values.detach()
        return values

    def evaluated(self) -> Tensor:
        """(Z, Y, X, C) the values at the centres of all cells, attached."""
        x, y, z = self.resolution
        blocks = self.centres().split(BLOCK)
        again = len(blocks) > 1 and torch.is_grad_enabled()
        values = torch.cat([checkpoint(self.values_at, block, use_reentrant=False) if again else self.values_at(block)
                            for block in blocks])
        if not bool((values.detach().isfinite() & (values.detach() >= 0.0)).all()):
            raise ValueError("the module of a NeuralVolume returned values that are negative or not finite: end it with "
                             "torch.nn.Softplus() or Sigmoid()")
        return values.reshape(z, y, x, -1)

    def centres(self) -> Tensor:
        """(N, 3) the centres of cells in the world, x fastest."""
        z, y, x = torch.meshgrid(*[(torch.arange(count, dtype=torch.float64, device=self.to_world.device) + 0.5) / count
                                   for count in self.resolution[::-1]], indexing="ij")
        return transform_points(self.from_unit_cube(), torch.stack([x, y, z], -1).reshape(-1, 3)).to(self.to_world.dtype)

    def values_at(self, p: Tensor) -> Tensor:
        """(N, 1) or (N, 3) the values of the module at points (N, 3), attached."""
        values = self.module(p)
        if not isinstance(values, Tensor) or values.shape not in ((len(p), 1), (len(p), 3)):
            got = tuple(values.shape) if isinstance(values, Tensor) else type(values).__name__
            raise ValueError(f"the module of a NeuralVolume must return ({len(p)}, 1) or ({len(p)}, 3) for ({len(p)}, 3) "
                             f"positions, got {got}")
        return values
