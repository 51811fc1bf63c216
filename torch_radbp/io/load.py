"""Loads scenes: files and dicts in, `Scene` out."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from torch_radbp.io.build import build_scene
from torch_radbp.io.xml_scene import read_scene
from torch_radbp.plugin import SceneError
from torch_radbp.scene.scene import Scene


def load(path: str | os.PathLike, **variables: Any) -> Scene:
    """The scene in a Mitsuba 3 XML file.

    Args:
        path: the .xml file; names inside it are relative to its folder.
        **variables: values for `$name` in the file, `load("scene.xml", spp=64)`; they win over <default>.

    Raises:
        SceneError: names file, line and element, and what is supported.
    """
    if Path(path).suffix.lower() != ".xml":
        raise SceneError(f"{os.fspath(path)}: unknown kind of scene {Path(path).suffix!r}; supported: .xml (Mitsuba 3)")
    return build_scene(read_scene(path, variables))


def load_dict(description: dict[str, Any], base_dir: str | os.PathLike | None = None) -> Scene:
    """The scene that a Python dict in Mitsuba's vocabulary describes, such as `mitsuba.cornell_box()`.

    Args:
        description: {"type": "scene", "white": {"type": "diffuse", ...}, ...}. A transform is a 4 x 4 array or one of
            Mitsuba's transforms; an object may be a plugin that is already made.
        base_dir: folder of relative file names; the current one if None.

    Raises:
        SceneError: names the path of keys, such as light.emitter.radiance, and what is supported.
    """
    return build_scene(description, base_dir)
