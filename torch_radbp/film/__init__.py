"""Films: the pixel grid and its reconstruction filter."""

from torch_radbp.film import box, catmullrom, gaussian, hdrfilm, lanczos, mitchell, tent  # noqa: F401 (registers the plugins)
