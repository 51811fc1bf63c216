"""What is left out of paths from lamps, or done otherwise, changes nothing: bit for bit."""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.light_paths.scenes import lit_ball
from tests.scenes import diffuse, load, rectangle, sensor

GLASS, METAL = {"type": "dielectric"}, {"type": "roughconductor", "alpha": 0.3}
HEIGHTS = (0.01 * torch.rand(8, 8, 1, generator=torch.Generator().manual_seed(1))).numpy()
BUMPS = {"type": "bumpmap", "arbitrary": {"type": "bitmap", "raw": True, "data": HEIGHTS}, "bsdf": GLASS}
CASES = {"diffuse": ("area", {}), "glass": ("point", {"bsdf": GLASS}), "metal": ("area", {"bsdf": METAL}),
         "bumps on glass": ("directionalarea", {"bsdf": BUMPS})}


def found(case: str, light_paths: str = "all", wanted: str = "") -> list[torch.Tensor]:
    """An image of 64 x 64 pixels and gradients of its squares, by all parameters whose names have `wanted` in them."""
    lamp, ball = CASES[case]
    scene = lit_ball(lamp, size=64, rfilter="gaussian", **ball)
    parameters = [parameter.requires_grad_() for name, parameter in scene.named_parameters()
                  if wanted in name and name.split(".")[0] in ("floor", "ball")
                  and not name.endswith(("to_world", "vertex_positions", "vertex_normals", "center", "radius"))]
    assert parameters
    image = rb.Renderer(scene, spp=2, light_paths=light_paths)(seed=3)
    gradients = torch.autograd.grad(image.square().mean(), parameters)
    assert all(bool(torch.isfinite(part).all()) for part in (image, *gradients))
    assert bool(image.any()) and any(bool(gradient.any()) for gradient in gradients)
    return [image.detach(), *gradients]


def assert_same(here: list[torch.Tensor], there: list[torch.Tensor]) -> None:
    assert len(here) == len(there) and all(map(torch.equal, here, there))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("case", deep_but(["metal", "bumps on glass"], CASES))
def test_whole_paths_bring_what_bounces_bring(case, monkeypatch):
    asked, whole = [], rb.path.trace.brought_by_whole_paths
    monkeypatch.setattr("torch_radbp.path.trace.brought_by_whole_paths",
                        lambda *arguments: asked.append(whole(*arguments)) or asked[-1])
    here = found(case)
    assert asked and None not in asked
    monkeypatch.setattr("torch_radbp.path.trace.brought_by_whole_paths", lambda *args: None)
    assert_same(here, found(case))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("case, light_paths", [
    ("metal", "all"), ("bumps on glass", "all"), ("bumps on glass", "caustics"),
    deep("diffuse", "all"), deep("glass", "all"), deep("glass", "caustics")])
def test_paths_that_bring_nothing_have_no_derivatives(case, light_paths, monkeypatch):
    here = found(case, light_paths)
    monkeypatch.setattr("torch_radbp.adjoint.bounce.lanes_may_be_left_out", lambda layout: False)
    assert_same(here, found(case, light_paths))


@pytest.mark.filterwarnings("ignore")
def test_derivatives_do_not_depend_on_whether_first_rays_have_some(monkeypatch):
    here = found("bumps on glass", wanted="ball")
    integrand = rb.path.integrand.Integrand
    settings_at = integrand.settings_at
    monkeypatch.setattr(integrand, "settings_at", lambda self, depth: settings_at(self, depth)._replace(fixed_start=False))
    for one, other in zip(here, found("bumps on glass", wanted="ball")):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5 * float(one.abs().max()))  # rounding of other code


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name, seen", [("beside", False), ("lamp in view", True), ("mirror in view", True)])
def test_cameras_that_see_nothing_of_their_own_light_trace_no_paths(name, seen, monkeypatch):
    """The image is that with the paths."""
    at = {"beside": ((0, 0, 9), (9, 0, 1)), "lamp in view": ((0, 0.5, 2), (9, 0, 1)),
          "mirror in view": ((0, 0, 9), (0.5, 0.5, 0))}[name]
    scene = load(torch.float32, camera=sensor(32, (0, -2.5, 4), (0, 0, 0), 40, "gaussian"),
                 floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                 lamp=rectangle(at[0], 0.4, (1, 0, 0), 180, emitter={"type": "area", "radiance": 5.0}),
                 mirror=rectangle(at[1], 0.4, bsdf={"type": "conductor"}))
    told = []

    def watched(call):
        told.append(rb.rendering.own_light.cameras_see_own_light(call))
        return told[-1]

    monkeypatch.setattr("torch_radbp.rendering.light_paths.cameras_see_own_light", watched)
    here = rb.render(scene, spp=4, seed=1, light_paths="all")
    monkeypatch.setattr("torch_radbp.rendering.light_paths.cameras_see_own_light", lambda call: True)
    assert told == [seen] and bool(here.any()) and torch.equal(here, rb.render(scene, spp=4, seed=1, light_paths="all"))


@pytest.mark.filterwarnings("ignore")
def test_views_without_mirrors_are_not_scanned(monkeypatch):
    """What a mirror beside the view shows jumps nowhere in it; before the camera it does."""
    def scanned(place: tuple[float, float, float]) -> torch.Tensor | None:
        scene = load(torch.float32, camera=sensor(16, (0, -2.5, 4), (0, 0, 0), 40),
                     floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)), lamp={
                         "type": "point", "position": [0, 1, 6], "intensity": 20.0},
                     mirror=rectangle(place, 0.8, (1, 0, 0), 30, bsdf={"type": "conductor"}))
        scene.mirror.to_world.requires_grad_()
        passes = []
        corner_passes = rb.boundary.terms.scans.corner_passes
        with monkeypatch.context() as patched:
            patched.setattr("torch_radbp.boundary.terms.scans.corner_passes",
                            lambda *arguments: passes.append(1) or corner_passes(*arguments))
            rb.render(scene, spp=16, seed=1, max_depth=3).mean().backward()
        return len(passes)

    assert scanned((0, 0, 0.5)) > 0 and scanned((0, 9, 0.5)) == 0
