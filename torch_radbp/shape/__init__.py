"""Shapes: all become triangles; analytic shapes are tessellated finely and keep their exact normals.

Each file is imported, and registers its plugins.
"""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
