"""A material whose normals an image turns.

With n the turned normal in the frame of the surface, all functions of the nested kind are called with directions in the
frame around n. Two things are as in Mitsuba:

* A normal that faces away from the viewer would make the surface black. It is turned about the surface's own normal by half
  a turn (Schuessler et al. 2017), unless `flip_invalid_normals` is off. Where that happens the BSDF jumps.
* Light that lies above one horizon and below the other is lost. Towards the surface's own horizon the BSDF fades by

      2 / (1 + sqrt(1 + min(tan^2(n) / 8, 1) tan^2(wo)))

  (Conty Estevez et al. 2019, equation 4), unless `use_shadowing_function` is off. Then it jumps there.

Reference: Schuessler et al. 2017, "Microfacet-based Normal Mapping for Robust Monte Carlo Path Tracing"; Conty Estevez,
Lecocq and Stein 2019, "A Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem".
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_radbp.bsdf.kind import Choice, Kind, Values, on_horizon_unless
from torch_radbp.domain import Domain
from torch_radbp.plugin import BSDF, Texture, boolean, register
from torch_radbp.texture.rgb import as_texture
from torch_radbp.vec import Frame, Vec3, dot, where

SHORTEST = 1e-8  # squared length of a normal; one that is shorter counts as not turned
FLATTEST = 1e-12  # squared cosine in a tangent


@dataclass(frozen=True)
class NormalMapKind(Kind):
    """Values: the turned normal as a colour (n + 1) / 2, those of the nested kind."""

    nested: Kind
    flip: bool
    shadowing: bool

    @property
    def delta(self) -> bool:
        return self.nested.delta

    @property
    def smooth(self) -> bool:
        return self.nested.smooth

    @property
    def discrete(self) -> bool:
        return self.nested.discrete

    @property
    def oriented(self) -> bool:
        return True

    @property
    def transmits(self) -> bool:
        return self.nested.transmits

    @property
    def jumps(self) -> bool:
        return self.nested.jumps

    @property
    def slots(self) -> int:
        return 1 + self.nested.slots

    @property
    def steering(self) -> tuple[int, ...]:
        return 0, *(1 + k for k in self.nested.steering)

    @property
    def bending(self) -> tuple[int, ...]:
        return (0, *(1 + k for k in self.nested.bending)) if self.delta else ()

    def frame(self, values: Values, wi: Vec3) -> Frame:
        """The frame around the turned normal, in that of the surface; attached."""
        one = torch.ones_like(wi.z)
        n = values[0] * 2.0 - Vec3(one, one, one)
        if self.flip:
            sign = 1.0 - 2.0 * (wi.z * dot(wi, n) <= 0).to(wi.z.dtype)
            n = Vec3(n.x * sign, n.y * sign, n.z)
        squared = dot(n, n)
        turned = squared > SHORTEST
        n = n * torch.rsqrt(torch.where(turned, squared, 1.0))
        none = torch.zeros_like(one)
        return Frame.along(where(turned, n, Vec3(none, none, one)), Vec3(one, none, none))

    def passes(self, frame: Frame, wo: Vec3, turned: Vec3) -> Tensor:
        """The part of the light that is kept, in [0, 1]: none if it crosses only one of the two horizons."""
        kept = (wo.z * turned.z > 0).to(wo.z.dtype)
        if not self.shadowing:
            return kept
        steep = (0.125 * squared_tangent(frame.n)).clamp_max(1.0)
        return kept * (2.0 / (1.0 + torch.sqrt(1.0 + steep * squared_tangent(wo))))

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        frame = self.frame(values, wi)
        turned = frame.to_local(wo)
        value, pdf = self.nested.eval_pdf(values[1:], frame.to_local(wi), turned, fixed_lobes)
        return value * self.passes(frame, wo, turned), pdf * (wo.z * turned.z > 0).to(pdf.dtype)

    def choose(self, values: Values, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor) -> Choice:
        return self.nested.choose(values[1:], self.frame(values, wi).to_local(wi).detach(), choice, u, v)

    def sample(self, values: Values, wi: Vec3, choice: Choice, u: Tensor, v: Tensor) -> Vec3:
        frame = self.frame(values, wi)
        turned = self.nested.sample(values[1:], frame.to_local(wi), choice, u, v)
        wo = frame.to_world(turned)
        return on_horizon_unless(wo.z * turned.z > 0, wo)

    def chance_by_direction(self, values: Values, wi: Vec3, wo: Vec3, choice: Choice) -> Tensor | None:
        frame = self.frame(values, wi)
        return self.nested.chance_by_direction(values[1:], frame.to_local(wi), frame.to_local(wo), choice)

    def specular(self, values: Values, wi: Vec3, choice: Choice) -> Vec3:
        frame = self.frame(values, wi)
        local, number = frame.to_local(wi), torch.full_like(wi.z, 0.5)  # directions of delta lobes depend on no number
        turned = self.nested.sample(values[1:], local, choice, number, number)
        return self.nested.specular(values[1:], local, choice) * self.passes(frame, frame.to_world(turned), turned)


def squared_tangent(w: Vec3) -> Tensor:
    """The squared tangent of the angle between the unit vector `w` and the normal."""
    cosine2 = (w.z * w.z).clamp_min(FLATTEST)
    return ((1.0 - cosine2) / cosine2).clamp_min(0.0)


@register("bsdf", "normalmap")
class NormalMap(BSDF):
    """A material seen as if the surface had other normals, which an image gives relative to the shading frame.

    Parameters: `normalmap`, a texture: the normal n as a colour (n + 1) / 2, so that (0.5, 0.5, 1) turns nothing; its length
    does not matter. Derivatives: with respect to its texels, and to the parameters of the material. What is discontinuous in
    the normal (see the module's docstring) has no derivative where it jumps.

    Args:
        normalmap: read with `raw`, or sRGB is decoded that was never encoded. x points to where the coordinate u grows.
        nested_bsdf: the material.
        flip_invalid_normals: turn normals round that face away from the viewer.
        use_shadowing_function: let light fade towards the horizon of the surface.
    """

    def __init__(self, *, normalmap: Texture, nested_bsdf: BSDF, flip_invalid_normals: bool = True,
                 use_shadowing_function: bool = True):
        super().__init__()
        self.normalmap = as_texture(self, "normalmap", normalmap)
        self.nested_bsdf = nested_bsdf
        self.flip_invalid_normals = boolean("flip_invalid_normals", flip_invalid_normals)
        self.use_shadowing_function = boolean("use_shadowing_function", use_shadowing_function)

    def domains(self) -> dict[str, Domain]:
        return {"normalmap": Domain(limit=1e6)}

    def kind(self) -> Kind:
        """The scattering functions."""
        return NormalMapKind(self.nested_bsdf.kind(), self.flip_invalid_normals, self.use_shadowing_function)

    def textures(self) -> tuple[Texture, ...]:
        """What the functions take, in order."""
        return self.normalmap, *self.nested_bsdf.textures()
