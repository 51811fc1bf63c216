"""The backward pass: memoized adjoint radiance, its schedules, and other strategies for comparison."""

from torch_radbp.adjoint.memoized import MemoizedAdjoint
from torch_radbp.adjoint.quadratic import QuadraticAdjoint
from torch_radbp.adjoint.replay import ReplayAdjoint
from torch_radbp.adjoint.strategy import AdjointStrategy
from torch_radbp.adjoint.tape import TapeAdjoint

__all__ = ["AdjointStrategy", "MemoizedAdjoint", "QuadraticAdjoint", "ReplayAdjoint", "TapeAdjoint"]
