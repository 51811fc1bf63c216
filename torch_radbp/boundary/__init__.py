"""Boundary terms: derivatives from the image's discontinuities, as silhouettes, which derivatives of radiance miss."""

from torch_radbp.boundary.outline import Jumps, Outlines, outlines_of
from torch_radbp.boundary.rendering import Rendering, rendering_of
from torch_radbp.boundary.silhouette import CameraSight
from torch_radbp.boundary.terms import EdgesOfCall, bytes_of_edges, edges_of_call
from torch_radbp.boundary.warning import JumpWarning, JumpWatch, SilhouetteWarning
from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)

__all__ = ["JumpWarning", "JumpWatch", "Jumps", "Outlines", "Rendering", "CameraSight", "EdgesOfCall", "SilhouetteWarning",
           "bytes_of_edges", "edges_of_call", "outlines_of", "rendering_of"]
