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
pose = rb.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0])
film = {"type": "hdrfilm", "width": 128, "height": 128}
eye = {"type": "perspective", "fov": 38, "to_world": pose, "film": film}


def diffuse(colour):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}}


def lit_ball(colour, light, **more):
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": light}}
    lamp = {"type": "sphere", "center": [2, 4, 3], "radius": 0.8, "emitter": emitter}
    ball = {"type": "sphere", "bsdf": diffuse(colour)}
    return rb.load_dict({"type": "scene", "eye": eye, "ball": ball, "lamp": lamp} | more)


def recover(start, photograph, **beside):
    """Finds the colour of the ball and the light of the lamp from one photograph."""
    scene = lit_ball([start] * 3, [15.0] * 3, **beside)
    parts = scene.ball.bsdf.reflectance, scene.lamp.emitter.radiance
    for part, inside in zip(parts, (rb.optim.Sigmoid(), rb.optim.Log())):
        part.value.requires_grad_()
        register_parametrization(part, "value", inside)
    renderer = rb.Renderer(scene, spp=8, share_samples=True)
    found = [each for each in scene.parameters() if each.requires_grad]
    optimizer = torch.optim.LBFGS(found, max_iter=40, line_search_fn="strong_wolfe")

    def closure():
        """The loss by the same samples each time: to this optimiser it has no noise."""
        optimizer.zero_grad()
        images = renderer(seed=0), renderer(seed=1)
        loss = rb.losses.two_buffer_l2(*images, photograph) / photograph.square().mean()
        loss.backward()
        return loss

    optimizer.step(closure)
    return [part.value.tolist() for part in parts]


truth, warm, white = [0.75, 0.3, 0.12], [30.0, 24.0, 17.0], [24.0, 24.0, 24.0]


def compare(**beside):
    """Draws what two runs find; by how many percent images and colours are apart."""
    photograph = rb.render(lit_ball(truth, warm, **beside), spp=256, seed=10**6)
    runs = [recover(start, photograph, **beside) for start in (0.3, 0.85)]
    found = [(truth, warm), *runs]
    rows = [torch.cat([rb.render(lit_ball(*pair, **beside), spp=256) for pair in each])
            for each in (found, [(colour, white) for colour, _ in found])]
    sheet = rb.contact_sheet({"by its lamp": rows[0], "by a white lamp": rows[1]},
                             ["as it is", "from dark", "from bright"])
    axes = plt.figure(figsize=(8, 4.5)).add_axes((0, 0, 1, 1))
    axes.imshow(sheet.movedim(0, -1) ** (1 / 2.2))
    axes.axis("off")
    plt.show()
    colours = torch.tensor([colour for colour, _ in runs], dtype=torch.float64)
    print("colours found:", colours.round(decimals=2).tolist(), "of", truth)
    return [100 * float((a - b).norm() / a.norm()) for a, b in (rows[0][1:], colours)]


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
def change(scene, colour, light):
    """By how many percent an image changes with colour, and with both at once."""
    changes = [rb.jvp(scene, each, spp=64).norm() for each in (colour, colour | light)]
    return [100 * float(each / rb.render(scene, spp=64).norm()) for each in changes]


flat = torch.tensor([[4.0, 0, 0, 0], [0, 0, 4, -1], [0, -4, 0, 0], [0, 0, 0, 1]])
card = {"type": "rectangle", "to_world": flat, "bsdf": diffuse([0.5, 0.5, 0.5])}
for name, beside in {"alone": {}, "beside a grey card": {"card": card}}.items():
    brighter = {"ball.bsdf.reflectance.value": 0.01 * torch.tensor(truth)}
    darker = {"lamp.emitter.radiance.value": -0.01 * torch.tensor(warm)}
    seen = change(lit_ball(truth, warm, **beside), brighter, darker)
    print("{}: colour by 1 %: {:.2f} %, against light: {:.2f} %".format(name, *seen))

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
