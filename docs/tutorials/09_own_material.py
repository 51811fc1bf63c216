# %% [markdown]
# # Your own material, in one file
#
# A plugin is a class under a name. A material has two parts: a *kind*, which holds the formulas and is the same
# everywhere on a surface, and textures, whose values at a point are handed to the formulas. Nothing else of the package
# needs to know it: the loader, the compiler, all strategies and samplings, forward mode and `radbp info` work with it.
#
# We write the material of Minnaert (1941), made for the moon: darker or brighter towards the edge of a ball than paint
# is. With a reflectance `r`, an exponent `k`, and the cosines `ci` and `co` of both directions,
#
#     f = r (k + 1) / (2 pi) (ci co)^(k - 1)
#
# which with k = 1 is paint.

# %%
import math
from dataclasses import dataclass

import matplotlib.pyplot as plt
import torch

import torch_radbp as rb

# %% [markdown]
# Directions are unit vectors whose `z` is along the normal; `wi` points to the viewer, `wo` to the light. Each
# component is a tensor of as many numbers as there are paths. `eval_pdf` returns the BSDF times the cosine, and the
# density with which `sample` finds a direction. Both must be finite everywhere, with finite derivatives, so we keep the
# cosine off zero.

# %%
@dataclass(frozen=True)
class MinnaertKind(rb.interface.bsdf.Kind):
    """Values: reflectance, exponent."""

    @property
    def slots(self):
        return 2

    def eval_pdf(self, values, wi, wo, fixed_lobes=False):
        above = ((wi.z > 0) & (wo.z > 0)).to(wo.z.dtype)  # the side of the normal
        r, k = values[0], values[1].x  # x: a texture of single numbers
        f = r * ((k + 1) / (2 * math.pi) * (wi.z * wo.z).clamp_min(1e-6) ** (k - 1))
        return f * (wo.z * above), wo.z.clamp_min(0) / math.pi * above

    def sample(self, values, wi, choice, u, v):
        # In proportion to the cosine.
        radius, angle, height = u.sqrt(), 2 * math.pi * v, (1 - u).clamp_min(1e-12).sqrt()
        return rb.tensors.vec.Vec3(radius * angle.cos(), radius * angle.sin(), height)


# %% [markdown]
# The keyword-only arguments of the constructor are the keys of a scene's description, with their defaults; `domains`
# says which values they may have, so that wrong ones are refused by name.

# %%
@rb.plugin.register("bsdf", "minnaert")
class Minnaert(rb.plugin.BSDF):
    """Reflects as Minnaert's moon. Parameters: `reflectance`, `exponent`, textures."""

    def __init__(self, *, reflectance: rb.plugin.Texture | float = 0.5,
                 exponent: rb.plugin.Texture | float = 1.0):
        super().__init__()
        self.reflectance = rb.texture.rgb.as_texture(self, "reflectance", reflectance)
        self.exponent = rb.texture.rgb.as_texture(self, "exponent", exponent)

    def domains(self):
        return {"reflectance": rb.plugin.domain.REFLECTANCE,
                "exponent": rb.plugin.domain.Domain(low=0.0, high=10.0)}

    def kind(self):
        return MinnaertKind()

    def textures(self):
        return self.reflectance, self.exponent


# %%
def moon(exponent):
    """A scene with a ball of this material, lit from the front."""
    camera = {"type": "perspective", "fov": 30.0,  # looks along z
              "film": {"type": "hdrfilm", "width": 128, "height": 128}}
    sun = {"type": "directional", "direction": [-0.2, -0.3, 1.0], "irradiance": 3.0}
    ball = {"type": "sphere", "center": [0, 0, 4],
            "bsdf": {"type": "minnaert", "reflectance": 0.6, "exponent": exponent}}
    return rb.load_dict({"type": "scene", "camera": camera, "ball": ball, "sun": sun,
                         "sky": {"type": "constant", "radiance": 0.1}})


moons = torch.cat([rb.render(moon(k), spp=64)[0] for k in (0.6, 1.0, 1.8)], -1)
plt.imshow(moons.clamp(0, 1).permute(1, 2, 0) ** (1 / 2.2))
plt.title("k = 0.6, 1 (paint) and 1.8")
plt.axis("off")
plt.show()

# %% [markdown]
# ## Is it right?
#
# Its derivative must be that of differences, and the exponent must be found again.

# %%
scene = moon(1.3)
check = rb.check_gradient(scene, "ball.bsdf.exponent.value", spp=64)
print(check)
target = rb.render(scene, spp=64, seed=1).detach()
exponent = scene.get_parameter("ball.bsdf.exponent.value")
exponent.requires_grad_().data.fill_(1.0)
renderer, optimizer = rb.Renderer(scene, spp=2), torch.optim.Adam([exponent], lr=0.03)
for step in range(60):
    optimizer.zero_grad()
    (renderer(seed=step) - target).square().mean().backward()
    optimizer.step()
print(f"the exponent is 1.3, found: {exponent.item():.3f}")

# %% [markdown]
# All of that would agree for a wrong material, too: if `eval_pdf` stated half of its density, images would be too bright,
# and the derivatives right for images that are too bright. Only the material by itself tells. `check_bsdf` compares what it
# says with what it does: whether its density integrates to one and its samples follow it, whether it is reciprocal and
# keeps to the energy that arrives, and whether all is finite, at grazing angles and at the ends of `domains`, too.
#
# A model that is known to be otherwise says so in its kind, as `conserves = False` or `reciprocal = False`. This one would
# have to say the former to be used with k < 1: its albedo is `r ci^(k - 1)`. (`check_emitter` and `check_texture` are for
# plugins of these kinds.)

# %%
material = rb.check_bsdf(scene.ball.bsdf)
bright = rb.check_bsdf({"type": "minnaert", "exponent": 0.6})
print(material, f"with k = 0.6: {bright.failed}", sep="\n")
assert check.agrees and abs(exponent.item() - 1.3) < 0.02
assert material.agrees and bright.failed == ("energy",)
