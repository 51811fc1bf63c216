"""Where a weight that is not differentiated is 0 or 1, only one of two materials is there: cut-outs add no noise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import unwarned_renderer
from tests.scenes import diffuse, load, rectangle, rgb, sensor, texels
from tests.scenes.materials import MATERIALS
from tests.scenes.parts import camera, lamp, plane, sky
from torch_radbp.bsdf.diffuse import Diffuse
from torch_radbp.bsdf.mask import Mask
from torch_radbp.texture.bitmap import Bitmap
from torch_radbp.texture.checkerboard import Checkerboard
from torch_radbp.texture.mesh_attribute import MeshAttribute

GLOW = {"type": "area", "radiance": {"type": "bitmap", "data": texels(3, 4, 5)}}


def blend(weight: Any, first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


PAIRS = {
    "diffuse and mirror": (diffuse(0.2, 0.8, 0.3), MATERIALS["conductor"]),
    "glass and plastic": (MATERIALS["glass ggx"], MATERIALS["plastic"]),
    "a blend of pane and metal": (
        blend(0.4, MATERIALS["dielectric"], MATERIALS["metal ggx"]), diffuse(0.7, 0.4, 0.1)),
}


def even(value: float) -> dict[str, Any]:
    """An image of one value, read between texels: ones are ones up to rounding."""
    return {"type": "bitmap", "data": np.full((3, 5, 3), value), "raw": True}


def lit(bsdf: dict[str, Any], dtype: torch.dtype = torch.float64) -> rb.Scene:
    """A plane of a material under a sky and a lamp, which is not so near that points of the plane slide, seen from there.

    There is a mirror beneath it, since where there is one, edges are looked for by more paths.
    """
    return load(dtype, camera=camera(4), sky=sky(), lamp=lamp(), plane=plane((0, 0, -1), bsdf=bsdf),
                mirror=plane((0, 0, -9), bsdf=MATERIALS["conductor"]))


def rendered(scene: rb.Scene, **settings: Any) -> Tensor:
    return unwarned_renderer(scene, **{"spp": 16, "max_depth": 4} | settings)(seed=6)


@pytest.mark.parametrize("dtype, compile", [(torch.float32, True), (torch.float64, False), deep(torch.float32, False),
                                            deep(torch.float64, True)], ids=str)
@pytest.mark.parametrize("weight", [0, 1])
@pytest.mark.parametrize("pair", PAIRS)
def test_a_blend_at_its_end_is_the_material_there(pair, weight, dtype, compile):
    """At one seed: paths are the same, but where rounding of the weight moves a choice between lobes."""
    image, expected = (rendered(lit(bsdf, dtype), compile=compile) for bsdf in (
        blend(even(weight), *PAIRS[pair]), PAIRS[pair][weight]))
    assert expected.mean() > 0.1 and torch.isfinite(image).all()
    close = torch.isclose(image, expected, rtol=2e-4 if dtype == torch.float32 else 1e-9, atol=0)
    assert close.float().mean() > (0.9 if dtype == torch.float32 else 0.9999)


@pytest.mark.parametrize("weight, pair, sampling", [
    (0, "diffuse and mirror", "detached"), (1, "diffuse and mirror", "hybrid"), (0, "diffuse and mirror", "attached"),
    (1, "glass and plastic", "detached"), (0, "glass and plastic", "attached"),  # hybrid sampling follows glass alone
    deep(1, "diffuse and mirror", "detached"), deep(0, "diffuse and mirror", "hybrid"),
    deep(1, "diffuse and mirror", "attached"), deep(0, "glass and plastic", "detached"),
    deep(1, "glass and plastic", "attached")])
def test_so_are_its_derivatives(pair, weight, sampling):
    """By the pose of the plane and a colour of the material."""
    gradients = []
    for bsdf, path in ((blend(even(weight), *PAIRS[pair]), f"plane.bsdf.bsdf_{weight}."),
                       (PAIRS[pair][weight], "plane.bsdf.")):
        scene = lit(bsdf)
        colour = next(name for name, _ in scene.named_parameters() if name.startswith(path) and "reflectance" in name)
        wanted = [scene.get_parameter(name).requires_grad_() for name in (colour, "plane.to_world")]
        image = rendered(scene, sampling=sampling, compile=False)
        gradients.append(torch.autograd.grad((image**2).sum(), wanted))
    for value, expected in zip(*gradients):
        assert torch.isfinite(expected).all() and expected.abs().max() > 1e-3
        torch.testing.assert_close(value, expected, rtol=1e-6, atol=1e-6 * float(expected.abs().max()))


def leaf(opacity: Any) -> dict[str, Any]:
    return {"type": "mask", "opacity": opacity, "nested": {"type": "twosided", "both": diffuse(0.2, 0.7, 0.3)}}


def before_a_picture(sheet: dict[str, Any]) -> rb.Scene:
    return load(torch.float64, camera=camera(6), picture=plane((0.2, -0.1, -1), emitter=GLOW), sheet=sheet,
                point={"type": "point", "position": [0.9, 1.1, 2.3], "intensity": rgb(9, 8, 7)})


def test_what_is_behind_a_clear_mask_is_seen_without_noise():
    clear, nothing = before_a_picture(plane(bsdf=leaf(even(0)))), before_a_picture(plane((0, 0, -30)))
    expected = rendered(nothing, spp=1, max_depth=1)
    image = rendered(clear, spp=1, max_depth=2)
    assert expected.min() > 0.05
    torch.testing.assert_close(image, expected, rtol=1e-5, atol=0)  # hits are found in float32
    clear.get_parameter("sheet.bsdf.opacity.data").requires_grad_()
    assert (rendered(clear, spp=1, max_depth=2) / expected - 1).abs().max() > 0.01  # both sides are sampled again


def sheet(right: float, **attributes: Any) -> dict[str, Any]:
    """A sheet from x = -1 to `right` that is opaque to the left of 0, where its coordinate u is 0.5."""
    corners = torch.tensor([[-1, -1, 0], [right, -1, 0.0], [right, 1, 0.3], [-1, 1, 0.3]])
    return {"type": "mesh", "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]), "vertex_positions": corners,
            "vertex_texcoords": (corners[:, :2] + 1) / 2} | attributes


@pytest.mark.parametrize("sampling", ["detached", "attached", "hybrid"])
def test_a_sheet_cut_out_by_its_mask_is_one_that_ends_there(sampling):
    """Sample by sample, so that there is no noise that the shape itself does not have; and so are derivatives."""
    half = {"type": "bitmap", "data": np.array([[[1.0] * 3, [0.0] * 3]]), "raw": True, "filter_type": "nearest"}
    results = []
    for part in (sheet(1.0, bsdf=leaf(half)), sheet(0.0, bsdf=leaf(1.0))):
        scene = before_a_picture(part)
        vertices, colour = (scene.get_parameter(f"sheet.{name}") for name in (
            "vertex_positions", "bsdf.nested_bsdf.brdf_0.reflectance.value"))
        shift = torch.zeros(3, dtype=torch.float64, requires_grad=True)
        colour.requires_grad_()
        # A jump inside of a mask is none of the edges that are sampled.
        renderer = unwarned_renderer(scene, spp=1, max_depth=2, sampling=sampling, terms=["interior"])
        image = torch.func.functional_call(renderer, {"scene.sheet.vertex_positions": vertices + shift}, kwargs={"seed": 8})
        results.append((image.detach(), *torch.autograd.grad((image**2).sum(), (shift, colour))))
    for value, expected in zip(*results):
        assert torch.isfinite(expected).all() and expected.abs().max() > 0.01
        torch.testing.assert_close(value, expected, rtol=1e-6, atol=1e-9)


def test_a_change_of_an_opacity_of_zero_or_one_has_its_derivative_forward_too():
    """A black sheet: the derivative is minus what is behind."""
    for opacity in (0.0, 1.0):
        black = {"type": "mask", "opacity": opacity, "black": {"type": "diffuse", "reflectance": 0.0}}
        scene = load(torch.float64, camera=sensor(2), sheet=rectangle((0, 0, 0), 9.0, bsdf=black),
                     lamp=rectangle((0, 0, -1), 9.0, emitter={"type": "area", "radiance": rgb(2, 3, 4)}))
        found = rb.jvp(scene, {"sheet.bsdf.opacity.value": torch.ones(())}, spp=2000, max_depth=2, seed=1)
        expected = -torch.tensor([2.0, 3.0, 4.0], dtype=torch.float64)
        torch.testing.assert_close(found.mean((0, 2, 3)), expected, rtol=0.2, atol=0)


def test_weights_are_still_only_if_all_that_they_come_from_is_known_not_to_move():
    number, attribute = 0.0, MeshAttribute(name="vertex_holes")
    squares, ones = Checkerboard(color0=0.0, color1=1.0), Bitmap(data=torch.ones(2, 2))

    def still(weight: Any, name: str | None = None) -> bool:
        bsdf = Mask(nested_bsdf=Diffuse(), opacity=weight).requires_grad_(False)
        if name is not None:
            bsdf.get_parameter(f"opacity.{name}").requires_grad_()
        return bsdf.kind().still

    assert still(number) and still(ones) and still(squares) and still(torch.nn.Linear(2, 1))
    assert still(ones, "to_uv")  # a weight in [0, 1] is level where it is 0 or 1
    assert not still(number, "value") and not still(ones, "data") and not still(squares, "color1.value")
    assert not still(torch.nn.Linear(2, 1), "module.bias") and not still(attribute)
    assert not still(Checkerboard(color0=attribute, color1=1.0))


def test_an_opacity_of_zero_that_a_mesh_carries_has_its_derivative():
    scene = before_a_picture(sheet(1.0, bsdf=leaf({"type": "mesh_attribute", "name": "vertex_holes"})))
    scene.get_submodule("sheet").add_attribute("vertex_holes", torch.zeros(4, 1))
    holes = scene.get_parameter("sheet.vertex_holes").requires_grad_()
    gradient, = torch.autograd.grad(rendered(scene, spp=64).sum(), holes)
    assert (gradient != 0).all()


@pytest.mark.parametrize("sampling", ["hybrid", "attached"])
def test_holes_that_move_over_a_surface_have_their_derivative(sampling):
    """A black sheet before a lamp, opaque on one side of the view and clear on the other, with a soft edge.

    By the fundamental theorem, the mean of the opacity's derivative by u is 1 over the range of u in view. Noise: 1.7 %.
    """
    holes = {"type": "bitmap", "data": np.array([[1, 1, 1, 0, 0, 0, 0, 1.0]])[..., None].repeat(3, 2), "raw": True}
    scene = load(torch.float64, camera=sensor(4, fov=20), sheet=rectangle((0, 0, 0), 1.0, bsdf={
        "type": "mask", "opacity": holes, "black": {"type": "diffuse", "reflectance": 0.0}}),
        lamp=rectangle((0, 0, -1), 9.0, emitter={"type": "area", "radiance": rgb(2, 3, 4)}))
    tangent = torch.zeros(4, 4)
    tangent[0, 3] = 1.0
    found = rb.jvp(scene, {"sheet.bsdf.opacity.to_uv": tangent}, spp=4000, max_depth=2, seed=1, sampling=sampling)
    expected = torch.tensor([2.0, 3.0, 4.0], dtype=torch.float64) / (3.5 * math.tan(math.radians(10)))
    torch.testing.assert_close(found.mean((0, 2, 3)), expected, rtol=0.07, atol=0)
