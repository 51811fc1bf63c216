"""Integrators by Mitsuba's names: they set the defaults of `Renderer`.

Each file is imported, and registers its plugins.
"""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
