"""Arbitrary output variables (AOVs): images of depth, normals and the like, and moments of an image's samples."""

from torch_radbp.aov.quantity import QUANTITIES, channel_names

__all__ = ["QUANTITIES", "channel_names"]
