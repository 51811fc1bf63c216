"""Colours, roughness and sky from eight photographs, then looked at by another light: python examples/unknown_light.py

What the photographs leave open, docs/what_images_cannot_tell.md says. Once nothing is known, once a ball of known material
stands in the ring: a grey one, and one of metal that mirrors the sky.
"""

import torch
import trimesh
from torch.nn.utils.parametrize import register_parametrization

import torch_radbp as rb

steps, axes = 500, [1, 2, 0]  # z of the ring becomes y, the axis of skies
ring = trimesh.creation.torus(1, 0.4, major_sections=48, minor_sections=24)
paint = torch.tensor([225, 150, 95]) - 25 * (1 + torch.tensor(6 * ring.vertices.sum(1, keepdims=True)).sin())
ring = trimesh.Trimesh(ring.vertices[:, axes], ring.faces, vertex_normals=ring.vertex_normals[:, axes],
                       vertex_colors=paint.byte().numpy(), process=False)
# All views look down: the ground is in sight around the ring, and nothing of the sky above it.
views = {f"view_{k}": {"type": "perspective", "fov": 40, "film": {"type": "hdrfilm", "width": 64, "height": 64}, "to_world":
         rb.look_at([3 * turn.sin(), 3, 3 * turn.cos()], [0, 0, 0], [0, 1, 0])}
         for k, turn in enumerate(torch.arange(8) * torch.pi / 4)}
down = torch.linspace(0, 1, 16)[:, None, None].expand(16, 32, 3)
day = (1 - down) * torch.tensor([0.3, 0.5, 0.9]) + down * torch.tensor([0.25, 0.2, 0.15])
day[3, 5] = torch.tensor([90.0, 75.0, 55.0])  # a small sun
evening = day.roll(15, 1) * torch.tensor([1.2, 0.8, 0.6])
ball, rows = {"type": "sphere", "center": [0, 0.3, 0], "radius": 0.45}, {}
torus = {"type": "mesh", "mesh": ring, "bsdf": {"type": "principled", "roughness": 0.4, "base_color": {
    "type": "mesh_attribute", "name": "vertex_color"}}}


def psnr(image, target):
    """dB, of linear values up to 1, in pixels that show the ring alone."""
    return -10 * (image.clip(0, 1) - target.clip(0, 1)).square().movedim(1, -1)[seen].mean().log10()


for known, bsdf in (("nothing", None), ("a grey ball", {"type": "diffuse"}), ("a metal ball", {"type": "roughconductor"})):
    shared = {"type": "scene", "torus": torus, **views, **({"ball": ball | {"bsdf": bsdf}} if bsdf else {})}
    scene = rb.load_dict(shared | {"sky": {"type": "envmap", "data": day}})
    other = rb.load_dict(shared | {"sky": {"type": "envmap", "data": evening}, "torus": scene.torus})  # of what is found
    true = [rb.render(each, seed=10**6, spp=256, max_depth=3) for each in (scene, other)]
    seen = rb.Renderer(scene).aovs(["shape_index"], spp=16)["shape_index"][:, 0] == 1
    for part, name in ((scene.torus, "vertex_color"), (scene.torus.bsdf.roughness, "value"), (scene.sky, "data")):
        getattr(part, name).requires_grad_().data.fill_(0.5)
        register_parametrization(part, name, rb.optim.Log() if name == "data" else rb.optim.Sigmoid())
    renderer = rb.Renderer(scene, spp=1, max_depth=3, share_samples=True)
    optimizer = torch.optim.Adam([each for each in scene.parameters() if each.requires_grad], 0.15, (0.8, 0.95))
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.05 ** (1 / steps))
    for step in range(steps):
        loss = rb.losses.two_buffer_l2(renderer(seed=2 * step), renderer(seed=2 * step + 1), true[0])
        optimizer.zero_grad(), loss.backward(), optimizer.step(), decay.step()
    found = [rb.render(each, seed=0, spp=256, max_depth=3).detach() for each in (scene, other)]
    print("known is {:13} {:.1f} dB by the same light, {:.1f} dB by another".format(known + ":", *map(psnr, found, true)))
    rows[known] = torch.stack([image[0] for pair in zip(true, found) for image in pair])
rb.save_image("unknown_light.png", rb.contact_sheet(rows, ["photograph", "as found", "by other light", "as found"]))
