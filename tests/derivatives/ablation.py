"""The renderer with parts of the derivative of glued vertices taken out, to show what they are for.

`vertex/outgoing_ray.py` and light sampling let directions follow the points at both ends ("directions"), and multiply by the
change of the element of solid angle ("Jacobian"). Worchel et al. 2025, arXiv 2504.05750, say what is wrong without.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from unittest.mock import patch

import torch

from torch_radbp.emitter.area import AreaKind
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Vec3
from torch_radbp.vertex import interaction, outgoing_ray
from torch_radbp.vertex.nearby import slides_from

WITHOUT = {"nothing": (), "the area Jacobian": ("Jacobian",), "re-attached directions": ("directions",),
           "both": ("Jacobian", "directions")}
SCENES = ("wall behind the camera", "plane before a wall", "plane under a soft lamp", "soft lamp moved",
          "emitter behind rough glass")


@contextmanager
def without(*parts: str) -> Iterator[None]:
    """Within it, derivatives lack `parts`: "Jacobian", "directions"."""
    glued_direction, aim_at_area = outgoing_ray.glued_direction, AreaKind.aim

    def poorer_direction(there, o, d, hit, glued, slide):
        direction, change = glued_direction(there, o, d, hit, glued, None if parts else slide)
        return (direction.map(torch.Tensor.detach) if "directions" in parts else direction,
                change.detach() if "Jacobian" in parts else change)

    # What is left out is a part of how vertices are glued, so that all are.
    def slides(corners, distance, plain):
        return torch.zeros_like(plain) if parts else slides_from(corners, distance, plain)

    def poorer_aim(*arguments):
        aim = aim_at_area(*arguments)
        return aim._replace(d=Vec3(*aim.d).detach() if "directions" in parts else aim.d,
                            pdf=aim.pdf.detach() if "Jacobian" in parts else aim.pdf)

    with (patch.object(outgoing_ray, "glued_direction", poorer_direction), patch.object(interaction, "slides_from", slides),
          patch.object(AreaKind, "aim", poorer_aim),
          patch.object(import_module("torch_radbp.rendering.renderer"), "compiled",
                        lambda: EAGER)):  # compiled code knows only itself
        yield
