"""Environment maps, which glTF lacks: an EXR file beside the document, named by `extras` of a node.

    {"name": "sky", "extras": {"environment": {"uri": "asset_sky.exr"}}, "matrix": [...]}

The image is by latitude and longitude, linear: its first row at the +y of the node, its middle column at its +z, its left
quarter at its +x. Readers that do not know of it see an empty node.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import torch

from torch_radbp.emitter.envmap import Envmap
from torch_radbp.formats.file_names import file_name
from torch_radbp.formats.image import save_image
from torch_radbp.io.gltf.accessor import Buffers
from torch_radbp.io.gltf.document import DocumentPart, Losses

ENVIRONMENT = "environment"


def written_environment(emitter: Envmap, name: str, target: Path, losses: Losses) -> tuple[Path, dict[str, Any]]:
    """Writes the image of an environment map beside a document.

    Args:
        emitter: whose scale becomes a part of the image.
        name: of it in the scene.
        target: the document.
        losses: filled in.

    Returns:
        The file, and the `extras` of its node.
    """
    file = target.with_name(f"{target.stem}_{file_name(name)}.exr")
    save_image(file, (emitter.data * emitter.scale).detach().movedim(-1, 0))
    losses.add(name, f"glTF has no environment maps: it is written beside as {file.name}, which torch_radbp finds there")
    return file, {ENVIRONMENT: {"uri": quote(file.name)}}


def environment(node: DocumentPart, to_world: np.ndarray, buffers: Buffers, losses: Losses) -> Envmap | None:
    """Reads the environment map that a node names; None if it names none, or its file is gone.

    Raises:
        SceneError: if the file lies outside of the folder of the document, or is damaged.
    """
    extras = node.value.get("extras")
    named = extras.get(ENVIRONMENT) if isinstance(extras, dict) else None
    uri = named.get("uri") if isinstance(named, dict) else None
    if not isinstance(uri, str):  # what others put into extras may be anything
        return None
    path = buffers.path(uri, node)
    if not path.is_file():
        losses.add(node.place, f"its environment map is not read: there is no {path}")
        return None
    return Envmap(filename=str(path), to_world=torch.from_numpy(to_world))
