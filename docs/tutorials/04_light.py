# %% [markdown]
# # Light: an environment map, and a lamp
#
# Light is a parameter like others. First a whole sky, texel by texel, from two photographs of two balls; then the place
# of a lamp that is not in view.

# %%
import matplotlib.pyplot as plt
import torch

import torch_radbp as rb


def show(**images):
    """Linear images (3, H, W) side by side, on the screen's scale."""
    plt.figure(figsize=(3 * len(images), 3.2))
    for place, (title, image) in enumerate(images.items(), 1):
        plt.subplot(1, len(images), place, title=title)
        plt.imshow(image.detach().clamp(0, 1).permute(1, 2, 0) ** (1 / 2.2))
        plt.axis("off")
    plt.show()


# %% [markdown]
# ## A sky
#
# Radiance spans orders of magnitude and must not be negative, so we look for its logarithm:
# `torch.nn.utils.parametrize` puts any module before a parameter, and the optimiser sees what goes in.

# %%
class Exponential(torch.nn.Module):
    """A positive number by its logarithm."""

    def forward(self, logarithm):
        return logarithm.exp()

    def right_inverse(self, value):
        return value.log()


scene = rb.load(rb.asset("lit_balls/scene.xml"), resolution=128)
truth = scene.sky.data.detach().clone()
targets = rb.render(scene, spp=128, seed=1).detach()
scene.sky.data.data.fill_(0.5)
before = rb.render(scene, spp=64).detach()
torch.nn.utils.parametrize.register_parametrization(scene.sky, "data", Exponential())
logarithm = scene.sky.parametrizations.data.original.requires_grad_()


# %%
def optimise(renderer, targets, parameters, steps, lr):
    """Steps of Adam on the two-buffer loss."""
    optimizer = torch.optim.Adam(parameters, lr=lr)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for step in range(steps):
        optimizer.zero_grad()
        images = renderer(seed=2 * step), renderer(seed=2 * step + 1)
        rb.losses.two_buffer_l2(*images, targets).backward()
        optimizer.step()
        schedule.step()


renderer = rb.Renderer(scene, spp=1, share_samples=True)
optimise(renderer, targets, [logarithm], steps=200, lr=0.1)
after = rb.render(scene, spp=64).detach()
show(before=before[0], target=targets[0], after=after[0])
show(found=scene.sky.data.permute(2, 0, 1), truth=truth.permute(2, 0, 1))

# %% [markdown]
# What a ball of metal mirrors comes out sharp; what only the ball of plaster sees is known as a sum over half of the
# sky. Texels that hardly matter keep noise, which a smoothness prior would remove. What counts is the light on a thing
# that was not there.

# %%
other = rb.load(rb.asset("lit_balls/scene.xml"), resolution=128)
other.get_parameter("metal_ball.bsdf.alpha.value").data.fill_(0.3)  # much rougher
relit = []
for sky in truth, scene.sky.data.detach():
    other.sky.data.data.copy_(sky)
    relit.append(rb.render(other, spp=128, seed=3)[0].detach())
show(by_the_true_sky=relit[0], by_the_sky_found=relit[1])
difference = (relit[1] - relit[0]).square().mean().sqrt()
relighting = (difference / relit[0].mean()).item()
print(f"the light on another metal is off by {100 * relighting:.1f} percent")

# %% [markdown]
# ## A lamp that is not in view
#
# A point of light before a patterned wall and above a floor; only what it lights is seen. Its position has a derivative
# like everything else.

# %%
room = rb.load(rb.asset("point_light/scene.xml"), resolution=128)
view = rb.render(room, spp=128, seed=1).detach()
position = room.get_parameter("lamp.position")
place = position.detach().clone()
position.data += torch.tensor([-0.6, 0.4, 0.5])
start = rb.render(room, spp=64).detach()
renderer = rb.Renderer(room, spp=1, share_samples=True)
optimise(renderer, view, [position.requires_grad_()], steps=120, lr=0.04)
show(before=start[0], target=view[0], after=rb.render(room, spp=64)[0])
distance = (position - place).norm().item()
print(f"the lamp was off by 0.88, and is by {distance:.3f}")
assert relighting < 0.05 and distance < 0.02
