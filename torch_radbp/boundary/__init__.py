"""Silhouettes: where an image is discontinuous, so that its derivative has a part that no derivative of radiance has."""

from torch_radbp.boundary.outline import Jumps, Outlines
from torch_radbp.boundary.primary import image_jumps, moves
from torch_radbp.boundary.rendering import Rendering
from torch_radbp.boundary.silhouette import CameraSight
from torch_radbp.boundary.warning import JumpWarning, JumpWatch, SilhouetteWarning

__all__ = ["JumpWarning", "JumpWatch", "Jumps", "Outlines", "Rendering", "CameraSight", "SilhouetteWarning", "image_jumps",
           "moves"]
