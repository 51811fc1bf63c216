"""The scene: a tree of modules for the user, one record of tensors for the path tracer."""

from torch_radbp.scene.scene import Scene

__all__ = ["Scene"]
