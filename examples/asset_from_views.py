"""Textures, light, cameras and shape of an asset from eight views at once: python examples/asset_from_views.py [STEPS]"""

import sys
from pathlib import Path

import torch
from torch.nn.utils import parametrize

import torch_radbp as rb

steps = int(sys.argv[1]) if sys.argv[1:] else 200
torch.manual_seed(0)
asset = rb.load("assets/pot/pot.glb", light=0.0, resolution=40)
sky = {"type": "envmap", "filename": "assets/lit_balls/sky.exr"}
scene = rb.load_dict({"type": "scene", **dict(asset.named_children()), "sky": sky})
views, pot = [f"view_{number}" for number in range(8)], scene.pot
target = rb.render(scene, spp=256, max_depth=3, seed=10**6)

# Unknown: two maps from grey, an even sky, cameras that are off by about a degree, and a shape that is too small.
maps = {name: scene.get_parameter(name) for name in ("glaze.base_color.data", "glaze.roughness.data", "sky.data")}
parts = {**maps, "pot.vertex_positions": pot.vertex_positions, **{view: getattr(scene, view).to_world for view in views}}
truth = {name: value.detach().clone() for name, value in parts.items()}
for name, value in maps.items():
    value.requires_grad_().data.fill_(truth[name].mean())
motion = (0.02 * torch.randn(8, 2, 3)).requires_grad_()
pot.vertex_positions.requires_grad_().data.mul_(0.9)
parametrize.register_parametrization(pot, "vertex_positions", rb.optim.LargeSteps(pot.faces, pot.vertex_positions, 19))
shape = rb.optim.AdamUniform([pot.parametrizations.vertex_positions.original], lr=0.01)
others = torch.optim.Adam([{"params": [*maps.values()], "lr": 0.03}, {"params": [motion], "lr": 0.001}], betas=(0.8, 0.95))
decays = [torch.optim.lr_scheduler.ExponentialLR(each, 0.05 ** (1 / steps)) for each in (shape, others)]
renderer = rb.Renderer(scene, spp=4, max_depth=3, share_samples=True, terms=("interior", "primary"))


def images(numbers, **settings):
    """Views by the cameras of now; the first one stays, for all that there is could be moved together."""
    poses = {f"scene.{views[k]}.to_world": truth[views[k]] @ rb.se3(*(motion[k] * (k > 0))) for k in numbers}
    return torch.func.functional_call(renderer, poses, kwargs=settings | {"sensors": [views[k] for k in numbers]})


before = images(range(8), seed=0, spp=64).detach()
for step in range(steps):
    batch = torch.randperm(8)[:2].tolist()
    loss = rb.losses.two_buffer_l2(*(images(batch, seed=2 * step + k) for k in (0, 1)), target[batch])
    (loss + 1e-4 * rb.priors.total_variation(maps["sky.data"])).backward()
    for each in (shape, others, *decays):
        each.step()
    renderer.zero_grad()
    motion.grad = None
    for name, value in maps.items():
        value.data.clamp_(0.01, 1.0 if name.startswith("glaze") else None)
after = images(range(8), seed=0, spp=64).detach()
for name, found in {**maps, "pot.vertex_positions": pot.vertex_positions}.items():
    print(f"{name:22} off by {(found - truth[name]).square().mean().sqrt():.4f} (root mean square)")
turned, moved = motion[1:].norm(dim=2).mean(0).tolist()
print(f"cameras: turned by {turned * 57.3:.3f} degrees, moved by {moved:.4f}")
print("images, dB:", *(f"{-10 * (each - target).square().mean().log10():.1f}" for each in (before, after)))
Path("runs").mkdir(exist_ok=True)
rb.save_image("runs/asset_from_views.png", rb.contact_sheet({"before": before, "target": target, "after": after}, views))
