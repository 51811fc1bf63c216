"""Materials: how light scatters at a surface. Every file of this folder is imported, and registers its plugins."""

from importlib import import_module
from pkgutil import iter_modules

for _file in iter_modules(__path__, f"{__name__}."):
    import_module(_file.name)
