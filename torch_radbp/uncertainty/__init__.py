"""How far parameters that were found from images can be trusted: curvature, covariance, and the next view."""

from torch_radbp.uncertainty.covariance import covariance, diagonal_covariance
from torch_radbp.uncertainty.curvature import curvature
from torch_radbp.uncertainty.next_view import next_view, sensitivity

__all__ = ["covariance", "curvature", "diagonal_covariance", "next_view", "sensitivity"]
