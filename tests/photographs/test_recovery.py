"""From a folder of photographs to reflectance and exposure, by the example of the documentation as it stands there."""

import re
from pathlib import Path

import pytest
import torch
from PIL import Image

import torch_radbp as rb
from tests.photographs.nerf_folder import GAINS, REFLECTANCE, ball_in_the_open, write_photographs

TOUR = Path(__file__).parents[2] / "docs" / "tour.md"


def test_reflectance_and_gains_are_recovered_from_coded_photographs(tmp_path, monkeypatch):
    """8 bits of sRGB and a gain each; what is left is noise of 4 samples, which steps that shrink to a tenth average."""
    section = TOUR.read_text(encoding="utf-8").split("\n## Photographs\n")[1].split("\n## ")[0]
    example, *_ = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    write_photographs(tmp_path)
    monkeypatch.chdir(tmp_path)
    found = {"rb": rb, "torch": torch, "objects": ball_in_the_open(0.5, 0.5, 0.5)}
    exec(example, found)
    torch.testing.assert_close(found["reflectance"].detach(), torch.tensor(REFLECTANCE), rtol=0, atol=0.01)
    gains = found["exposure"].gains.detach()
    torch.testing.assert_close(gains, GAINS[:, None].expand(-1, 3), rtol=0, atol=0.01)
    assert torch.equal(gains[0], torch.ones(3))


@pytest.mark.deep
@pytest.mark.parametrize("decodes", [True, False], ids=["photographs are decoded", "renderings are coded"])
def test_a_curve_that_is_not_known_is_recovered_beside_the_reflectance(tmp_path, decodes):
    """Values to the power 1 / 1.8, by a curve that begins as sRGB; exposure times are known. 8 bits are 0.004 apart."""
    images, times = write_photographs(tmp_path), torch.tensor([0.5, 1.0, 1.8])
    for number, (image, time) in enumerate(zip(images, times)):
        coded = (image * time).clamp(0, 1) ** (1 / 1.8)
        Image.fromarray((coded * 255).round().byte().movedim(0, -1).numpy()).save(tmp_path / f"view_{number}.png")
    photographs = rb.Photographs.from_nerf(tmp_path / "transforms.json", curve="linear")
    scene = rb.load_dict({"type": "scene", **photographs.cameras, **ball_in_the_open(0.5, 0.5, 0.5)})
    reflectance = scene.get_parameter("ball.bsdf.reflectance.value").requires_grad_()
    curve, exposure = rb.ToneCurve(pieces=4), rb.Exposure(3, gains=times).requires_grad_(False)
    renderer, batch = rb.Renderer(scene, spp=8, max_depth=2, share_samples=True), photographs.batch()
    optimizer = torch.optim.Adam([reflectance, *curve.parameters()], lr=0.05, betas=(0.8, 0.95))
    decay = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.98)
    for step in range(150):
        a, b = (exposure(renderer(seed=2 * step + k, sensors=batch.sensors), batch.views) for k in (0, 1))
        target = curve.inverse(batch.image) if decodes else batch.image
        loss = rb.losses.two_buffer_l2(a, b, target) if decodes else rb.losses.two_buffer_l2(curve(a), curve(b), target)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay.step()
    torch.testing.assert_close(reflectance.detach(), torch.tensor(REFLECTANCE), rtol=0, atol=0.005)
    light = torch.linspace(0.02, 0.9, 50).expand(1, 3, 1, -1)
    truth = light ** (1 / 1.8)
    assert (rb.ToneCurve()(light) - truth).abs().max() > 0.05 > 0.005 > (curve(light) - truth).abs().max()
