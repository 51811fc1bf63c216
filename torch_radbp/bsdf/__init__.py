"""Materials: how light scatters at a surface."""

from torch_radbp.bsdf import diffuse, twosided  # noqa: F401 (registers the plugins)
