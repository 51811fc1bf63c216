"""The scenes that are measured, each described once for both renderers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from benchmarks.scenes import cornell_box, material_room, metal_mesh, principled_interior, textured_interior
from benchmarks.scenes.description import BenchmarkScene, Setting


class Entry(NamedTuple):
    """A scene of the table."""

    make: Callable[[Path, Setting], BenchmarkScene]
    """Writes the files that the scene needs into a folder."""
    setting: Setting


SCENES = {
    "cornell-box": Entry(lambda folder, setting: cornell_box.cornell_box(setting), cornell_box.SETTING),
    "metal-mesh": Entry(metal_mesh.metal_mesh, metal_mesh.SETTING),
    "material-room": Entry(material_room.material_room, material_room.SETTING),
    "textured-interior": Entry(textured_interior.textured_interior, textured_interior.SETTING),
    "principled-interior": Entry(principled_interior.principled_interior, principled_interior.SETTING),
    "metal-mesh-vertices": Entry(metal_mesh.metal_mesh_vertices, metal_mesh.SETTING),
}
QUICK = Setting(resolution=16, spp=2, max_depth=4)
