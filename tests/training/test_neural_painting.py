"""The script that recovers a painting as a network, run briefly."""

import torch

from torch_radbp.training.neural_painting import recover


def test_the_network_comes_closer_to_the_painting():
    """Of which it sees nothing but the room that it lights."""
    lines: list[str] = []
    scene, truth, errors = recover(8, spp=1, report=lines.append)
    assert len(errors) == 9 and len(lines) == 9
    assert errors[-1] < 0.75 * errors[0]
    assert truth.shape == (64, 64, 3)
    assert all(torch.isfinite(weight).all() for weight in scene.painting.bsdf.reflectance.module.parameters())
