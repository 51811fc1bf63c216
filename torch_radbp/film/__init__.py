"""Films: the pixel grid and its reconstruction filter."""

from torch_radbp.film import box, gaussian, hdrfilm, tent  # noqa: F401 (registers the plugins)
