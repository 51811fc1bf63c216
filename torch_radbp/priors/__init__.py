"""Priors: what is likely of maps and colours before any photograph is seen, as losses without noise (`rb.priors`).

    loss = data + 1e-3 * rb.priors.total_variation(scene.wall.bsdf.reflectance.data)
    loss = data + 1e-2 * rb.priors.white_balance(exposure.gains)

They read parameters, not renderings: values and derivatives are exact, whatever the number of samples.
"""

from torch_radbp.priors.maps import bending, smoothness, total_variation
from torch_radbp.priors.white_balance import white_balance

__all__ = ["bending", "smoothness", "total_variation", "white_balance"]
