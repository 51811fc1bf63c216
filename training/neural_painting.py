"""Recovers the painting in the textured room as a small network, from one image that another renderer made.

    python -m torch_radbp.training.neural_painting --steps 150 --out painting.png

The picture that it writes shows, from left to right, the room before, the target and the room with the network; below them
the painting, the network and the difference of the two.
"""

import argparse
from pathlib import Path

import torch
from torch import Tensor, nn

import torch_radbp as rb
from torch_radbp.io.image import read_image
from torch_radbp.training.recovery.losses import two_buffer_l2

ROOM = Path(__file__).parent.parent / "assets" / "textured_room"


class Painting(nn.Module):
    """Linear RGB at surface coordinates: waves of random directions and lengths, then a network of two hidden layers.

    Reference: Tancik et al. 2020, "Fourier Features Let Networks Learn High Frequency Functions in Low Dimensional Domains".
    """

    def __init__(self, waves: int = 64, frequency: float = 20.0, width: int = 64):
        super().__init__()
        self.register_buffer("waves", frequency * torch.randn(2, waves))  # radians per unit
        self.layers = nn.Sequential(nn.Linear(2 * waves, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(),
                                    nn.Linear(width, 3), nn.Sigmoid())

    def forward(self, uv: Tensor) -> Tensor:
        phase = uv @ self.waves
        return self.layers(torch.cat([phase.sin(), phase.cos()], 1))


def texels(network: nn.Module, size: int) -> Tensor:
    """(size, size, 3) what the network says at the centres of the painting's texels, the upper edge (v = 1) first."""
    centre = (torch.arange(size) + 0.5) / size
    v, u = torch.meshgrid(1.0 - centre, centre, indexing="ij")
    with torch.no_grad():
        return network(torch.stack([u, v], 2).view(-1, 2)).view(size, size, 3)


def recover(steps: int, spp: int = 4, report=print) -> tuple[rb.Scene, Tensor, list[float]]:
    """The scene with the network, the true painting (H, W, 3), and the RMS error of its texels before and after."""
    torch.manual_seed(0)
    scene = rb.load(ROOM / "scene.xml")
    target = read_image(ROOM / "target.exr").movedim(-1, 0)[None]
    truth, network = scene.painting.bsdf.reflectance.data.detach(), Painting()
    scene.painting.bsdf.reflectance = rb.NeuralTexture(network)
    renderer = rb.Renderer(scene, spp=spp, max_depth=5, compile=True)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    errors = []
    for step in range(steps + 1):
        error = (texels(network, len(truth)) - truth).square().mean().sqrt().item()
        if step % max(1, steps // 10) == 0:
            report(f"step {step:4d}   RMS error of the texels {error:.4f}")
        errors.append(error)
        if step < steps:
            optimizer.zero_grad()
            two_buffer_l2(renderer(seed=2 * step), renderer(seed=2 * step + 1), target).backward()
            optimizer.step()
            schedule.step()
    return scene, truth, errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=150)
    parser.add_argument("--out", type=Path, default=Path("painting.png"))
    arguments = parser.parse_args()
    scene, truth, _ = recover(arguments.steps)
    network = scene.painting.bsdf.reflectance.module
    with torch.no_grad():
        after = rb.render(scene, spp=64, max_depth=5, compile=True)[0]
        scene.painting.bsdf.reflectance = rb.NeuralTexture(Painting())
        before = rb.render(scene, spp=64, max_depth=5, compile=True)[0]
    rooms = torch.cat([before, read_image(ROOM / "target.exr").movedim(-1, 0), after], 2)
    found = texels(network, len(truth))
    pictures = torch.cat([truth, found, (found - truth).abs()], 1).movedim(-1, 0)
    rb.save_image(arguments.out, torch.cat([rooms, pictures.repeat_interleave(2, 1).repeat_interleave(2, 2)], 1))


if __name__ == "__main__":
    main()
