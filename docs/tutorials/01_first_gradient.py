# %% [markdown]
# # A first gradient
#
# A renderer is a torch module: it takes a seed and returns images, and `loss.backward()` gives the derivative of the
# loss by everything in the scene that `requires_grad`. Here we take the Cornell box, paint its green wall grey, and
# find the green again from one image.

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
# A scene is a tree of modules, read from Mitsuba's XML. What a parameter is called, `radbp info scene.xml` says.

# %%
scene = rb.load(rb.asset("cornell_box/scene.xml"), resolution=128)
target = rb.render(scene, spp=128, max_depth=5, seed=1)[0]
green = scene.get_parameter("green.reflectance.value")
truth = green.detach().clone()
green.data.fill_(0.5)
before = rb.render(scene, spp=64, max_depth=5)[0]
print("true reflectance:", truth.tolist())

# %% [markdown]
# ## The derivative, as an image
#
# Forward mode answers "how does each pixel change if this number grows?". The wall itself gets brighter, and so, by a
# little, does everything that it lights. This light has bounced at least twice, so it is what a rasteriser would miss.

# %%
tangents = {"green.reflectance.value": torch.ones(3)}
derivative = rb.jvp(scene, tangents, spp=128, seed=0, max_depth=5)[0]
show(before=before, target=target, derivative=derivative)

# %% [markdown]
# ## The loop
#
# Any optimiser, any loss. The seed changes in every step, so that no noise is fitted; the image and its derivative have
# samples of their own, so that the gradient is unbiased ([the next tutorial](02_samples_and_losses.md) shows why).

# %%
green.requires_grad_()
renderer = rb.Renderer(scene, spp=4, max_depth=5)
optimizer = torch.optim.Adam([green], lr=0.05)
# Small steps at the end average the noise out.
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 100)
losses = []
for step in range(100):
    optimizer.zero_grad()
    loss = (renderer(seed=step)[0] - target).square().mean()
    loss.backward()
    optimizer.step()
    schedule.step()
    scene.clamp_()
    losses.append(loss.item())

# %%
show(before=before, target=target, after=rb.render(scene, spp=64, max_depth=5)[0])
plt.figure(figsize=(5, 3))
plt.semilogy(losses)
plt.xlabel("step")
plt.ylabel("squared error")
plt.show()
error = (green - truth).abs().max().item()
print(f"found {green.detach().numpy().round(3)}, off by {error:.3f} at most")
assert error < 0.01
