"""Optimising: parametrisations of shapes, maps and ranges, bounds, optimisers, losses of meshes, and remeshing.

Parametrisations are for `torch.nn.utils.parametrize` (`rb.optim`):

    mesh = scene.bunny
    parametrize.register_parametrization(mesh, "vertex_positions", rb.optim.LargeSteps(mesh.faces, mesh.vertex_positions))
    optimizer = rb.optim.AdamUniform(mesh.parameters(), lr=0.02)

Or else the optimizer itself keeps parameters in their ranges: `bounded`.
"""

from torch_radbp.optim.adam_uniform import AdamUniform
from torch_radbp.optim.bounded import bounded
from torch_radbp.optim.coarse_to_fine import CoarseToFine, refine
from torch_radbp.optim.gauss_newton import GaussNewton
from torch_radbp.optim.large_steps import LargeSteps
from torch_radbp.optim.mesh_losses import laplacian_loss, normal_consistency_loss
from torch_radbp.optim.ranges import Log, Sigmoid
from torch_radbp.optim.remeshing import remesh

__all__ = ["AdamUniform", "CoarseToFine", "GaussNewton", "LargeSteps", "Log", "Sigmoid", "bounded",
           "laplacian_loss", "normal_consistency_loss", "refine", "remesh"]
