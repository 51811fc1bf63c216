# %% [markdown]
# # A network in the light path
#
# Any `nn.Module` from surface coordinates or positions to values can stand in the place of a texture. It runs on the
# points that paths meet, bounce by bounce, and its weights get gradients like everything else. Here a small network
# becomes the painting on the wall of a room.

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
scene = rb.load(rb.asset("textured_room/scene.xml"), resolution=128, max_depth=4)
target = rb.render(scene, spp=128, seed=1).detach()
painting = scene.painting.bsdf.reflectance.data.detach().clone()  # (64, 64, 3)


# %% [markdown]
# A network of coordinates alone learns blurs; sines and cosines of them, of many frequencies, let it have edges. The
# frequencies are fixed, so they are a buffer.

# %%
class Waves(torch.nn.Module):
    """Sines and cosines of coordinates (N, 2), of random frequencies."""

    def __init__(self, count, frequency):
        super().__init__()
        self.register_buffer("frequencies", frequency * torch.randn(2, count))

    def forward(self, uv):
        phases = uv @ self.frequencies
        return torch.cat([phases.sin(), phases.cos()], -1)


torch.manual_seed(0)
network = torch.nn.Sequential(Waves(48, 20.0), torch.nn.Linear(96, 48), torch.nn.ReLU(),
                              torch.nn.Linear(48, 48), torch.nn.ReLU(),
                              torch.nn.Linear(48, 3), torch.nn.Sigmoid())
scene.painting.bsdf.reflectance = rb.NeuralTexture(network)
before = rb.render(scene, spp=64).detach()
print(sum(weights.numel() for weights in network.parameters()), "weights, such as",
      "painting.bsdf.reflectance.module.1.weight")

# %%
renderer = rb.Renderer(scene, spp=1, share_samples=True)
optimizer = torch.optim.Adam(network.parameters(), lr=0.01)
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 120)
for step in range(120):
    optimizer.zero_grad()
    images = renderer(seed=2 * step), renderer(seed=2 * step + 1)
    rb.losses.two_buffer_l2(*images, target).backward()
    optimizer.step()
    schedule.step()

# %% [markdown]
# Other programs read bitmaps: `rb.bake.bitmap` reads the network at the centres of texels, from v = 0 on. The original
# has its first row at the top of the wall, v = 1.

# %%
found = rb.bake.bitmap(scene.painting.bsdf.reflectance, 64).data.flip(0)
show(before=before[0], target=target[0], after=rb.render(scene, spp=64)[0])
show(network=found.permute(2, 0, 1), painting=painting.permute(2, 0, 1))
error = (found - painting).square().mean().sqrt().item()
of_grey = (0.5 - painting).square().mean().sqrt().item()
print(f"off by {error:.3f} (root mean square); plain grey would be by {of_grey:.3f}")
assert error < 0.12
