"""Photographs with gains and white balances that nobody wrote down: python examples/unknown_exposure.py"""

import tempfile
from pathlib import Path

import torch

import torch_radbp as rb

epochs = 60
torch.manual_seed(0)
scene = rb.load(rb.asset("pot/pot.glb"), light=0.15, resolution=48)
views = [f"view_{number}" for number in range(8)]
colour = scene.get_parameter("glaze.base_color.data")
truth = colour.detach().clone()
gains = (0.3 * torch.randn(8, 3)).exp()
gains[0] = 1.0

# The photographs: 8 bits of sRGB, each exposed and balanced in its own way, and masks of what is not overexposed.
exposed = rb.render(scene, spp=256, max_depth=3, seed=10**6) * gains[:, :, None, None]
with tempfile.TemporaryDirectory() as folder:
    files, masks = ([Path(folder, f"{view}{end}.png") for view in views] for end in ("", "_mask"))
    for k in range(8):
        rb.save_image(files[k], exposed[k])
        rb.save_image(masks[k], exposed[k].amax(0, keepdim=True) < 1)
    photographs = rb.Photographs(files, {view: getattr(scene, view) for view in views}, masks)
    loader = torch.utils.data.DataLoader(photographs, batch_size=2, shuffle=True)

    colour.requires_grad_().data.fill_(0.5)
    exposure = rb.Exposure(8, fixed=0)
    renderer = rb.Renderer(scene, spp=4, max_depth=3, share_samples=True)
    optimizer = torch.optim.Adam([colour, *exposure.parameters()], lr=0.03, betas=(0.8, 0.95))
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.05 ** (1 / epochs))
    before = rb.render(scene, spp=256, max_depth=3).detach()
    for epoch in range(epochs):
        for number, batch in enumerate(loader):
            a, b = (exposure(renderer(seed=8 * epoch + 2 * number + k, sensors=batch.sensors), batch.views) for k in (0, 1))
            optimizer.zero_grad()
            rb.losses.two_buffer_l2(a, b, batch.image, batch.mask).backward()
            optimizer.step()
            scene.clamp_()
        decay.step()
with torch.no_grad():
    after = exposure(rb.render(scene, spp=256, max_depth=3), torch.arange(8))
print(f"colour off by {(colour - truth).square().mean().sqrt():.4f}, grey by {(0.5 - truth).square().mean().sqrt():.4f}")
print(f"gains from {gains.min():.2f} to {gains.max():.2f}, off by {(exposure.gains / gains - 1).abs().max():.2%} at most")
rows = {"before": before, "photographs": exposed, "after": after}
rb.save_image("unknown_exposure.png", rb.contact_sheet(rows, views))
