"""Reads meshes in other formats through trimesh: STL, OFF, 3MF, COLLADA, glTF as a mesh, ...

OBJ, PLY and serialized files are not read by it: the readers beside this one refuse damaged files, and are faster (their
docstrings say by how much).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torch_radbp.formats.files import opened, unknown_kind

if TYPE_CHECKING:
    import trimesh

OWN = {".obj": "obj", ".ply": "ply", ".serialized": "serialized"}  # read by shapes of these types
COLLADA, XML, CAD = "pycollada", "lxml", "cascadio"
NEEDS = {".dae": COLLADA, ".zae": COLLADA, ".3mf": f"{XML} networkx", ".3dxml": f"{XML} networkx", ".xaml": XML,
         ".step": CAD, ".stp": CAD, ".ctm": "openctm"}  # what trimesh imports for a format, as pip calls it


def read_trimesh(path: str | os.PathLike) -> trimesh.Scene:
    """The meshes in a file, with what trimesh reads of their materials; equal vertices are one, as `trimesh.load` has them.

    Raises:
        FileNotFoundError: if there is no such file.
        IsADirectoryError: if it is a folder.
        ImportError: if trimesh needs another package for this format; the message names it.
        ValueError: names the file: on unknown extensions, what trimesh cannot read, files without triangles, and vertices
            that are not finite.
    """
    import trimesh
    name, suffix = os.fspath(path), Path(path).suffix.lower()
    if suffix in OWN:
        raise ValueError(f"{name}: a {suffix} file is read by the shape type {OWN[suffix]!r}: write \"type\": "
                         f"\"{OWN[suffix]}\"")
    supported = {f".{kind}" for kind in trimesh.available_formats() if kind != "stl_ascii"} | NEEDS.keys()
    double = "".join(Path(path).suffixes[-2:]).lower()  # .tar.gz
    kind = double if double in supported else suffix
    if kind not in supported or not os.path.isfile(path):
        with opened(path):
            raise ValueError(unknown_kind(path, "mesh", [*OWN, *sorted(supported - OWN.keys())]))
    try:
        with opened(path) as file:
            scene = trimesh.load(file, file_type=kind[1:], force="scene", process=False,
                                 resolver=trimesh.resolvers.FilePathResolver(name))
    except ImportError as error:
        needed = NEEDS.get(kind, "")
        advice = f" {needed}: pip install {needed}" if needed else f" another package: {error}"
        raise ImportError(f"{name}: trimesh reads {kind} files with{advice}") from error
    except Exception as error:  # the library raises whatever its readers stumble over
        raise ValueError(f"{name}: trimesh cannot read it as {kind}: {type(error).__name__}: {error}") from error
    meshes = [mesh for mesh in scene.geometry.values() if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not meshes:
        raise ValueError(f"{name}: it has no triangles that trimesh finds")
    for mesh in meshes:
        bad = int((~np.isfinite(mesh.vertices).all(axis=1)).sum())
        if bad:
            raise ValueError(f"{name}: {bad} of {len(mesh.vertices)} vertices are NaN or infinite")
        mesh.process()
    return scene
