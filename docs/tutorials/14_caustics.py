# %% [markdown]
# # Caustics: light from the lamps
#
# Light that glass or a mirror gathers is a *caustic*. Paths that start at the camera do not find it: they would have to
# meet a lamp by chance, and a point, a spot or the sun is never met. `light_paths` of `Renderer` says which light comes
# by paths that start at the lamps instead:
#
# * `"camera"`: none;
# * `"caustics"`: light that comes to a rough surface by way of glass, mirrors or other smooth surfaces;
# * `"all"`: all of it, as Mitsuba's integrator `ptracer`, whose name in a scene means the same;
# * `"auto"`, where nothing is said: caustics, where a scene has some that the camera's paths cannot find, and where
#   mirrors or glass turn by a derivative, beside lamps whose edges in them the camera's paths would pass unseen.
#
# Nothing counts twice. Derivatives are those of the same recursion, from the camera to the lamp.

# %%
import matplotlib.pyplot as plt
import torch

import torch_radbp as rb


def show(**images):
    """Images (C, H, W) side by side; one channel from its least to its largest value."""
    plt.figure(figsize=(3 * len(images), 3.2))
    for place, (title, image) in enumerate(images.items(), 1):
        plt.subplot(1, len(images), place, title=title)
        picture = image.detach().clamp(max=1).movedim(0, -1)
        coloured = picture.shape[-1] == 3
        plt.imshow(picture ** (1 / 2.2) if coloured else picture, cmap="gray")
        plt.axis("off")
    plt.show()


# %% [markdown]
# ## A ball of glass under a spotlight
#
# Only the floor is in view. Without paths from the lamp the shadow of the ball is black.

# %%
ball = rb.load(rb.asset("lens/scene.xml"), resolution=128)
ways = "camera", "caustics"
show(**{way: rb.render(ball, spp=64, light_paths=way)[0] for way in ways})

# %% [markdown]
# What is bright, and where, tells how strongly the glass refracts. Its index of refraction is found from the caustic. The
# derivative flows through where light lands on the film, so the film needs a filter that is smooth: a `gaussian`. A `box`
# has no derivative there, and a warning says so.

# %%
target = rb.render(ball, spp=256, seed=1)
eta = ball.get_parameter("ball.bsdf.eta")
truth = eta.item()
eta.data.fill_(1.7)


def optimise(renderer, target, parameter, steps, lr):
    """Steps of Adam on the two-buffer loss, ever smaller; the losses."""
    optimizer = torch.optim.Adam([parameter.requires_grad_()], lr=lr, betas=(0.9, 0.95))
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.02 ** (1 / steps))
    losses = []
    for step in range(steps):
        optimizer.zero_grad()
        images = renderer(seed=2 * step), renderer(seed=2 * step + 1)
        losses.append(rb.losses.two_buffer_l2(*images, target))
        losses[-1].backward()
        optimizer.step()
        schedule.step()
    return torch.stack(losses).detach()


optimise(rb.Renderer(ball, spp=2, share_samples=True), target, eta, steps=60, lr=0.015)
print(f"the index of refraction was 1.7, is {eta.item():.4f}, and should be {truth}")

# %% [markdown]
# ## A plate of glass
#
# Parallel light falls through a plate whose upper side has waves, as of water. They are heights of a `bumpmap`, 32 x 32
# of them: normals follow the heights, and nothing is moved. From a flat plate, whose light is even, the loss finds the
# heights by which light goes where it should. Heights have no absolute level, since only slopes are seen.

# %%
plate = rb.load(rb.asset("caustic/scene.xml"))
target = rb.render(plate, spp=256, seed=1)
heights = plate.plate.bsdf.nested_texture
true_heights = heights.data.detach().clone()
heights.data.data.zero_()
flat = rb.render(plate, spp=64)
grid = rb.optim.CoarseToFine((16, 16))
torch.nn.utils.parametrize.register_parametrization(heights, "data", grid)
renderer = rb.Renderer(plate, spp=8, share_samples=True)
coarse = heights.parametrizations.data.original
losses = optimise(renderer, target, coarse, steps=80, lr=5e-4)
found = heights.data.detach()
show(before=flat[0], target=target[0], after=rb.render(plate, spp=64)[0])
show(found=found.movedim(-1, 0), truth=true_heights.movedim(-1, 0))
both = torch.stack([found.flatten(), true_heights.flatten()])
alike = torch.corrcoef(both)[0, 1].item()
print(f"loss {losses[0]:.4f}, now {losses[-5:].mean():.4f}")
print(f"correlation of heights: {alike:.2f}")

# %% [markdown]
# The grid of 16 x 16 cells finds large waves first; `rb.optim.refine` goes on with more, and so does the recipe: `radbp
# optimize caustic`. What neither direction finds is a caustic of a point light that is itself seen in a mirror or through
# glass; a warning names it.

# %%
assert abs(eta.item() - truth) < 0.01
assert losses[-5:].mean() < 0.4 * losses[0] and alike > 0.8
