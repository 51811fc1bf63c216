"""How much noise the default sampler saves: ``python -m benchmarks.sampler_noise``.

Cornell box, 32 x 32, depth 4: images and gradients of the colours of the walls and the lamp by independent seeds, with
independent samples and with points of low discrepancy. The table has the ratio of their standard deviations, median over
values, and how many times as many independent samples would be as good.
"""

from __future__ import annotations

import argparse

import torch
from rich.progress import track

import torch_radbp as rb
from benchmarks.scenes.cornell_box import PARAMETERS, cornell_box
from benchmarks.scenes.description import NO_ROULETTE, Setting, cotangent
from torch_radbp.sensor.sampler import Independent, LowDiscrepancy

SIZE, DEPTH = 32, 4  # pixels, bounces


def deviations(scene: rb.Scene, spp: int, seeds: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Standard deviations of the image, and of the gradients of its product with a fixed cotangent."""
    parameters = [scene.get_parameter(name) for name in PARAMETERS]
    renderer, images, gradients = rb.Renderer(scene, spp=spp, max_depth=DEPTH, rr_depth=NO_ROULETTE), [], []
    adj_image = torch.from_numpy(cotangent(SIZE)).permute(2, 0, 1)[None]
    for seed in track(range(seeds), f"{spp} samples", transient=True):
        image = renderer(seed=seed)
        gradients.append(torch.cat([g.reshape(-1) for g in torch.autograd.grad(image, parameters, adj_image)]))
        images.append(image.detach())
    return torch.stack(images).std(0), torch.stack(gradients).std(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spp", type=int, nargs="+", default=[4, 16, 64, 256])
    parser.add_argument("--seeds", type=int, default=24)
    options = parser.parse_args()
    print("| samples | image | gradients | samples saved in the image | in gradients |\n|---|---|---|---|---|")
    for spp in options.spp:
        scene, found = cornell_box(Setting(SIZE, spp, DEPTH)).load(), []
        for sampler in (LowDiscrepancy(), Independent()):
            scene.sensors[0].sampler = sampler
            found.append(deviations(scene, spp, options.seeds))
        image, gradient = ((points / independent)[independent > 0].median() for points, independent in zip(*found))
        print(f"| {spp} | {image:.2f} | {gradient:.2f} | x {1 / image**2:.1f} | x {1 / gradient**2:.1f} |", flush=True)


if __name__ == "__main__":
    main()
