"""Textures, light, cameras and shape of an asset from eight views at once: python examples/asset_from_views.py"""

import torch
from torch.nn.utils.parametrize import register_parametrization

import torch_radbp as rb

asset, views = rb.load(rb.asset("pot/pot.glb"), light=0.0, resolution=40), [f"view_{number}" for number in range(8)]
scene = rb.load_dict({"type": "scene", "glaze": asset.glaze, "pot": asset.pot, **{v: getattr(asset, v) for v in views},
                      "sky": {"type": "envmap", "filename": str(rb.asset("lit_balls/sky.exr"))}})
target, pot, glaze = rb.render(scene, spp=256, max_depth=3, seed=10**6), scene.pot, scene.glaze

# Unknown: two maps from grey, an even sky, a shape that is too small, and cameras that are off by about a degree: turned
# about the pot and shifted along their own x and y (`motion`), and along their line of sight (`distance`).
maps = {glaze.base_color: rb.optim.Sigmoid(), glaze.roughness: rb.optim.Sigmoid(), scene.sky: rb.optim.Log()}
truth, poses = {part: part.data.detach().clone() for part in maps}, torch.stack([getattr(scene, v).to_world for v in views])
cameras = motion, distance = (0.02 * torch.randn(8, 6, generator=torch.manual_seed(0))).split([5, 1], 1)
for part, inside in maps.items():
    part.data.requires_grad_().data.fill_(part.data.mean())
    register_parametrization(part, "data", inside)  # steps in the sky are ratios: its sun is far brighter than the rest
*paint, sky = [each for each in scene.parameters() if each.requires_grad]
vertices = pot.vertex_positions.requires_grad_().data.mul_(0.9) / 0.9  # the true ones
register_parametrization(pot, "vertex_positions", rb.optim.LargeSteps(pot.faces, pot.vertex_positions, smoothness=19))
# Short betas: the first gradients, of a pot that is far too small, would else make all later steps small.
shape = rb.optim.AdamUniform([pot.parametrizations.vertex_positions.original], 0.02, (0.8, 0.95))
rest = torch.optim.Adam([{"params": paint}, {"params": sky, "lr": 0.1}, {"params": cameras, "lr": 0.006}], 0.05, (0.8, 0.95))
decays = [torch.optim.lr_scheduler.ExponentialLR(each, 0.995) for each in (shape, rest)]
renderer = rb.Renderer(scene, spp=4, max_depth=3, share_samples=True)


def images(numbers, **settings):
    """Views by the cameras of now; two are known, for all there is could be moved and scaled together."""
    shift = (poses[:, :3, :3] @ torch.cat([motion[:, 3:], distance], 1)[:, :, None])[:, :, 0]
    found = {f"scene.{views[k]}.to_world": rb.se3(motion[k, :3], shift[k]) @ poses[k] for k in numbers if k > 1}
    return torch.func.functional_call(renderer, found, kwargs=settings | {"sensors": [views[k] for k in numbers]})


def seen():
    """All views, and how far off everything is: where on the surface a vertex lies does not count, for nobody sees it."""
    image, off = images(range(8), seed=0, spp=256).detach(), ((pot.vertex_positions - vertices) * pot.vertex_normals).sum(1)
    moved = distance[2:], motion[2:, 3:].norm(dim=1), motion[2:, :3].norm(dim=1), image.clip(0, 1) - target.clip(0, 1)
    return image, [each.square().mean().sqrt().item() for each in (*(part.data - truth[part] for part in maps), off, *moved)]


before, were = seen()
for step in range(400):
    # Before there is something to look at, cameras would go astray; before the pot is about as large as it is, all
    # would come closer instead, which looks the same, and the two that are known bring them back slowly.
    motion.requires_grad_(step >= 40), distance.requires_grad_(step >= 150), shape.zero_grad(), rest.zero_grad()
    batch = torch.randperm(8)[:2].tolist()
    # By logarithms dark and bright count alike; else all would follow the sun. What hardly shows is as its neighbours are.
    loss = rb.losses.two_buffer_log_l2(*(images(batch, seed=2 * step + k) for k in (0, 1)), target[batch], epsilon=0.1)
    (loss + 0.03 * rb.priors.smoothness(glaze.roughness.data)).backward()
    for each in (shape, rest, *decays):
        each.step()
after, are = seen()
# Cameras have moved along their line of sight, where a larger pot further away looks the same, and across; and turned.
for name, *errors in zip(("colour", "roughness", "sky", "shape", "along", "across", "turned", "images"), were, are):
    print("{:9} off by {:.4f} before, {:.4f} after".format(name, *errors))
rb.save_image("asset_from_views.png", rb.contact_sheet({"before": before, "after": after, "target": target}, views))
