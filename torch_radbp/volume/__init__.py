"""Volumes: what varies in space, such as the density of a medium."""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
