"""Photographs: images with cameras and masks as a data set, and how a camera makes pictures of radiance.

    photographs = rb.Photographs.from_nerf("transforms.json")
    scene = rb.load_dict({"type": "scene", **photographs.cameras, **objects})
    exposure = rb.Exposure(len(photographs), fixed=0)
"""

from torch_radbp.photographs.dataset import Photograph, Photographs
from torch_radbp.photographs.exposure import Exposure
from torch_radbp.photographs.lens_falloff import LensFalloff
from torch_radbp.photographs.tone_curve import ToneCurve

__all__ = ["Exposure", "LensFalloff", "Photograph", "Photographs", "ToneCurve"]
