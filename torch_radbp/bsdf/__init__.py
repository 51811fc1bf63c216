"""Materials: how light scatters at a surface. Each file is imported, and registers its plugins."""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
