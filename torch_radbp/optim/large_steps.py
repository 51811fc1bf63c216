"""Large steps: vertex positions as a smooth function of what is optimised, so that a step moves the whole shape."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from torch_radbp.optim.adjacency import unique_edges, welded_vertices


class LargeSteps(nn.Module):
    """A parametrisation of vertex positions x = (I + smoothness L)^-1 u, L the Laplacian of the mesh.

    For `torch.nn.utils.parametrize.register_parametrization(mesh, "vertex_positions", LargeSteps(...))`: what is optimised
    is then u, `mesh.parametrizations.vertex_positions.original`. A step along the gradient of u moves x by the gradient
    smoothed twice, so that it may be large without tangling the mesh; where nothing more is to be gained, details are
    free. The matrix is factorised once, in float64 on the CPU.

    Vertices at one place, as along seams of surface coordinates, are one: u has a row for each place.

    Args:
        faces: (F, 3) integers, of the mesh.
        vertices: (V, 3) where they are now; tells which are at one place.
        smoothness: lambda; how far, in squared edges, a step reaches. 19 weighs the Laplacian by 0.95.

    Raises:
        ValueError: if smoothness is negative, or faces and vertices do not fit.

    Reference: Nicolet, Jacobson and Jakob 2021, "Large Steps in Inverse Rendering of Geometry", equations 8 to 10.
    """

    def __init__(self, faces: Tensor, vertices: Tensor, smoothness: float = 19.0):
        super().__init__()
        if not smoothness >= 0:
            raise ValueError(f"smoothness must not be negative, got {smoothness}")
        place, count = welded_vertices(vertices)
        if len(faces) and int(faces.max()) >= len(place):
            raise ValueError(f"faces refer to vertex {int(faces.max())}, and there are {len(place)}")
        self.smoothness = float(smoothness)
        self.register_buffer("place", place, persistent=False)
        self.count = count
        self.edges = unique_edges(place[faces.long()]).cpu()
        self.solver = None  # made when it is asked for, and in each process anew

    def forward(self, smooth: Tensor) -> Tensor:
        """The vertices, (V, 3), from the parameters u, (places, 3); attached."""
        return Solved.apply(smooth, self)[self.place]

    def right_inverse(self, vertices: Tensor) -> Tensor:
        """The parameters u from vertices, (V, 3): the inverse of `forward`."""
        sums = vertices.new_zeros(self.count, 3).index_add_(0, self.place, vertices)
        places = sums / torch.bincount(self.place, minlength=self.count)[:, None]
        return places + self.smoothness * laplacian(self.edges.to(places.device), places)

    def solved(self, right: Tensor) -> Tensor:
        """Solves (I + smoothness L) x = b for columns b, (places, k)."""
        if self.solver is None:
            self.solver = factorised(self.edges, self.count, self.smoothness)
        solution = self.solver(right.detach().to("cpu", torch.float64).numpy())
        return torch.from_numpy(solution).to(right)

    def __getstate__(self) -> dict:
        return self.__dict__ | {"solver": None}


class Solved(torch.autograd.Function):
    """`LargeSteps.solved` with derivatives; it is its own adjoint, since the matrix is symmetric."""

    @staticmethod
    def forward(ctx, smooth: Tensor, system: LargeSteps) -> Tensor:
        ctx.system = system
        return system.solved(smooth)

    @staticmethod
    def backward(ctx, adjoint: Tensor) -> tuple[Tensor, None]:
        return Solved.apply(adjoint, ctx.system), None

    @staticmethod
    def jvp(ctx, tangent: Tensor, _) -> Tensor:
        return ctx.system.solved(tangent)


def laplacian(edges: Tensor, values: Tensor) -> Tensor:
    """The graph Laplacian of values at vertices: the sum of differences to the neighbours; (V, k), attached to `values`.

    Args:
        edges: (E, 2), each once.
        values: (V, k).
    """
    along = values[edges[:, 0]] - values[edges[:, 1]]
    return torch.zeros_like(values).index_add(0, edges[:, 0], along).index_add(0, edges[:, 1], -along)


def factorised(edges: Tensor, count: int, smoothness: float):
    """Factorises I + smoothness L and returns a solver, a function of arrays (count, k)."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    first, second = edges.numpy().T
    degree = np.bincount(edges.numpy().ravel(), minlength=count)
    ones = np.full(len(first), -smoothness)
    matrix = sparse.coo_matrix((np.concatenate([ones, ones, 1 + smoothness * degree]),
                                (np.concatenate([first, second, np.arange(count)]),
                                 np.concatenate([second, first, np.arange(count)]))), (count, count))
    # It is symmetric and positive definite: pivots on the diagonal, which keeps the factors sparse.
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve
