"""Media: what light travels through between surfaces."""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
