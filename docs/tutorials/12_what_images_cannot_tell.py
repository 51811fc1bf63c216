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


def recover(start, photograph, **beside):
    """Finds the colour of the ball and the light of the lamp from one photograph."""
    scene = lit_ball([start] * 3, [15.0] * 3, **beside)
    parts = scene.ball.bsdf.reflectance, scene.lamp.emitter.radiance
    for part, inside in zip(parts, (rb.optim.Sigmoid(), rb.optim.Log())):
        part.value.requires_grad_()
        register_parametrization(part, "value", inside)
    renderer = rb.Renderer(scene, spp=8, share_samples=True)
    found = [each for each in scene.parameters() if each.requires_grad]
    optimizer = torch.optim.LBFGS(found, max_iter=40, tolerance_change=0, line_search_fn="strong_wolfe")

    def closure():
        """The loss by the same samples at each look, which this optimiser takes for a function without noise."""
        optimizer.zero_grad()
        loss = rb.losses.two_buffer_l2(renderer(seed=0), renderer(seed=1), photograph) / photograph.square().mean()
        loss.backward()
        return loss

    optimizer.step(closure)
    return [part.value.tolist() for part in parts]


truth, warm, white = [0.75, 0.3, 0.12], [30.0, 24.0, 17.0], [24.0, 24.0, 24.0]


def compare(**beside):
    """Draws what two runs find, by its lamp and by a white one; by how many percent images and colours are apart."""
    photograph = rb.render(lit_ball(truth, warm, **beside), spp=256, seed=10**6)
    found = [(truth, warm), recover(0.3, photograph, **beside), recover(0.85, photograph, **beside)]
    rows = [torch.cat([rb.render(lit_ball(colour, light, **beside), spp=256) for colour, light in each])
            for each in (found, [(colour, white) for colour, _ in found])]
    sheet = rb.contact_sheet(dict(zip(("by its lamp", "by a white lamp"), rows)), ["as it is", "from dark", "from bright"])
    plt.figure(figsize=(8, 4.5)).add_axes((0, 0, 1, 1)).imshow(sheet.movedim(0, -1) ** (1 / 2.2))
    plt.axis("off")
    plt.show()
    print("colours found:", *([round(value, 2) for value in colour] for colour, _ in found[1:]), "of", truth)
    pairs = rows[0][1:], torch.tensor([colour for colour, _ in found[1:]])
    return [100 * ((one - other).square().mean() / one.square().mean()).sqrt().item() for one, other in pairs]


alone = compare()
print("two runs: images {:.1f} % apart, colours {:.0f} %".format(*alone))

# %% [markdown]
# Both images are right, and both colours are wrong: twice the light on half of the colour is the same image. By another lamp
# it shows. That is how to notice it afterwards: **two runs from different starts agree in images, and not in parameters.**
#
# ## Noticing it beforehand
#
# A derivative needs no run. `rb.jvp` says how the image changes when parameters change along given directions: here the
# colour grows, and the light falls by the same share. Where nothing is left of the change, images cannot tell.


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
print("two runs beside a card: images {:.1f} % apart, colours {:.0f} %".format(*known))

# %% [markdown]
# The runs beside the card agree with each other and with the truth. `examples/what_is_seen.py` takes the same look, without
# any run, at roughness, size and distance, exposure, and at what no photograph shows.

# %%
assert alone[0] < 2 < 20 < alone[1] and known[1] < 5
