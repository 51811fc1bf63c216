"""Gradients of renderings are finite over the whole range of every parameter, in both precisions; if not, errors tell."""

import warnings

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but_every
from tests.scenes import GLOW, diffuse, load, look_at, rectangle, rgb, sensor
from tests.scenes.extremes import CASES
from torch_radbp.bsdf.roughconductor import RoughConductorKind
from torch_radbp.jit.tape import RECORDINGS
from torch_radbp.plugin import REGISTRY
from torch_radbp.scene.packing.pack import pack


def gradients(scene: rb.Scene, dtype: torch.dtype, sampling: str, **settings) -> dict[str, torch.Tensor]:
    """Of every parameter, for random cotangents."""
    scene.requires_grad_()
    renderer = rb.Renderer(scene, spp=3, max_depth=3, rr_depth=2, sampling=sampling, **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.SilhouetteWarning)
        image = renderer(seed=5)
    assert image.dtype == dtype and torch.isfinite(image).all() and image.max() > 0
    cotangent = torch.randn(image.shape, generator=torch.Generator().manual_seed(1)).to(dtype)
    image.backward(cotangent)
    return {name: parameter.grad for name, parameter in scene.named_parameters() if parameter.grad is not None}


@pytest.mark.parametrize("sampling", ["hybrid", deep("attached")])
@pytest.mark.parametrize("dtype", [torch.float32, deep(torch.float64)], ids=str)
@pytest.mark.parametrize("name", deep_but_every(50, CASES))
def test_gradients_are_finite(name, dtype, sampling):
    # As users run it; in double precision the operations as they are written.
    found = gradients(CASES[name](dtype), dtype, sampling, compile=dtype == torch.float32)
    bad = {name: int((~torch.isfinite(gradient)).sum()) for name, gradient in found.items()}
    assert not any(bad.values()), {name: count for name, count in bad.items() if count}
    assert sum(bool((gradient != 0).any()) for gradient in found.values()) >= 4


def test_every_plugin_takes_part():
    """A new plugin has to appear in one of these scenes."""
    names = (*list(CASES)[:1], "conductor black", "dielectric black", "thindielectric 1.0", "principled glass 0.0",
             "principledthin 0.0 0.0 1.0 0.0",
             "roughconductor ggx brushed", "roughdielectric ggx brushed", "blendbsdf 0.0", "mask 0.0", "normalmap 0.0",
             "bumpmap 0.0", "open lens", "folded lens", "two cameras in one place", "hazy sky",
             "null", "spectra 0.0", "sphere, constant sky")
    scenes = [CASES[name](torch.float32) for name in names]
    there = {(module.category, module.type) for scene in scenes for module in scene.modules() if hasattr(module, "category")}
    categories = ("bsdf", "texture", "emitter", "sensor", "shape")
    known = {(category, name) for category in categories for name in REGISTRY[category]}
    assert known - there == {("shape", "obj"), ("shape", "ply"), ("shape", "serialized")}  # meshes once they are read


def test_normals_and_areas_of_very_small_triangles_are_right():
    """The cross product of their edges is less than what `torch.nn.functional.normalize` takes for zero."""
    small = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]) * 1e-8
    scene = load(torch.float32, camera=sensor(2), lamp={
        "type": "mesh", "vertex_positions": small, "faces": torch.tensor([[0, 1, 2]]),
        "emitter": GLOW})
    surfaces, = pack(scene).lights.tables
    torch.testing.assert_close(surfaces.n.stack(), torch.tensor([[0.0, 0, 1]]))
    torch.testing.assert_close(surfaces.inverse_area, torch.tensor([2e16]))


METAL = {"type": "roughconductor", "alpha_u": 0.2, "alpha_v": 0.3}


def mirror_scene() -> rb.Scene:
    """A picture of a wall, which is lit by a metal panel in front of it: the metal is met at the second bounce."""
    return load(camera=sensor(3, fov=20), wall=rectangle((0, 0, 0), 2, bsdf=diffuse(0.5, 0.4, 0.3)), metal=METAL,
                panel=rectangle((0, 0, 5), 20, (0, 1, 0), 180, bsdf={"type": "ref", "id": "metal"}),
                lamp=rectangle((3, 0, 1), 1, (0, 1, 0), -90, emitter={"type": "area", "radiance": rgb(5, 4, 3)}))


def spoil(monkeypatch, factor) -> None:
    """Multiplies what metal reflects by a function of its first roughness."""
    plain = RoughConductorKind.eval_pdf

    def spoiled(kind, values, wi, wo):
        value, pdf = plain(kind, values, wi, wo)
        return value * factor(values[0].x), pdf

    monkeypatch.setattr(RoughConductorKind, "eval_pdf", spoiled)


def value_is_fine_and_derivative_is_not(x: torch.Tensor) -> torch.Tensor:
    return 1.0 + 0.0 * torch.sqrt(0.0 * x)


@pytest.mark.parametrize("settings", [
    {"compile": True}, {"sampling": "attached"}, {"adjoint": rb.MemoizedAdjoint("log", keep_hits=False)},
    {"adjoint": rb.ReplayAdjoint()}, {"adjoint": rb.QuadraticAdjoint()}, {"chunk": 5}], ids=str)
def test_a_gradient_that_is_not_finite_is_traced_to_parameter_plugin_bounce_and_count(settings, monkeypatch, fresh_stages):
    settings = {"spp": 2, "max_depth": 4, "compile": False} | settings
    scene = mirror_scene()
    for name in ("metal.alpha_u.value", "metal.alpha_v.value", "wall.bsdf.reflectance.value"):
        scene.get_parameter(name).requires_grad_()
    image = rb.Renderer(scene, **settings)(seed=3)
    image.sum().backward()
    assert all(torch.isfinite(p.grad).all() for p in scene.parameters() if p.grad is not None)
    spoil(monkeypatch, value_is_fine_and_derivative_is_not)
    for stage in fresh_stages:
        stage.fused.compiled.clear()
    RECORDINGS.known.clear()
    image = rb.Renderer(scene, **settings)(seed=3)
    with pytest.raises(rb.NonFiniteError) as caught:
        image.sum().backward()
    message = str(caught.value)
    assert message.startswith("the gradient of `metal.alpha_u.value` of the roughconductor `metal` is NaN or infinite in ")
    assert "paths, on the roughconductor `metal`" in message and "first at bounce 2, in " in message, message


def test_a_parametrised_parameter_has_its_own_name(monkeypatch, fresh_stages):
    scene = mirror_scene()
    scene.get_parameter("metal.alpha_u.value").requires_grad_()
    torch.nn.utils.parametrize.register_parametrization(scene.metal.alpha_u, "value", torch.nn.Softplus(), unsafe=True)
    spoil(monkeypatch, value_is_fine_and_derivative_is_not)
    with pytest.raises(rb.NonFiniteError, match="the gradient of `metal.alpha_u.value` of the roughconductor `metal`"):
        rb.Renderer(scene, spp=2, max_depth=3)(seed=1).sum().backward()


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.TapeAdjoint()], ids=str)
def test_an_image_that_is_not_finite_is_traced_to_plugin_bounce_and_count(adjoint, monkeypatch, fresh_stages):
    spoil(monkeypatch, lambda x: float("nan"))
    message = (r"the image is NaN or infinite in \d+ of 27 values: first at bounce 2, in \d+ of \d+ paths, on the "
               r"roughconductor `metal`; keep the parameters within bounds")
    with pytest.raises(rb.NonFiniteError, match=message):
        rb.Renderer(mirror_scene(), spp=2, max_depth=4, adjoint=adjoint)(seed=1)


@pytest.mark.parametrize("emitter, source", [
    ({"type": "envmap", "data": torch.full((2, 3, 3), 1e18), "scale": 1e24}, "the envmap `sun`"),
    ({"type": "projector", "irradiance": 1e18, "scale": 1e24, "to_world": look_at((0, 0, 2), (0, 0, 0), (0, 1, 0))},
     "the projector `sun`")], ids=["around", "at a point"])
def test_light_beyond_float32_is_blamed_on_the_emitter_and_not_on_the_wall(emitter, source):
    wall = rectangle((0, 0, 0), 2, bsdf=diffuse(0.5, 0.4, 0.3))
    scene = load(torch.float32, camera=sensor(3, fov=20), wall=wall, sun=emitter)
    with pytest.raises(rb.NonFiniteError, match=f"at bounce 1, .* in the light of {source}, which is too bright; keep"):
        rb.Renderer(scene, spp=2, max_depth=2)(seed=1)


def test_a_loss_that_is_not_finite_is_told_from_a_rendering_that_is_not():
    scene = mirror_scene()
    scene.get_parameter("wall.bsdf.reflectance.value").requires_grad_()
    image = rb.Renderer(scene, spp=1, max_depth=2)()
    with pytest.raises(FloatingPointError, match="in 3 of 27 values: it is the loss that is not finite"):
        (image[0, :, 0, 0] * float("nan")).sum().backward()
