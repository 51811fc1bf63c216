# %% [markdown]
# # Materials from several views
#
# Images of an object from all sides, with known cameras and light: which colour does it have, at every point of its
# surface? The object is a glTF asset with eight cameras. Six of them show us images; the other two are kept back, to
# see whether what is found holds where nobody looked.

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


# %%
scene = rb.load(rb.asset("pot/pot.glb"), light=0.15, max_depth=3, resolution=128)
training, kept_back = [0, 1, 2, 4, 5, 6], [3, 7]
colour = scene.get_parameter("glaze.base_color.data")  # (16, 32, 3), linear
truth = colour.detach().clone()
targets = rb.render(scene, spp=64, seed=1)  # (8, 3, 128, 128)
colour.data.fill_(0.5)
before = rb.render(scene, spp=32, sensors=kept_back)

# %% [markdown]
# Each step renders two of the six views, so that it costs what two images cost. Of each view there are two renderings,
# whose errors are multiplied: a squared error without bias ([why](02_samples_and_losses.md)). `scene.clamp_()`
# brings parameters back into their ranges, reflectances to between 0 and 1; `rb.optim.bounded(optimizer, scene)` would do so
# after each step by itself, and `rb.optim.Sigmoid()` is a parametrisation that never leaves its range.

# %%
colour.requires_grad_()
renderer = rb.Renderer(scene, spp=1, share_samples=True)
optimizer = torch.optim.Adam([colour], lr=0.03)
steps = 240
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
for step in range(steps):
    views = [training[2 * step % 6], training[(2 * step + 1) % 6]]
    optimizer.zero_grad()
    first, second = (renderer(seed=2 * step + k, sensors=views) for k in (0, 1))
    rb.losses.two_buffer_l2(first, second, targets[views]).backward()
    optimizer.step()
    schedule.step()
    scene.clamp_()

# %%
after = rb.render(scene, spp=64, sensors=kept_back).detach()
show(before=before[0], target=targets[3], after=after[0])
show(found=colour.permute(2, 0, 1), truth=truth.permute(2, 0, 1))


# %% [markdown]
# Views that were kept back agree as well as the others. Texels that are hardly in view, at the foot of the pot and
# below its lid, are what is left of the error: nothing in the images says what they are, and a prior would fill them
# in.
#
# Other maps are found in the same way by their names, `glaze.roughness.data` and `glaze.metallic.data`, but they show
# less: where little light is mirrored, roughness hardly changes an image, and it takes more samples than fit here
# before it is more than noise. The recipe `pot_maps` (`radbp optimize pot_maps`) takes the two minutes.

# %%
def psnr(images):
    """Peak signal to noise of images of the views kept back, in decibels."""
    return -10 * (images - targets[kept_back]).square().mean().log10().item()


error = (colour - truth).square().mean().sqrt().item()
print(f"kept back: {psnr(before):.1f} dB before, {psnr(after):.1f} dB after")
of_grey = (truth - 0.5).square().mean().sqrt().item()
print(f"colour off by {error:.3f} (RMS over the texels); grey is by {of_grey:.3f}")
assert psnr(after) > psnr(before) + 10 and error < 0.1
