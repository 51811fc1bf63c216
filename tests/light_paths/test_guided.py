"""Light beside edges is traced by paths that are sent to where mirrors show lamps."""

import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, sensor
from torch_radbp.call.mirror_spheres import guide_spheres, with_guided_paths
from torch_radbp.call.render_call import started
from torch_radbp.path.trace import trace

SPP, SEEDS = 16, 24
MATERIALS = {"plastic": {"type": "plastic"}, "mirror": {"type": "conductor", "material": "none"}, "glass": {"type": "dielectric"},
             "rough plastic beside": {"type": "roughplastic", "alpha": 0.2}}
BULB = {"type": "area", "radiance": 40.0}


def mirror_scene(material: str, dtype: torch.dtype = torch.float32) -> rb.Scene:
    """A ball over a floor beside a small lamp; a second lamp and a mirror on the floor, so that there are several of each."""
    return load(dtype, integrator={"type": "path", "max_depth": 5, "rr_depth": 100},
                camera=sensor(8, (0, -2.5, 3), (0, 0, 0), 45), floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                ball={"type": "sphere", "center": [0, 0, 0.7], "radius": 0.5, "bsdf": MATERIALS[material]},
                block={"type": "sphere", "center": [1.2, 0.5, 0.3], "radius": 0.3, "bsdf": {"type": "conductor"}},
                lamp=rectangle((0.6, 0.3, 3), 0.15, (1, 0, 0), 180, emitter=BULB),
                bulb={"type": "sphere", "center": [-1.5, 0, 2], "radius": 0.1, "emitter": BULB})


def light(renderer: rb.Renderer, guided: bool, seed: int) -> torch.Tensor:
    """(3, N) radiance along camera rays."""
    call = renderer.prepare(seed, None, SPP, None)
    with torch.no_grad():
        integrand = with_guided_paths(call.integrand) if guided else call.integrand
        found = [trace(integrand, started(call, call.source.samples(chunk, 0, call.stages, False)))
                 for wavefront in call.wavefronts for chunk in wavefront.chunks]
    return torch.cat([torch.stack(tuple(part)) for part in found], 1)


@pytest.mark.parametrize("compile", [True, False])
@pytest.mark.parametrize("material", MATERIALS)
def test_guided_paths_find_the_same_light(material, compile):
    """In the mean; by Welch's test of three channels, in five standard errors."""
    renderer = rb.Renderer(mirror_scene(material), compile=compile, light_paths="camera")
    means = {guided: torch.stack([light(renderer, guided, 1000 * guided + seed).double().mean(1) for seed in range(SEEDS)])
             for guided in (False, True)}
    assert means[True].mean() > 0.05
    error = sum(found.var(0) / SEEDS for found in means.values()).sqrt()
    assert ((means[True].mean(0) - means[False].mean(0)).abs() / error).max() < 5
    assert error.max() < 0.1 * means[True].mean()


def test_guided_paths_are_less_noisy_beside_mirrors():
    renderer = rb.Renderer(mirror_scene("mirror"), light_paths="camera")
    noise = [torch.stack([light(renderer, guided, seed).double() for seed in range(SEEDS)]).var(0).mean() for guided in (True, False)]
    assert noise[0] < 0.3 * noise[1]


def test_there_is_nothing_to_guide_to_without_mirrors_or_lamps():
    def found(**things) -> bool:
        scene = load(torch.float32, camera=sensor(4), floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)), **things)
        call = rb.Renderer(scene, max_depth=4).prepare(0, None, 1, None)
        return guide_spheres(call.integrand.proposal) is not None

    ball = {"type": "sphere", "bsdf": MATERIALS["mirror"]}
    lamp = rectangle((0, 0, 3), 0.5, emitter=BULB)
    assert found(ball=ball, lamp=lamp)
    assert not found(ball=ball, sky={"type": "constant"})
    assert not found(ball=ball, lamp={"type": "point", "position": [0, 0, 3]})
    assert not found(lamp=lamp)
