"""Boundary terms: what jumps, where, and how it moves."""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
