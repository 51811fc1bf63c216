"""Silhouettes: where an image is discontinuous, so that its derivative has a part that no derivative of radiance has."""

from torch_radbp.boundary.silhouette import Sight
from torch_radbp.boundary.warning import JumpWarning, JumpWatch, Rendering, SilhouetteWarning

__all__ = ["JumpWarning", "JumpWatch", "Rendering", "Sight", "SilhouetteWarning"]
