"""The curves at which an image may jump: edges, outlines, contacts, lines; places on them in view."""

from torch_radbp.plugin.folder import import_files

import_files(__name__, __path__)
