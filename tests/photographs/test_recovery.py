"""From a folder of photographs to reflectance and exposure: the whole road, as a user goes it."""

import torch
from torch.utils.data import DataLoader

import torch_radbp as rb
from tests.photographs.nerf_folder import GAINS, REFLECTANCE, ball_in_the_open, write_photographs


def test_reflectance_and_gains_are_recovered_from_coded_photographs(tmp_path):
    """8 bits of sRGB and a gain each; what is left is noise of 4 samples, which steps that shrink to a tenth average."""
    torch.manual_seed(0)
    write_photographs(tmp_path)
    photographs = rb.Photographs.from_nerf(tmp_path / "transforms.json")
    scene = rb.load_dict({"type": "scene", **photographs.cameras, **ball_in_the_open(0.5, 0.5, 0.5)})
    reflectance = scene.get_parameter("ball.bsdf.reflectance.value").requires_grad_()
    exposure = rb.Exposure(len(photographs), fixed=0, white_balance=False)
    renderer = rb.Renderer(scene, spp=4, max_depth=2, share_samples=True)
    optimizer = torch.optim.Adam([reflectance, *exposure.parameters()], lr=0.1, betas=(0.8, 0.95))
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.1 ** (1 / 45))
    step = 0
    for _ in range(45):
        for batch in DataLoader(photographs, batch_size=3, shuffle=True):
            a, b = (exposure(renderer(seed=2 * step + k, sensors=batch.sensors), batch.views) for k in (0, 1))
            loss = rb.losses.two_buffer_l2(a, b, batch.image, batch.mask)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            reflectance.data.clamp_(0, 1)
            step += 1
        decay.step()
    torch.testing.assert_close(reflectance.detach(), torch.tensor(REFLECTANCE), rtol=0, atol=0.01)
    torch.testing.assert_close(exposure.gains.detach(), GAINS[:, None].expand(-1, 3), rtol=0, atol=0.01)
    assert torch.equal(exposure.gains[0], torch.ones(3))
