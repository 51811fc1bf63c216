"""Names of a glTF document as names of modules, each used once."""

from __future__ import annotations

from torch import nn


class Names:
    """Gives out names of a scene's objects, each once."""

    def __init__(self) -> None:
        self.used: dict[str, int] = {}  # with the last number that was appended

    def free(self, name: str) -> str:
        """A free name: `name`, with dots replaced, or name_1, name_2, ..."""
        name = name.replace(".", "_") or "unnamed"
        if hasattr(nn.Module, name) or name in ("shapes", "sensors", "emitters", "integrator"):
            name += "_"
        free = name
        while free in self.used:
            self.used[name] += 1
            free = f"{name}_{self.used[name]}"
        self.used[free] = 0
        return free
