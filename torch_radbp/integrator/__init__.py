"""Integrators by Mitsuba's names: what they set is what `Renderer` takes for granted.

Each file is imported, and registers its plugins.
"""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
