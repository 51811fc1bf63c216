"""Renderings whose bounces are recorded, and the same without that."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

import torch_radbp as rb
from tests.gradients import cotangent, unwarned_renderer
from tests.scenes import cornell, diffuse, load, parameters, rectangle, rgb, sensor, sky_and_points, textured, two_sided
from torch_radbp.adjoint import taped_sweep
from torch_radbp.boundary.eye import ideal_steps
from torch_radbp.io.values.transform import translate
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.path import taped_bounces, whole_paths

SETTINGS = {"spp": 4, "max_depth": 5, "rr_depth": 2, "compile": True, "terms": ("interior",)}


def crossing(dtype: torch.dtype) -> rb.Scene:
    """An instance, a ball and a mirror under a sky."""
    ball = {"type": "sphere", "radius": 0.3, "to_world": translate((0.5, 0.2, 0)), "bsdf": {"type": "conductor"}}
    group = {"type": "shapegroup", "own": rectangle((0, 0, 0), 0.3, bsdf=diffuse(0.2, 0.5, 0.7))}
    shown = {"type": "instance", "own": {"type": "ref", "id": "group"}, "to_world": translate((-0.3, 0, 0.2))}
    floor = rectangle((0, -0.6, 0), 2.0, (1, 0, 0), -90, bsdf=diffuse(0.6, 0.5, 0.4))
    sky = {"type": "constant", "radiance": rgb(1, 0.8, 0.6)}
    return load(dtype, sensor=sensor(9), group=group, ball=ball, shown=shown, floor=floor, sky=sky)


SCENES = {"closed box": lambda dtype: cornell(dtype, 12), "textures": lambda dtype: textured(dtype=dtype),
          "two sides": two_sided, "sky and points": sky_and_points, "instances and balls": crossing}

WAYS = [(name, sampling) for name in SCENES for sampling in ("detached", "hybrid", "attached")]
SOME = [("closed box", "detached"), ("textures", "hybrid"), ("two sides", "attached"), ("sky and points", "detached"),
        ("instances and balls", "attached")]  # each scene, and each sampling


def singly(monkeypatch: pytest.MonkeyPatch) -> None:
    """From here on nothing is recorded of bounces."""
    for module in (taped_bounces, taped_sweep, whole_paths, ideal_steps):
        monkeypatch.setattr(module, "recordable", lambda integrand: False)


def rendered(scene: rb.Scene, names=None, **settings) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """An image, and the gradients of all parameters that it depends on, or of those called `names`."""
    named = dict(scene.named_parameters()) if names is None else names
    wanted = parameters(scene, named)
    image = unwarned_renderer(scene, **SETTINGS | settings)(seed=3)
    found = torch.autograd.grad(image, wanted, cotangent(image.detach()), allow_unused=True)
    return image.detach(), {name: gradient for name, gradient in zip(named, found) if gradient is not None}


def assert_recorded_alike(build: Callable[[], rb.Scene], names: list[str], monkeypatch: pytest.MonkeyPatch,
                          **settings) -> None:
    """Recorded or not, images, gradients by `names` and numbers of rays are the same, with and without a backward pass."""
    def everything() -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor], int]:
        image, gradients = rendered(build(), names, **settings)
        renderer = unwarned_renderer(build().requires_grad_(False), **SETTINGS | settings)
        caster = renderer.prepare(1, None, None, None).caster
        before = caster.rays_cast
        return renderer(seed=1), image, gradients, caster.rays_cast - before

    calls, call = [], Recorded.__call__
    monkeypatch.setattr(Recorded, "__call__", lambda *given, **more: calls.append(1) or call(*given, **more))
    found = everything()
    assert calls and found[-1] > 0
    singly(monkeypatch)
    expected = everything()
    assert torch.equal(found[0], expected[0]) and torch.equal(found[1], expected[1]) and found[-1] == expected[-1]
    assert expected[1].std() > 0 and expected[2].keys() == found[2].keys() == set(names)
    for name, gradient in expected[2].items():
        assert gradient.abs().max() > 1e-4 and torch.equal(gradient, found[2][name]), name
