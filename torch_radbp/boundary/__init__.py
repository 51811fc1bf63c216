"""Silhouettes: where an image changes by jumps, so that its derivative has a part that no derivative of a pixel has."""

from torch_radbp.boundary.warning import JumpWarning, SilhouetteWarning, SilhouetteWatch

__all__ = ["JumpWarning", "SilhouetteWarning", "SilhouetteWatch"]
