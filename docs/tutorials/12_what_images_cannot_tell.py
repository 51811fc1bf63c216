# %% [markdown]
# # What images cannot tell
#
# An optimisation can end with perfect images and wrong parameters: other parameters make the same images. No loss and no
# number of steps helps against that. Something that is known does. This tutorial shows how such a case looks, how to notice
# it before hours are spent on it, and what to do. [The page of the same name](../what_images_cannot_tell.md) goes through
# the cases one by one.

# %%
import matplotlib.pyplot as plt
import torch
from torch.nn.utils.parametrize import register_parametrization

import torch_radbp as rb

# %% [markdown]
# ## Light times colour
#
# A ball, and a lamp that is not in view. Both have a colour, and we know neither.


# %%
def camera(*origin):
    film = {"type": "hdrfilm", "width": 128, "height": 128}
    return {"type": "perspective", "fov": 38, "to_world": rb.look_at(origin, [0, 0, 0], [0, 1, 0]), "film": film}


def scene_of(bsdf, **others):
    return rb.load_dict({"type": "scene", "camera": camera(0, 1, 4), "ball": {"type": "sphere", "bsdf": bsdf}, **others})


def lit_ball(colour, light, **beside):
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": light}}
    lamp = {"type": "sphere", "center": [2, 4, 3], "radius": 0.8, "emitter": emitter}
    return scene_of({"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}}, lamp=lamp, **beside)


def recover(start, photograph, steps=100, **beside):
    """Finds the colour of the ball and the light of the lamp from one photograph."""
    scene = lit_ball([start] * 3, [15.0] * 3, **beside)
    parts = scene.ball.bsdf.reflectance, scene.lamp.emitter.radiance
    for part, inside in zip(parts, (rb.optim.Sigmoid(), rb.optim.Log())):
        part.value.requires_grad_()
        register_parametrization(part, "value", inside)
    optimizer = torch.optim.Adam([each for each in scene.parameters() if each.requires_grad], 0.2, (0.8, 0.95))
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.02 ** (1 / steps))
    renderer = rb.Renderer(scene, spp=2, share_samples=True)
    for step in range(steps):
        loss = rb.losses.two_buffer_l2(renderer(seed=2 * step), renderer(seed=2 * step + 1), photograph)
        optimizer.zero_grad(), loss.backward(), optimizer.step(), decay.step()
    return [part.value.tolist() for part in parts]


truth, warm, white = [0.75, 0.3, 0.12], [30.0, 24.0, 17.0], [24.0, 24.0, 24.0]


def compare(**beside):
    """Draws what is found from two starts, by its lamp and by a white one; how far apart images and colours are, in percent."""
    photograph = rb.render(lit_ball(truth, warm, **beside), spp=256, seed=10**6)
    found = [(truth, warm), recover(0.3, photograph, **beside), recover(0.85, photograph, **beside)]
    rows = [torch.cat([rb.render(lit_ball(colour, light, **beside), spp=256) for colour, light in each])
            for each in (found, [(colour, white) for colour, _ in found])]
    sheet = rb.contact_sheet(dict(zip(("by its lamp", "by a white lamp"), rows)), ["as it is", "from dark", "from bright"])
    plt.figure(figsize=(8, 4.5)).add_axes((0, 0, 1, 1)).imshow(sheet.movedim(0, -1) ** (1 / 2.2))
    plt.axis("off")
    plt.show()
    pairs = rows[0][1:], torch.tensor([colour for colour, _ in found[1:]])
    return [100 * ((one - other).square().mean() / one.square().mean()).sqrt().item() for one, other in pairs]


alone = compare()
print("two runs: images {:.1f} % apart, colours {:.1f} %".format(*alone))

# %% [markdown]
# Both images are right, and both colours are wrong: twice the light on half of the colour is the same image. By another lamp it
# shows. That is how to notice it afterwards: **two runs from different starts agree in images, and not in parameters.**
#
# ## Noticing it beforehand
#
# A derivative needs no run. `rb.jvp` says how the image changes when parameters change along given directions: here the colour
# grows, and the light falls by the same share. Where nothing is left of the change, images cannot tell.


# %%
def change(scene, *directions):
    """By how many percent an image changes along the first of some directions, and along all of them together."""
    size = rb.render(scene, spp=64).square().mean()
    together = {name: tangent for each in directions for name, tangent in each.items()}
    return [100 * (rb.jvp(scene, each, spp=64).square().mean() / size).sqrt().item() for each in (directions[0], together)]


flat = torch.tensor([[4.0, 0, 0, 0], [0, 0, 4, -1], [0, -4, 0, 0], [0, 0, 0, 1]])
card = {"type": "rectangle", "to_world": flat, "bsdf": {"type": "diffuse", "reflectance": 0.5}}
for name, beside in {"alone": {}, "beside a grey card": {"card": card}}.items():
    brighter = {"ball.bsdf.reflectance.value": 0.01 * torch.tensor(truth)}
    darker = {"lamp.emitter.radiance.value": -0.01 * torch.tensor(warm)}
    seen = change(lit_ball(truth, warm, **beside), brighter, darker)
    print("{}: 1 % of colour changes the image by {:.2f} %, against 1 % of light by {:.2f} %".format(name, *seen))

# %% [markdown]
# ## The remedy: something known in view
#
# A card of which we know that it is grey and reflects half of the light tells what the light is. In the same way a ball of
# known material does, or a lamp of known power.

# %%
known = compare(card=card)
print("two runs beside a card: images {:.1f} % apart, colours {:.1f} %".format(*known))

# %% [markdown]
# ## The same look at other cases
#
# **Roughness without highlights.** By an even sky, rough and smooth surfaces look much the same. A small lamp makes highlights.

# %%
gloss, even = {"type": "principled", "base_color": 0.3, "roughness": 0.4}, {"type": "constant"}
small = {"type": "sphere", "center": [2, 4, 3], "radius": 0.2, "emitter": {"type": "area", "radiance": 300.0}}
for name, light in {"an even sky": even, "a small lamp": small}.items():
    seen = change(scene_of(gloss, light=light), {"ball.bsdf.roughness.value": torch.tensor(0.1)})
    print(f"by {name}, 0.1 of roughness changes the image by {seen[0]:.1f} %")

# %% [markdown]
# **Distance and scale.** All things twice as large, seen from twice as far, look the same. One length that is known is enough:
# the size of the card, or the distance between two cameras.

# %%
linear, shift = torch.tensor([[0.01], [0.01], [0.01], [0.0]]), torch.tensor([0.0, 0.0, 0.0, 1.0])  # 1 %; of the place alone
for name, beside in {"alone": {}, "beside a card of known size": {"card": card}}.items():
    scene = lit_ball(truth, warm, **beside)
    ball, lamp = ({f"{part}.to_world": linear * getattr(scene, part).to_world} for part in ("ball", "lamp"))
    seen = change(scene, ball, lamp, {"camera.to_world": linear * shift * scene.camera.to_world})
    print("{}: 1 % of the ball's size changes the image by {:.2f} %, of all sizes by {:.2f} %".format(name, *seen))

# %% [markdown]
# **What no photograph shows.** Texels that no camera sees, or that no light reaches, have a gradient of exactly zero. There the
# map stays what it was at the start. Count them; more views are the remedy.

# %%
grey = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": torch.full((16, 32, 3), 0.5)}}
for others in {}, {"behind": camera(0, -1, -4)}:
    scene = scene_of(grey, sky=even, **others)
    texels = scene.ball.bsdf.reflectance.data.requires_grad_()
    rb.render(scene, spp=64).mean().backward()
    unseen = (texels.grad == 0).all(-1).float().mean().item()
    print(f"{1 + len(others)} views leave {unseen:.0%} of the texels without a gradient")
assert alone[0] < 2 < 20 < alone[1] and known[1] < 5
