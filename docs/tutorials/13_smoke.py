# %% [markdown]
# # Smoke: a density from five views
#
# Light travels through smoke, is absorbed and scattered there, and no surface stops it. What differs from point to point
# is the *extinction*: how much of the light a unit of length takes. Here it is found on a grid from five images, by the
# set-up of Mitsuba's tutorial on volumes: cameras on a half circle, a grid that grows from coarse to fine, and Adam.

# %%
import math

import matplotlib.pyplot as plt
import torch
from torch.nn.utils.parametrize import register_parametrization

import torch_radbp as rb

# %% [markdown]
# ## A medium in a box
#
# A medium stands in a shape as its `interior`, here a cube. A shape whose material is `null` is only a boundary: light
# passes it straight. Within it, `heterogeneous` reads the extinction `sigma_t` from a volume, times `scale`. `albedo` is
# the share of it that is scattered; the rest is absorbed. (A flame also has an `emission`, the radiance that it sends out
# per unit of length: another volume, with derivatives likewise.) A `gridvolume` fills the unit cube [0, 1]^3; `to_world`
# moves it to where the smoke is. Its `data` has the axes (Z, Y, X, channels). It also reads NanoVDB files, by `filename`.

# %%
box = torch.tensor([[2.0, 0, 0, -1], [0, 2, 0, -1], [0, 0, 2, -1], [0, 0, 0, 1]])


def camera(angle):
    place = [4.4 * math.sin(angle), 0.8, 4.4 * math.cos(angle)]
    film = {"type": "hdrfilm", "width": 128, "height": 128, "rfilter": {"type": "tent"}}
    return {"type": "perspective", "fov": 35, "film": film,
            "to_world": rb.look_at(place, [0, 0, 0], [0, 1, 0])}


def smoke_scene(data, scale=10, sky=0.1):
    """Smoke of a density (Z, Y, X, 1) by a dim sky and a sun, and five cameras."""
    density = {"type": "gridvolume", "data": data, "to_world": box}
    medium = {"type": "heterogeneous", "sigma_t": density, "scale": scale, "albedo": 0.8}
    smoke = {"type": "cube", "bsdf": {"type": "null"}, "interior": medium}
    sun = {"type": "directional", "direction": [1, -1, -1], "irradiance": 4.5}
    light = {"sky": {"type": "constant", "radiance": sky}, "sun": sun}
    views = {f"view_{k}": camera(k * math.pi / 5) for k in range(5)}
    return rb.load_dict({"type": "scene", "smoke": smoke} | light | views)


def plume(count):
    """A density (Z, Y, X, 1) that rises along y, turns, and becomes wider and thinner."""
    z, y, x = torch.meshgrid(*[(torch.arange(count) + 0.5) / count] * 3, indexing="ij")
    a, b = x - 0.5 - 0.25 * y * (6 * y).cos(), z - 0.5 - 0.25 * y * (6 * y).sin()
    return ((1 - (a**2 + b**2) / (0.07 + 0.2 * y) ** 2).clamp_min(0) * (1 - y))[..., None]


truth = plume(count=32)
targets = rb.render(smoke_scene(truth), spp=256, seed=10**6)  # (5, 3, 128, 128)

# %% [markdown]
# ## The loop
#
# We start from thin fog. The grid is `scene.get_parameter("smoke.interior.sigma_t.data")`. Extinction must not be
# negative: `rb.optim.Sigmoid` keeps the grid between 0 and 1, which is what we know of it. (`scene.clamp_()` or
# `rb.optim.bounded(optimizer, scene)` cut off after each step instead.) `rb.optim.CoarseToFine` changes the grid by a
# coarser one that grows: large shapes first, and less noise. A grid of another size can also be assigned at any time:
# `scene.smoke.interior.sigma_t.data = torch.nn.Parameter(larger)`.

# %%
scene = smoke_scene(torch.full_like(truth, 0.02))
volume = scene.smoke.interior.sigma_t
grid = rb.optim.CoarseToFine((8, 8, 8), within=rb.optim.Sigmoid())
register_parametrization(volume, "data", grid)
optimizer = torch.optim.Adam(volume.requires_grad_().parameters(), lr=0.2)
renderer = rb.Renderer(scene, spp=4, share_samples=True)
losses = []
for step in range(90):
    optimizer.zero_grad()
    loss = rb.losses.two_buffer_l2(renderer(seed=step), renderer(seed=step + 90), targets)
    loss.backward()
    optimizer.step()
    losses.append(loss.item())
    if step in (29, 59, 89):
        print(f"{grid.size}: loss {losses[0]:.6f}, now {sum(losses[-5:]) / 5:.6f}")
        rb.optim.refine(volume, "data", optimizer)
        optimizer.param_groups[0]["lr"] /= 2

# %% [markdown]
# ## What came out
#
# A density is looked at as a sum along an axis, as an X-ray picture, and as a slice through the middle.


# %%
def draw(labels, **rows):
    plt.figure(figsize=(9, 4)).add_axes((0, 0, 1, 1)).axis("off")
    plt.imshow(rb.contact_sheet(rows, labels).movedim(0, -1) ** (1 / 2.2))
    plt.show()


def shown(density):
    """Sums along z and along y, and a cut at half the depth: (3, 1, Z or Y, X)."""
    density = density.movedim(-1, 0).flip(2)
    cut = density[:, density.shape[1] // 2]
    return torch.stack([4 * density.mean(1), 4 * density.mean(2), cut])


found = volume.data.detach()
draw(list(scene.named_sensors), targets=targets, found=rb.render(scene, spp=64))
draw(["sum along z", "sum along y", "cut"], truth=shown(truth), found=shown(found))
alike = torch.corrcoef(torch.stack([found.flatten(), truth.flatten()]))[0, 1].item()
print(f"correlation with the true density: {alike:.3f}")

# %% [markdown]
# ## What the images cannot tell
#
# Extinction is `sigma_t` times `scale`: one of them must be given. Of thin smoke the product of density and albedo is
# seen, so that albedo must be given, too; dense smoke shadows itself, and tells them apart. Derivatives say so before any
# run: the density grows by 1 % while the albedo falls by 1 %. How much is left of the change of the image by density
# alone? (Dense smoke changes more with albedo than with density, hence more than 100 %.)

# %%
for scale in (10, 0.1):
    smoke = smoke_scene(truth, scale, sky=0)
    denser = {"smoke.interior.sigma_t.data": 0.01 * truth}
    both = denser | {"smoke.interior.albedo.value.value": torch.tensor(-0.008)}
    alone, both = (rb.jvp(smoke, each, spp=64).norm() for each in (denser, both))
    print(f"scale {scale}: {100 * both / alone:.0f} % is left")

# %% [markdown]
# What lies behind dense smoke, and sides that no camera sees, are guesses. Cells that hardly change any image keep the noise
# of the steps, which shows in slices more than in sums. More views help, and so does light from more sides.
# [A page](../what_images_cannot_tell.md) tells more.

# %%
assert sum(losses[-5:]) / 5 < losses[0] / 50 and alike > 0.85
