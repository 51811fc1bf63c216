"""Random numbers of given directions are such that sampling takes, in float32, too."""

import torch

from tests.scenes import load, overhead
from torch_radbp.boundary.eye.drawn_directions import inverted_sampling
from torch_radbp.tensors.vec import Vec3
from torch_radbp.vertex.material import Material


def test_a_number_just_below_one_stays_below_it():
    """The slope of a microfacet grows without bound as its number nears 1. Here it is 1 - 2.9e-8, in float32 1."""
    glass = {"type": "roughdielectric", "alpha": 0.1}
    scene = load(torch.float32, camera=overhead(2), sky={"type": "constant"}, ball={"type": "sphere", "bsdf": glass})
    bsdf, = scene.bsdfs()
    numbers = (torch.full((1,), 0.1), bsdf.eta[None], torch.ones(1), torch.ones(1))
    material = Material(bsdf.kind(), tuple(Vec3(number, number, number) for number in numbers))
    wi, wo = (Vec3(*(torch.tensor([part]) for part in w)) for w in (
        (0.0941537618637085, -0.49783381819725037, 0.8621463775634766),
        (0.5546838045120239, 0.4547322392463684, 0.696810245513916)))
    found, density = inverted_sampling(material, wi, wo, torch.tensor([0.003262162208557129]))
    assert density > 0 and found.u > 1 - 1e-7
    assert found.u.float() < 1 and found.v.float() < 1
