# %% [markdown]
# # How many samples, and which loss
#
# A rendering is an estimate: the true image plus noise that is zero on average. A loss that is not linear in the image
# does not leave this noise alone. This tutorial shows what goes wrong if image and derivative share it, what the
# renderer does about that by itself, and how few samples are enough.

# %%
import matplotlib.pyplot as plt
import torch

import torch_radbp as rb

scene = rb.load(rb.asset("cornell_box/scene.xml"), resolution=32)
target = rb.render(scene, spp=1024, max_depth=4, seed=1)
red = scene.get_parameter("red.reflectance.value")
truth = red.detach().clone()
red.requires_grad_()

# %% [markdown]
# ## The gradient where it should be zero
#
# At the true reflectance the true image is the target, and the gradient of the squared error is zero: no direction
# makes it better. What do 300 estimates by four samples for each pixel say, on average?
#
# Let a pixel's estimate be `I + e`, with the true value `I` and noise `e`, and its derivative `dI + d`, with noise `d`.
# The gradient of the squared error is `2 (I + e - T) (dI + d)`, and its mean `2 (I - T) dI + 2 E[e d]`. From the same
# samples the two noises rise together (a path that happens to find the lamp is bright, and all the brighter the redder
# the wall is), so that the last term is not zero. It does not depend on the target, and it pulls towards black.


# %%
def mean_gradient(renderer, loss, count=300):
    """The mean of gradients by the reflectance of the wall, and its standard error."""
    losses = (loss(renderer, seed) for seed in range(count))
    gradients = torch.stack([torch.autograd.grad(each, red)[0].sum() for each in losses])
    return gradients.mean().item(), gradients.std().item() / count**0.5


def squared(renderer, seed):
    return (renderer(seed=seed) - target).square().mean()


def two_buffers(renderer, seed):
    first, second = renderer(seed=2 * seed), renderer(seed=2 * seed + 1)
    return rb.losses.two_buffer_l2(first, second, target)


# By default the derivative has samples of its own.
apart = rb.Renderer(scene, spp=4, max_depth=4)
shared = rb.Renderer(scene, spp=4, max_depth=4, share_samples=True)
trials = {"squared error, shared": (shared, squared),
          "squared error, apart": (apart, squared),
          "two buffers, shared": (shared, two_buffers)}
for name, trial in trials.items():
    mean, error = mean_gradient(*trial)
    print(f"{name:24} {1000 * mean:+.3f} +- {1000 * error:.3f} thousandths")

# %% [markdown]
# Samples apart, or two images of two seeds that are multiplied (`rb.losses.two_buffer_l2`, for which sharing is fine
# because the other image is independent anyway), leave no bias.
#
# ## What it does to a recovery
#
# The same three, from a grey wall, 150 steps of four samples. We look at the red of the red wall.


# %%
def recover(renderer, loss, steps=150, lr=0.03):
    """The errors of the reflectance, step by step."""
    red.data.fill_(0.5)
    optimizer = torch.optim.Adam([red], lr=lr)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    errors = []
    for step in range(steps):
        optimizer.zero_grad()
        loss(renderer, step).backward()
        optimizer.step()
        schedule.step()
        scene.clamp_()
        errors.append((red - truth)[0].item())
    return errors


found = {name: recover(*trial) for name, trial in trials.items()}
for name, errors in found.items():
    plt.plot(errors, label=name)
plt.axhline(0, color="black", linewidth=0.5)
plt.xlabel("step")
plt.ylabel("reflectance, less the true one")
plt.legend()
plt.show()

# %% [markdown]
# ## Many small steps, or few good ones?
#
# What is left of the unbiased ones is the noise of their last steps, which a learning rate that falls averages out. A
# gradient need only be right on average, so cheap steps do: as many samples in a tenth of the steps, of ten times the
# samples and larger steps, come about as near. Start with 1 to 8 samples. Take more where a loss bends sharply
# in each pixel (SSIM, logarithms): noise biases these a little, whatever the samples of the derivative are.

# %%
few = recover(rb.Renderer(scene, spp=40, max_depth=4), squared, steps=15, lr=0.1)
for name, errors in (found | {"15 steps of 40 samples": few}).items():
    print(f"{name:24} off by {errors[-1]:+.3f} at the end")
assert found["squared error, shared"][-1] < -0.05
assert abs(found["squared error, apart"][-1]) < 0.03
assert abs(found["two buffers, shared"][-1]) < 0.03
