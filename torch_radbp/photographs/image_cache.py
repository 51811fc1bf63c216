"""A cache of images, within a limit of memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from torch import Tensor


class ImageCache:
    """Caches tuples of tensors by number; the least recently used are dropped first.

    Args:
        limit: bytes; what is larger by itself is not kept.
    """

    def __init__(self, limit: int):
        self.limit, self.held = limit, 0
        self.images: OrderedDict[int, tuple[Tensor, ...]] = OrderedDict()

    def get(self, key: int, make: Callable[[], tuple[Tensor, ...]]) -> tuple[Tensor, ...]:
        """The cached tuple of a number, or what `make` returns, which is cached then."""
        if key in self.images:
            self.images.move_to_end(key)
            return self.images[key]
        made = make()
        if _size_of(made) <= self.limit:
            self.images[key] = made
            self.held += _size_of(made)
        while self.held > self.limit:
            self.held -= _size_of(self.images.popitem(last=False)[1])
        return made

    def __getstate__(self) -> dict:
        """The state of an empty cache: copies, as for the processes of a `DataLoader`, start empty."""
        return {"limit": self.limit, "held": 0, "images": OrderedDict()}


def _size_of(tensors: tuple[Tensor, ...]) -> int:
    """The size of tensors in bytes."""
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors)
