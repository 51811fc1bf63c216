# %% [markdown]
# # Poses of objects and cameras, with shadows
#
# When something moves, an image changes in three ways: surfaces get lighter or darker, outlines move, and so do the
# borders of shadows. The last two are jumps, of which a plain derivative of the samples knows nothing. By default all
# three are there: `terms=("interior", "primary", "shadow")`.

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
# ## A derivative by term
#
# A block hangs above the floor, out of view; two lamps throw two shadows of it. How does the image change when the
# block moves to the right? Without the term of shadows the answer is nothing at all.

# %%
scene = rb.load(rb.asset("shadow/scene.xml"), resolution=128)
right = torch.zeros(4, 4)
right[0, 3] = 1.0
settings = {"spp": 64, "seed": 0}
all_terms = rb.jvp(scene, {"block.to_world": right}, **settings)[0]
show(image=rb.render(scene, spp=64)[0], brighter=all_terms / 2, darker=-all_terms / 2)

# %% [markdown]
# ## The pose of the block, by its shadows
#
# `rb.se3` makes a rigid motion of six numbers: three of rotation, three of translation. The scene keeps a matrix,
# `to_world`; in each step `torch.func.functional_call` renders with the one that follows from the six numbers, and they
# get the gradient.

# %%
def moved(pose, motion):
    """A pose turned about its origin by motion[0], and moved by motion[1]."""
    still = torch.zeros(3)
    place = rb.se3(still, pose[:3, 3])
    turned = place @ rb.se3(motion[0], still) @ place.inverse() @ pose
    return rb.se3(still, motion[1]) @ turned


def recover(scene, name, rotation, translation, steps, lr):
    """Moves a pose and finds it again; returns its error in degrees and units."""
    pose = scene.get_parameter(name)
    truth = pose.detach().clone()
    with torch.no_grad():
        target = rb.render(scene, spp=128, seed=1)
        pose.copy_(moved(truth, torch.tensor([rotation, translation])))
        before = rb.render(scene, spp=64)[0]
    start, motion = pose.detach().clone(), torch.zeros(2, 3, requires_grad=True)
    renderer = rb.Renderer(scene, spp=1, share_samples=True)
    optimizer = torch.optim.Adam([motion], lr=lr, betas=(0.9, 0.95))
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.02 ** (1 / steps))
    for step in range(steps):
        optimizer.zero_grad()
        posed = {f"scene.{name}": moved(start, motion)}
        images = [torch.func.functional_call(renderer, posed, kwargs={"seed": seed})
                  for seed in (2 * step, 2 * step + 1)]
        rb.losses.two_buffer_l2(*images, target).backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        pose.copy_(moved(start, motion))
        show(before=before, target=target[0], after=rb.render(scene, spp=64)[0])
    turn = pose[:3, :3] @ truth[:3, :3].inverse()
    angle = ((turn.trace() - 1) / 2).clamp(-1, 1).arccos()  # of a rotation matrix
    return torch.rad2deg(angle).item(), (pose - truth)[:3, 3].norm().item()


angle, distance = recover(scene, "block.to_world", [0.1, -0.1, 0.3], [0.15, -0.12, 0.15],
                          steps=200, lr=0.02)
print(f"the block: off by {angle:.2f} degrees and {distance:.4f}")

# %% [markdown]
# ## The pose of the camera
#
# The same six numbers, for a camera in a round room. Where it looks has a derivative by everything that it sees.

# %%
room = rb.load(rb.asset("round_room/scene.xml"), resolution=128)
of_camera = recover(room, "sensor.to_world", [0.05, -0.07, 0.03], [0.12, -0.1, 0.1],
                    steps=240, lr=0.02)
print(f"the camera: off by {of_camera[0]:.2f} degrees and {of_camera[1]:.4f}")
assert angle < 3 and distance < 0.01 and of_camera[0] < 0.2 and of_camera[1] < 0.01
