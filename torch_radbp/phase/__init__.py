"""Phase functions: the directions in which media scatter light."""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
