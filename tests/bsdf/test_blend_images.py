"""A blend that scatters light once shows the mixture of what its two materials show."""

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.deep import deep_but
from tests.scenes import load
from tests.scenes.materials import MATERIALS
from tests.scenes.parts import camera, plane, sky

WEIGHT = 0.3
BATCHES, SPP = 40, 400
DIFFUSE = {"type": "twosided", "both": MATERIALS["diffuse"]}
MIRROR = {"type": "conductor", "specular_reflectance": [0.3, 0.9, 0.5]}
DIAMOND = {"type": "dielectric", "int_ior": "diamond"}
PAIRS = {
    "mirrors": (MATERIALS["conductor"], MIRROR),
    "glass and a mirror": (MATERIALS["dielectric"], MATERIALS["conductor"]),
    "glasses": (MATERIALS["dielectric"], DIAMOND),
    "plastics": (MATERIALS["plastic"], MATERIALS["nonlinear plastic"]),
    "plastic and a mirror": (MATERIALS["plastic"], MATERIALS["conductor"]),
    "glass and plastic": (MATERIALS["dielectric"], MATERIALS["plastic"]),
    "diffuse and a mirror": (DIFFUSE, MATERIALS["conductor"]),
}


def renders(bsdf: dict, seed: int) -> Tensor:
    """(BATCHES, 12) independent images of a material under a sky, in light that is scattered once."""
    scene = load(torch.float64, camera=camera(), sky=sky(), plane=plane(bsdf=bsdf))
    renderer = rb.Renderer(scene, spp=SPP, max_depth=2)
    with torch.no_grad():
        return torch.stack([renderer(seed=seed + batch).flatten() for batch in range(BATCHES)])


@pytest.mark.parametrize("name", deep_but(["mirrors", "glass and a mirror", "plastics", "diffuse and a mirror"], PAIRS))
def test_the_image_of_a_blend_is_the_mixture_of_the_images_of_its_parts(name):
    """Delta lobes that meet, and delta lobes beside smooth ones. |z| < 5.5 of 12 values: level 1e-5 with 39 degrees of
    freedom."""
    first, second = (renders(part, 1000 * number) for number, part in enumerate(PAIRS[name]))
    blend = renders({"type": "blendbsdf", "weight": WEIGHT, "first": PAIRS[name][0], "second": PAIRS[name][1]}, 2000)
    mixture = (1 - WEIGHT) * first + WEIGHT * second
    expected = mixture.mean(0)
    assert (expected > 0.05).all() and ((first.mean(0) - second.mean(0)).abs() > 0.05 * expected).any()
    error = ((blend.var(0) + mixture.var(0)) / BATCHES).sqrt()
    assert (error < 0.02 * expected).all()
    assert ((blend.mean(0) - expected).abs() < 5.5 * error).all()
    whole = ((blend.mean(1).var() + mixture.mean(1).var()) / BATCHES).sqrt()
    assert whole < 0.005 * expected.mean() and (blend.mean() - mixture.mean()).abs() < 4.5 * whole


def test_mitsubas_blend_of_a_smooth_and_an_ideal_material_is_darker_than_its_mixture(mi):
    """What `BlendBSDF` says of Mitsuba 3.9.1: here 0.91 of the mixture. Of two smooth materials it is the mixture."""
    matrix = mi.ScalarTransform4f
    light = mi.Bitmap(torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(3)).numpy() * 3)
    smooth, mirror = ({"type": "twosided", "both": {"type": kind}} for kind in ("diffuse", "conductor"))
    rough = {"type": "twosided", "both": {"type": "roughconductor", "alpha": 0.2}}

    def mean(bsdf: dict, seed: int) -> Tensor:
        """(BATCHES,) means of independent images."""
        film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
        scene = mi.load_dict({
            "type": "scene", "integrator": {"type": "path", "max_depth": 2}, "sky": {"type": "envmap", "bitmap": light},
            "camera": {"type": "perspective", "fov": 40.0, "to_world": matrix().translate([0.3, 0.4, -3.5]), "film": film},
            "plane": {"type": "rectangle", "to_world": matrix().rotate([0.35, 1, 0.23], 200).scale(5), "bsdf": bsdf}})
        return torch.tensor([float(mi.render(scene, spp=100, seed=seed + batch).array.__array__().mean())
                             for batch in range(BATCHES)])

    for other, low, high in ((rough, 0.99, 1.01), (mirror, 0.8, 0.96)):
        first, second = mean(smooth, 0), mean(other, 1000)
        blend = mean({"type": "blendbsdf", "weight": WEIGHT, "first": smooth, "second": other}, 2000)
        mixture = (1 - WEIGHT) * first + WEIGHT * second
        error = ((blend.var() + mixture.var()) / BATCHES).sqrt() / mixture.mean()
        assert error < 0.005 and low < blend.mean() / mixture.mean() < high
