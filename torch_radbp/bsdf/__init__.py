"""Materials: how light scatters at a surface."""

from torch_radbp.bsdf import (  # noqa: F401 (registers the plugins)
    conductor,
    dielectric,
    diffuse,
    roughconductor,
    roughdielectric,
    twosided,
)
