"""Compiled functions are made for appearances, not for scenes."""

from collections import Counter

import torch

import torch_radbp as rb
from tests.scenes import load, rectangle, rgb, sensor
from torch_radbp.jit.stages import CompiledStages

DIFFUSE = {"type": "diffuse", "reflectance": rgb(0.2, 0.5, 0.7)}
METAL = {"type": "roughconductor", "alpha": 0.2}
PICTURE = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": torch.full((3, 4, 3), 0.4)}}
LAMP = {"type": "area", "radiance": rgb(1, 2, 3)}


def render(**materials) -> None:
    """Forward and backward, compiled, of walls of these materials under a lamp."""
    walls = {name: rectangle((0.5 * number - 0.5, 0, 0), 0.25, bsdf=bsdf)
             for number, (name, bsdf) in enumerate(materials.items())}
    scene = load(torch.float32, camera=sensor(24), lamp=rectangle((0, 0, 5), emitter=LAMP), **walls)
    for name, parameter in scene.named_parameters():
        parameter.requires_grad_(".bsdf." in name)
    rb.Renderer(scene, spp=4, max_depth=4, compile=True)().sum().backward()


def functions(stages: CompiledStages) -> Counter[str]:
    """How many functions each stage was compiled to so far."""
    return Counter({stage.function.__name__: len(stage.fused.compiled) for stage in stages})


def test_a_second_scene_of_known_appearances_compiles_nothing_and_a_new_one_only_itself(fresh_stages):
    render(a=DIFFUSE, b=METAL)
    first = functions(fresh_stages)
    render(floor=METAL, wall=DIFFUSE, third=METAL)
    assert functions(fresh_stages) == first
    render(a=DIFFUSE, b=METAL, c=PICTURE)
    new = functions(fresh_stages) - first
    # Of paths of the image and of those of the derivative.
    assert new.pop("bounce") == 2 and new.pop("bounce_adjoint") == 1
    assert not new
