"""Materials: how light scatters at a surface. Importing this imports and registers all of its plugins."""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
