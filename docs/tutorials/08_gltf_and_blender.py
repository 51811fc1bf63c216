# %% [markdown]
# # glTF in, Blender out
#
# Assets come as glTF, and what was recovered should go back into the tools of artists. `rb.load` reads `.glb` and
# `.gltf`, whose materials become `principled` under their own names; `rb.save` writes them, and Mitsuba's XML.

# %%
import tempfile
import warnings
from pathlib import Path

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
for name, parameter in scene.named_parameters():
    if name.startswith("glaze"):
        print(f"{name:36} {tuple(parameter.shape)}")

# %% [markdown]
# ## Something to recover
#
# A view of the pot in another colour: the map times one tint, which we look for. A tint is no parameter of the scene;
# it is what the parameter is computed from, and autograd takes the gradient there.

# %%
colour = scene.get_parameter("glaze.base_color.data")
original, true_tint = colour.detach().clone(), torch.tensor([0.3, 0.9, 1.6])
colour.data.copy_((original * true_tint).clamp(0, 1))
target = rb.render(scene, spp=128, seed=1, sensors=[0, 4]).detach()
colour.data.copy_(original)
before = rb.render(scene, spp=64, sensors=[0, 4])[0]

tint = torch.ones(3, requires_grad=True)
renderer = rb.Renderer(scene, spp=2)
optimizer = torch.optim.Adam([tint], lr=0.05)
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 100)
for step in range(100):
    optimizer.zero_grad()
    colours = {"scene.glaze.base_color.data": (original * tint).clamp(0, 1)}
    call = {"seed": step, "sensors": [0, 4]}
    image = torch.func.functional_call(renderer, colours, kwargs=call)
    (image - target).square().mean().backward()
    optimizer.step()
    schedule.step()
print("tint:", [round(value, 3) for value in tint.tolist()])

# %% [markdown]
# ## Out, and in again
#
# What a format cannot say is named in one warning (`strict=True` makes it an error). Of the pot, glTF can say
# everything but the even light that we added by `light=0.15`.

# %%
colour.data.copy_((original * tint.detach()).clamp(0, 1))
after = rb.render(scene, spp=128, sensors=[0, 4])[0]
with tempfile.TemporaryDirectory() as folder:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rb.save(scene, Path(folder, "found.glb"))  # in Blender: File, Import, glTF 2.0
    print(*(warning.message for warning in said))
    print("found.glb:", Path(folder, "found.glb").stat().st_size // 1024, "KiB")
    again = rb.load(Path(folder, "found.glb"), light=0.15, max_depth=3, resolution=128)
    rb.save(scene, Path(folder, "scene.xml"))  # for Mitsuba
    print("beside scene.xml:", {path.suffix for path in Path(folder).rglob("*.*")})
returned = rb.render(again, spp=128, sensors=[0, 4])[0]
show(before=before, target=target[0], after=after, read_again=returned)
difference = (returned - after).square().mean().sqrt().item() / after.mean().item()
print(f"read again, the image differs by {100 * difference:.2f} %: colours of 8 bits")
assert (tint - true_tint).abs().max() < 0.05 and difference < 0.02
