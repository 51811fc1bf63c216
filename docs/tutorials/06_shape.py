# %% [markdown]
# # Shape: from a ball to something else
#
# The gradient by vertices is a rough thing: every triangle gets what its few samples say, and an optimiser that follows
# it tangles the mesh. Large steps (Nicolet et al. 2021) change the variables, so that a step moves the whole shape
# smoothly. Here a ball becomes a rounded cube, seen by four cameras.

# %%
import matplotlib.pyplot as plt
import torch
import trimesh

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
# ## The scene, and what we look for
#
# Four cameras around the thing, a lamp and an even sky. The target has a mesh of its own: nobody knows its triangles.

# %%
def mesh(ball):
    """A mesh of a dict scene, with smooth normals that follow from its vertices."""
    return {"type": "mesh", "vertex_positions": torch.tensor(ball.vertices).float(),
            "faces": torch.tensor(ball.faces), "recompute_normals": True,
            "bsdf": {"type": "diffuse", "reflectance": 0.6}}


def scene_of(thing):
    """The scene with a thing in its middle."""
    eyes = [[3.5, 0, 1.5], [0, 3.5, 1.5], [-3.5, 0, -1.5], [0, -3.5, -1.5]]
    film = {"type": "hdrfilm", "width": 128, "height": 128}
    cameras = {f"view_{number}": {"type": "perspective", "fov": 42.0, "film": film,
                                  "to_world": rb.look_at(eye, [0.0, 0, 0], [0.0, 0, 1])}
               for number, eye in enumerate(eyes)}
    lamp = {"type": "directional", "direction": [-1.0, -0.6, -0.8], "irradiance": 2.0}
    return rb.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 2},
                         "thing": thing, "lamp": lamp,
                         "sky": {"type": "constant", "radiance": 0.4}} | cameras)


cube = trimesh.creation.icosphere(4)
cube.vertices /= (cube.vertices**4).sum(1, keepdims=True) ** 0.25  # x^4 + y^4 + z^4 = 1
target = rb.render(scene_of(mesh(cube)), spp=64, seed=1)
scene = scene_of(mesh(trimesh.creation.icosphere(3, radius=0.9)))
before = rb.render(scene, spp=64)

# %% [markdown]
# ## Large steps
#
# `LargeSteps` stands before `vertex_positions` as a parametrisation; `AdamUniform` is the optimiser that leaves its
# gradients smooth. Its steps are measured by the largest gradients that it remembers, and the first ones, of a thing that is
# far off, are the largest of all: with the usual betas, (0.9, 0.999), these would make all others small.
# Edges count: nothing but the outline says how large the thing is, against the sky.

# %%
thing = scene.thing
steps = rb.optim.LargeSteps(thing.faces, thing.vertex_positions, smoothness=10)
torch.nn.utils.parametrize.register_parametrization(thing, "vertex_positions", steps)
smooth = thing.parametrizations.vertex_positions.original.requires_grad_()
optimizer = rb.optim.AdamUniform([smooth], lr=0.1, betas=(0.8, 0.95))
schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.963)
renderer = rb.Renderer(scene, spp=1, share_samples=True)
for step in range(80):
    optimizer.zero_grad()
    images = renderer(seed=2 * step), renderer(seed=2 * step + 1)
    rb.losses.two_buffer_l2(*images, target).backward()
    optimizer.step()
    schedule.step()

# %%
after = rb.render(scene, spp=64).detach()
show(before=before[0], target=target[0], after=after[0])
show(before=before[3], target=target[3], after=after[3])


def distance(vertices):
    """The mean distance to (x^4 + y^4 + z^4)^(1/4) = 1, to first order."""
    f = (vertices**4).sum(1) ** 0.25
    slope = (vertices**3 / f[:, None] ** 3).norm(dim=1)
    return ((f - 1).abs() / slope).mean().item()


vertices = thing.vertex_positions.detach()
start = distance(0.9 * torch.nn.functional.normalize(vertices, dim=1))
found = distance(vertices)
print(f"mean distance of the vertices: {start:.3f} before, {found:.3f} after")
assert found < 0.25 * start
