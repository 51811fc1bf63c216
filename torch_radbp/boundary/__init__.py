"""Silhouettes: where an image changes by jumps, so that its derivative has a part that no derivative of a pixel has."""

from torch_radbp.boundary.silhouette import Sight
from torch_radbp.boundary.warning import JumpWarning, JumpWatch, Rendering, SilhouetteWarning

__all__ = ["JumpWarning", "JumpWatch", "Rendering", "Sight", "SilhouetteWarning"]
