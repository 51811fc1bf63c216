"""The scenes that are measured, each described once for both renderers."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from benchmarks.scenes import cornell_box, held_out, material_room, metal_mesh, principled_interior, textured_interior
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
# Those that are measured only if they are named: two that nothing is tuned on, and two with large images.
OTHERS = {
    "metal-plate": Entry(lambda folder, setting: held_out.metal_plate(setting), held_out.SETTING),
    "relief": Entry(lambda folder, setting: held_out.relief(setting), held_out.SETTING),
    "images-2048": Entry(partial(metal_mesh.metal_mesh, floor_size=2048, sky_rows=1024), metal_mesh.SETTING),
    "images-4096": Entry(partial(metal_mesh.metal_mesh, floor_size=4096, sky_rows=1024), metal_mesh.SETTING),
}
ALL = {**SCENES, **OTHERS}
QUICK = Setting(resolution=16, spp=2, max_depth=4)
