"""Arbitrary output variables: images of what the camera sees first, and moments of the samples of an image."""

from torch_radbp.aov.quantity import QUANTITIES, channel_names

__all__ = ["QUANTITIES", "channel_names"]
