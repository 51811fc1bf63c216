"""Silhouettes: where an image changes by jumps, so that its derivative has a part that no derivative of a pixel has."""

from torch_radbp.boundary.warning import JumpWarning, JumpWatch, SilhouetteWarning

__all__ = ["JumpWarning", "JumpWatch", "SilhouetteWarning"]
