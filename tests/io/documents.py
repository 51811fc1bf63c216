"""Scene documents for the tests of io."""

from __future__ import annotations

from pathlib import Path
from typing import Any

SENSOR = '<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="4"/>' \
         '<integer name="height" value="4"/></film></sensor>'
LAMP = '<emitter type="constant" id="sky"/>'


def scene_text(body: str, version: str = "3.0.0", complete: bool = True) -> str:
    """A scene file with `body` from its second line on; a sensor and an emitter are added at the end."""
    return f'<scene version="{version}">\n{body}\n{SENSOR + LAMP if complete else ""}</scene>\n'


def write_scene(folder: Path, body: str, name: str = "scene.xml", **options: Any) -> Path:
    """Writes `scene_text` to a file of `folder`."""
    path = folder / name
    path.write_text(scene_text(body, **options), encoding="utf-8")
    return path


def scene_dict(**objects: Any) -> dict[str, Any]:
    """A scene dict with a small sensor, an emitter, and the objects given."""
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    return {"type": "scene", "sensor": {"type": "perspective", "film": film}, "sky": {"type": "constant"}, **objects}


TRIANGLE_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
