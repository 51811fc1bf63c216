"""OpenEXR files by OpenEXR's own writer."""

from __future__ import annotations

import numpy as np
import OpenEXR


def write_exr(path, channels, compression="ZIP"):
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: np.ascontiguousarray(values) for name, values in channels.items()}).write(str(path))
