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
    axes = plt.subplots(1, len(images), figsize=(3 * len(images), 3.2), squeeze=False)[1][0]
    for axis, (title, image) in zip(axes, images.items()):
        axis.imshow(image.detach().clamp(0, 1).permute(1, 2, 0) ** (1 / 2.2))
        axis.set_title(title)
        axis.axis("off")
    plt.show()


# %% [markdown]
# ## A derivative by term
#
# A block hangs above the floor, out of view; two lamps throw two shadows of it. How does the image change when the
# block moves to the right? Without the term of shadows the answer is nothing at all.

# %%
scene = rb.load(rb.asset("shadow/scene.xml"), resolution=48)
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
    """A pose turned about its own origin by the rotation vector motion[0], and moved by motion[1]."""
    place = rb.se3(torch.zeros(3), pose[:3, 3])
    return rb.se3(torch.zeros(3), motion[1]) @ place @ rb.se3(motion[0], torch.zeros(3)) @ place.inverse() @ pose


def recover(scene, name, rotation, translation, steps, lr):
    """Moves a pose away from the truth and finds it again; returns before, target, after, and the pose's errors."""
    pose = scene.get_parameter(name)
    truth = pose.detach().clone()
    with torch.no_grad():
        target = rb.render(scene, spp=1024, seed=1)
        pose.copy_(moved(truth, torch.tensor([rotation, translation])))
        before = rb.render(scene, spp=64)[0]
    start, motion = pose.detach().clone(), torch.zeros(2, 3, requires_grad=True)
    renderer = rb.Renderer(scene, spp=4, share_samples=True)
    optimizer = torch.optim.Adam([motion], lr=lr, betas=(0.9, 0.95))
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.02 ** (1 / steps))
    for step in range(steps):
        optimizer.zero_grad()
        posed = {f"scene.{name}": moved(start, motion)}
        images = [torch.func.functional_call(renderer, posed, kwargs={"seed": 2 * step + k}) for k in (0, 1)]
        rb.losses.two_buffer_l2(*images, target).backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        pose.copy_(moved(start, motion))
        show(before=before, target=target[0], after=rb.render(scene, spp=64)[0])
    turn = pose[:3, :3] @ truth[:3, :3].inverse()  # a rotation of the angle acos((trace - 1) / 2)
    return torch.rad2deg(((turn.trace() - 1) / 2).clamp(-1, 1).arccos()).item(), (pose - truth)[:3, 3].norm().item()


angle, distance = recover(scene, "block.to_world", [0.1, -0.1, 0.3], [0.15, -0.12, 0.15], steps=200, lr=0.02)
print(f"the block: off by {angle:.2f} degrees and {distance:.4f}")

# %% [markdown]
# ## The pose of the camera
#
# The same six numbers, for a camera in a round room. Where it looks has a derivative by everything that it sees.

# %%
room = rb.load(rb.asset("round_room/scene.xml"), resolution=48)
camera_angle, camera_distance = recover(room, "sensor.to_world", [0.05, -0.07, 0.03], [0.12, -0.1, 0.1], steps=240, lr=0.02)
print(f"the camera: off by {camera_angle:.2f} degrees and {camera_distance:.4f}")
assert angle < 3 and distance < 0.01 and camera_angle < 0.2 and camera_distance < 0.01
