"""How much images tell of what parameters do, without and with a remedy: python examples/what_is_seen.py

Each line is a change that images hardly show, or not at all, and what they show of it once something is known or lit or
seen. docs/what_images_cannot_tell.md explains them. Changes are of 1 % each, of roughness 0.1.
"""

import torch

import torch_radbp as rb


def camera(*origin):
    film = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    return {"type": "perspective", "fov": 38, "to_world": rb.look_at(origin, [0, 0, 0], [0, 1, 0]), "film": film}


def lamp(radius, radiance):
    return {"type": "sphere", "center": [2, 4, 3], "radius": radius, "emitter": {"type": "area", "radiance": radiance}}


def scene_of(material, light, **others):
    ball = {"type": "sphere", "bsdf": {"type": "principled", **material}}
    return rb.load_dict({"type": "scene", "camera": camera(0, 1, 4), "ball": ball, "light": light, **others})


def change(scene, directions):
    """By how many percent of its size an image changes along directions."""
    size, tangent = rb.render(scene, spp=64).square().mean(), rb.jvp(scene, directions, spp=64)
    return 100 * (tangent.square().mean() / size).sqrt()


flat = torch.tensor([[4.0, 0, 0, 0], [0, 0, 4, -1], [0, -4, 0, 0], [0, 0, 0, 1]])
card = {"type": "rectangle", "to_world": flat, "bsdf": {"type": "diffuse", "reflectance": 0.5}}
even, shares, place = {"type": "constant"}, torch.tensor([[0.01]] * 3 + [[0.0]]), torch.tensor([0.0, 0.0, 0.0, 1.0])
for name, others in {"alone": {}, "beside a grey card of known size": {"card": card}}.items():
    scene = scene_of({"base_color": 0.5, "specular": 0.0}, lamp(0.8, 24.0), **others)
    colour = {"ball.bsdf.base_color.value": 0.01 * scene.ball.bsdf.base_color.value}
    light = {"light.emitter.radiance.value": -0.01 * scene.light.emitter.radiance.value}
    sizes = {f"{part}.to_world": shares * getattr(scene, part).to_world for part in ("ball", "light")}
    sizes["camera.to_world"] = shares * place * scene.camera.to_world
    print(f"{name}: 1 % more colour and less light changes the image by {change(scene, colour | light):.2f} %,",
          f"1 % of all sizes and distances by {change(scene, sizes):.2f} %")
for name, light in {"an even sky": even, "a small lamp": lamp(0.2, 400.0)}.items():
    rough = change(scene_of({"base_color": 0.3, "roughness": 0.4}, light), {"ball.bsdf.roughness.value": torch.tensor(0.1)})
    print(f"by {name}: 0.1 of roughness changes the image by {rough:.1f} %")
for others in {}, {"behind": camera(0, -1, -4)}:
    scene = scene_of({"base_color": {"type": "bitmap", "data": torch.full((16, 32, 3), 0.5)}}, even, **others)
    texels = scene.ball.bsdf.base_color.data.requires_grad_()
    rb.render(scene, spp=64).mean().backward()
    print(f"views: {1 + len(others)}, texels without a gradient: {(texels.grad == 0).all(-1).float().mean():.0%}")
scene = scene_of({"base_color": 0.5}, lamp(0.8, 24.0), beside=camera(4, 1, 0))
darker = {"light.emitter.radiance.value": -0.01 * scene.light.emitter.radiance.value}
image, tangent = rb.render(scene, spp=64, seed=0), rb.jvp(scene, darker, spp=64, seed=0, share_samples=True)
for name, gains in {"no": [0.01, 0.01], "one": [0.0, 0.01]}.items():
    left = tangent + torch.tensor(gains)[:, None, None, None] * image
    print(f"{name} exposure of two known: 1 % less light and longer exposures change images by",
          f"{100 * (left.square().mean() / image.square().mean()).sqrt():.2f} %")
