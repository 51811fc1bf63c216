# %% [markdown]
# # Three materials, and the lamp that tells them
#
# Two of three materials look the same in a photograph. This tutorial asks, by derivatives alone, which numbers that
# photograph tells and which it does not, lets `rb.next_view` choose a lamp for a second one, and fits both at once.
# [What images cannot tell](../what_images_cannot_tell.md) has the cases in which no lamp helps.

# %%
import matplotlib.pyplot as plt
import torch

import torch_radbp as rb


def ball(x, **bsdf):
    return {"type": "sphere", "center": [x, 0, 0], "bsdf": bsdf}


def metal(x, alpha, share):
    return ball(x, type="roughconductor", material="none", distribution="ggx",
                alpha=alpha, specular_reflectance=share)


def lamp(*place):
    return {"type": "point", "position": list(place), "intensity": 0.0}


pose, paint = rb.look_at([0, 2, 12], [0, 0, 0], [0, 1, 0]), [0.6, 0.3, 0.2]
film = {"type": "hdrfilm", "width": 256, "height": 128, "rfilter": {"type": "box"}}
scene = rb.load_dict({
    "type": "scene",
    "eye": {"type": "perspective", "fov": 40, "to_world": pose, "film": film},
    "plaster": ball(-3, type="diffuse", reflectance={"type": "rgb", "value": paint}),
    "polished": metal(0, 0.1, 0.75), "brushed": metal(3, 0.35, 0.8),
    "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}},
    "above": lamp(0, 9, 0), "behind": lamp(0, 3, -12), "beside": lamp(8, 3, 6)})
power = {"above": 40.0, "behind": 90.0, "beside": 60.0}
held = {name: value for name, value in scene.named_parameters()
        if name.endswith(("alpha.value", "reflectance.value"))}
renderer = rb.Renderer(scene, spp=8, max_depth=3)


def under(each, seed, spp):
    """An image by an even sky and one of the lamps, or none."""
    for name, light in power.items():
        scene.get_parameter(f"{name}.intensity.value").data.fill_(light * (each == name))
    return renderer(seed=seed, spp=spp)[0]


def by(*lamps):
    """Such images, by each of some lamps, as a function of seed and samples."""
    return lambda seed, spp: torch.stack([under(each, seed, spp) for each in lamps])


camera = torch.Generator().manual_seed(3)  # whose noise is 0.05
photos = {each: by(each)(10**6, 128) for each in ("none", *power)}
for photo in photos.values():
    photo += 0.05 * torch.randn(photo.shape, generator=camera)
truth = {name: value.detach().clone() for name, value in held.items()}


def fit(*lamps, steps):
    """Gauss-Newton to photographs; how far off each number is, and its covariance."""
    seen = torch.cat([photos[each] for each in lamps])
    optimizer = rb.optim.GaussNewton(held.values(), scene, spp=4, max_spp=16)
    for _ in range(steps):
        optimizer.step(lambda seed, spp: by(*lamps)(seed, spp) - seen)
    off = {name: round(float((held[name] - truth[name]).abs().max()), 4) for name in held}
    return off, rb.covariance(by(*lamps), seen, held, noise=0.05, spp=4)


# %% [markdown]
# A ball of plaster, a polished and a brushed one of metal are lit by an even sky. We know neither the colour of the plaster
# nor roughness (`alpha`) and reflectance of the metals. There are three lamps, too, but they are off.
#
# ## One photograph
#
# We begin with guesses and fit all numbers to a photograph. `rb.covariance` then says how far each is known, by derivatives
# at the fit and the noise of the camera.

# %%
for name, value in held.items():
    value.data.fill_(0.2 if "alpha" in name else 0.6)
alone, first = fit("none", steps=10)
print(first, "off by:", alone, sep="\n")

# %% [markdown]
# The last line of the table is the fault of this photograph: rougher and brighter metal on the right is the same to it as
# smoother and darker, and so both numbers are found badly. None of the others is in doubt. More steps would not help.
#
# ## Which lamp?
#
# `rb.next_view` takes candidates, here the same view by each lamp, or by the sky once more, and says how much of what was
# unknown would be left after a photograph of each. It takes no photograph; derivatives at the fit are enough.

# %%
views = rb.next_view(by("none"), {each: by(each) for each in photos}, held, noise=0.05,
                     prior=dict.fromkeys(held, 0.1), spp=4)
print(views)

# %% [markdown]
# How an image changes with the two numbers shows why. By the sky alone both change the same pixels, all of the ball by one
# factor; by the lamp roughness also moves light from the middle of a highlight to its rim.

# %%
right = {name: value for name, value in held.items() if "brushed" in name}
plt.figure(figsize=(9, 7))
for row, which in enumerate(("none", views.best)):
    pictures = {"photograph": photos[which][0]} | {
        name.split(".")[2]: 0.5 + change[0] / 4
        for name, change in rb.sensitivity(by(which), right, spp=64).items()}
    for column, (title, picture) in enumerate(pictures.items()):
        axes = plt.subplot(3, 2, 2 * column + row + 1, title=f"{title}, lamp: {which}")
        axes.imshow(picture.detach().clamp(0, 1).movedim(0, -1) ** (1 / 2.2))
plt.show()

# %% [markdown]
# ## The second photograph
#
# The fit goes on from where it was, by both photographs.

# %%
both, second = fit("none", views.best, steps=4)
print(second, "off by:", both, sep="\n")

# %% [markdown]
# Errors are of the size of the deviations, about. Noise of our own renderings comes on top, which photographs do not have:
# for the polished ball, whose highlight tells most, it is the larger of the two. `radbp optimize` prints deviations at the
# end of a run, and `radbp check --covariance` before one.

# %%
assert views.best == "beside" and first.weak and not second.weak
assert all(both[name] < 0.2 * alone[name] for name in right)
