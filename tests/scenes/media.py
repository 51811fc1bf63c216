"""Media that scatter, and what stands in them."""

from __future__ import annotations

import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, overhead, rectangle, rgb

BLACK = diffuse(0, 0, 0)
NULL = {"type": "null"}
SETTINGS = {"spp": 8, "max_depth": 5, "rr_depth": 2}


def haze(sigma_t=(0.3, 0.6, 1.2), albedo=(0.9, 0.5, 0.2), g=0.4) -> dict:
    return {"type": "homogeneous", "sigma_t": rgb(*sigma_t), "albedo": rgb(*albedo), "phase": {"type": "hg", "g": g}}


DULL = haze((0.3, 0.4, 0.5), (0.9, 0.6, 0.3), 0.4)


def slab(height: float, thickness: float, **more) -> dict:
    """A wide box that lies flat, with its middle at a height."""
    pose = torch.diag(torch.tensor([50.0, 50.0, thickness / 2, 1.0]))
    pose[2, 3] = height
    return {"type": "cube", "to_world": pose, "bsdf": NULL, **more}


def ball(radius: float = 0.8, **more) -> dict:
    return {"type": "sphere", "center": [0.0, 0.0, 1.0], "radius": radius, **more}


def room(bsdf=NULL, glow: tuple[float, ...] | None = None, inner=NULL, **more) -> rb.Scene:
    """A ball of haze, which may glow, with another one in it, above a floor under a lamp, a point light and a sky; the
    materials of both balls."""
    outer = haze() if glow is None else haze() | {"emission": rgb(*glow)}
    return load(torch.float64, camera=overhead(4, 4.0, 1.0), floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                ball=ball(bsdf=bsdf, interior=outer),
                core=ball(0.4, bsdf=inner, interior=haze((2, 1, 3), (0.3, 0.6, 0.9), -0.3)),
                lamp=rectangle((0.3, -0.8, 2.5), 0.4, (1, 0, 0), 170, bsdf=BLACK,
                               emitter={"type": "area", "radiance": rgb(3, 2, 1)}),
                bulb={"type": "point", "position": [-0.5, 0.6, 2.5], "intensity": rgb(2, 3, 4)},
                sky={"type": "constant", "radiance": rgb(0.2, 0.3, 0.4)}, **more)


MOVING = ["ball.to_world", "core.to_world", "floor.to_world", "camera.to_world", "bulb.position"]
NAMES = ["ball.interior.sigma_t.value.value", "ball.interior.albedo.value.value", "ball.interior.phase_function.g",
         "ball.interior.scale", "core.interior.sigma_t.value.value", "core.interior.albedo.value.value",
         "floor.bsdf.reflectance.value", "lamp.emitter.radiance.value", "sky.radiance.value"]


def assert_chance_and_connection_agree(scene: rb.Scene, renderings: int = 8, spp: int = 1024) -> None:
    """Of a `room` without its bulb: lamps that paths meet by chance, and connections to these, bring the same light."""
    del scene._modules["bulb"]  # which chance does not find
    renderers = [rb.Renderer(scene, spp=spp, max_depth=5, rr_depth=3, nee=nee) for nee in (False, True)]
    means = torch.stack([torch.stack([renderer(seed=seed).mean((0, 2, 3)) for seed in range(renderings)])
                         for renderer in renderers])
    assert (means > 0).all()
    difference, error = means.mean(1).diff(dim=0)[0], (means.var(1) / means.shape[1]).sum(0).sqrt()
    assert (difference.abs() < 4 * error).all() and (error < 0.05 * means[1].mean(0)).all()
