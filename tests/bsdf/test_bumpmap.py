"""Bump maps: against closed forms, and heights from every source."""

import math

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.bsdf.lanes import directions, material, values_of
from tests.scenes import load, rectangle, rgb, sensor
from tests.scenes.materials import MATERIALS
from torch_radbp.bsdf.bumpmap import BumpMapKind
from torch_radbp.tensors.vec import ShadingFrame, Vec2, Vec3, cross, dot, normalize
from torch_radbp.texture.slope import along_surface
from torch_radbp.vertex.barycentric_gradients import barycentric_gradients

SLOPE = (0.3, -0.2)  # dh/dx, dh/dy
SUN = {"type": "directional", "direction": [-0.3, -0.4, -0.8], "irradiance": rgb(2, 3, 4)}


def ramp() -> np.ndarray:
    """(8, 8, 1) heights of a plane that rises by SLOPE, over a square of edge 2."""
    at = (np.arange(8) + 0.5) / 8 * 2
    return (SLOPE[0] * at[None, :] + SLOPE[1] * at[:, None])[..., None]


class Tilt(torch.nn.Module):
    """Heights in proportion to the place."""

    def __init__(self, *slopes: float):
        super().__init__()
        self.slopes = torch.nn.Parameter(torch.tensor(slopes, dtype=torch.float64))

    def forward(self, place: torch.Tensor) -> torch.Tensor:
        return (place * self.slopes).sum(1, keepdim=True)


SOURCES = {
    "bitmap": lambda: {"type": "bitmap", "data": ramp(), "raw": True, "wrap_mode": "clamp"},
    "stretched bitmap": lambda: {"type": "bitmap", "data": 0.5 * ramp(), "raw": True, "wrap_mode": "clamp",
                                 "to_uv": np.diag([2.0, 2.0, 1.0, 1.0])},
    "attribute": lambda: {"type": "mesh_attribute", "name": "vertex_height"},
    "network of uv": lambda: Tilt(2 * SLOPE[0], 2 * SLOPE[1]),
    "network of position": lambda: rb.NeuralTexture(Tilt(*SLOPE, 0.7), of="position"),
}


def lifted(heights, **attributes) -> rb.Scene:
    """A square of edge 2 with heights, under the sun; a camera sees a small part of its lower left quarter."""
    corners = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    bsdf = {"type": "bumpmap", "nested_texture": heights, "nested": {"type": "diffuse", "reflectance": 0.8}} | attributes
    scene = load(sensor=sensor(3, (-0.45, -0.4, 3), (-0.45, -0.4, 0), 3), sun=SUN, square={
        "type": "mesh", "vertex_positions": corners, "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]),
        "vertex_texcoords": (corners[:, :2] + 1) / 2, "bsdf": bsdf})
    scene.square.add_attribute("vertex_height", (corners[:, :2].double() @ torch.tensor(SLOPE).double())[:, None])
    return scene


def expected(scale: float) -> torch.Tensor:
    """(3,) radiance of a diffuse plane that is tilted by the scaled slope."""
    n = torch.tensor([-scale * SLOPE[0], -scale * SLOPE[1], 1.0], dtype=torch.float64)
    sun = torch.tensor([0.3, 0.4, 0.8], dtype=torch.float64)
    cosine = n @ sun / (n.norm() * sun.norm())
    return 0.8 / math.pi * cosine * torch.tensor([2.0, 3.0, 4.0], dtype=torch.float64)


@pytest.mark.parametrize("source", SOURCES)
def test_a_ramp_is_shaded_as_a_tilted_plane(source):
    scene = lifted(SOURCES[source](), scale=0.9, use_shadowing_function=False)
    image = rb.render(scene, spp=1, max_depth=2)
    torch.testing.assert_close(image, expected(0.9)[None, :, None, None].expand_as(image), rtol=1e-6, atol=0)


@pytest.mark.parametrize("source", SOURCES)
def test_the_derivative_by_the_scale_is_that_of_the_closed_form(source):
    scene = lifted(SOURCES[source](), scale=0.9, use_shadowing_function=False)
    scale = scene.get_parameter("square.bsdf.scale").requires_grad_()
    gradient, = torch.autograd.grad(rb.render(scene, spp=1, max_depth=2)[0].mean((1, 2)).sum(), scale)
    slope = (expected(0.9 + 1e-5) - expected(0.9 - 1e-5)).sum() / 2e-5
    assert abs(slope) > 0.05
    torch.testing.assert_close(gradient, slope, rtol=1e-5, atol=0)


@pytest.mark.parametrize("source", ["network of uv", "network of position"])
def test_the_parameters_of_a_network_of_heights_have_the_derivative_of_forward_mode(source):
    scene = lifted(SOURCES[source](), scale=0.9)
    name = next(name for name, _ in scene.named_parameters() if name.endswith("slopes"))
    tangent = torch.tensor([0.4, 0.7, 0.2], dtype=torch.float64)[:len(scene.get_parameter(name))]
    settings = {"spp": 2, "max_depth": 2, "seed": 0}
    forward = rb.jvp(scene, {name: tangent}, **settings)
    parameter = scene.get_parameter(name).requires_grad_()
    gradient, = torch.autograd.grad(rb.render(scene, **settings).sum(), parameter)
    assert abs(forward.sum()) > 0.05
    torch.testing.assert_close((gradient * tangent).sum(), forward.sum(), rtol=1e-9, atol=0)


def test_level_heights_change_nothing():
    plain = lifted(0.3)
    plain.square.bsdf = plain.square.bsdf.nested_bsdf
    images = [rb.render(scene, spp=4, max_depth=3) for scene in (lifted(0.3), plain)]
    assert images[1].min() > 0.1
    torch.testing.assert_close(*images, rtol=1e-12, atol=0)


def test_the_gradient_of_heights_is_that_of_blinn():
    """On triangles whose shading normals are not their own, with coordinates as they come."""
    count, generator = 500, torch.Generator().manual_seed(5)
    e1, e2, n = (Vec3.of(torch.randn(count, 3, generator=generator, dtype=torch.float64)) for _ in range(3))
    d1, d2, slope = (Vec2.of(torch.randn(count, 2, generator=generator, dtype=torch.float64)) for _ in range(3))
    n, own = normalize(n), normalize(cross(e1, e2))
    area = 1.0 / (d1.x * d2.y - d1.y * d2.x)
    dp_du, dp_dv = (e1 * d2.y - e2 * d1.y) * area, (e2 * d1.x - e1 * d2.x) * area
    lifted_u, lifted_v = (edge + n * (rise - dot(n, edge)) for edge, rise in zip((dp_du, dp_dv), slope))
    blinn = normalize(cross(lifted_u, lifted_v))
    blinn = blinn * torch.sign(dot(blinn, own))
    frame = ShadingFrame(n, dp_du)
    edges = type("Edges", (), {"barycentric_gradients": barycentric_gradients(frame, n, own, e1, e2)})
    found = along_surface(Vec2(*(slope.x * d.x + slope.y * d.y for d in (d1, d2))), edges)
    one = torch.ones_like(found.x)
    value = Vec3(one, one, one)
    ours = frame.to_world(normalize(BumpMapKind(None, True, True).normal((found, value))))
    # Mitsuba turns it to the triangle's side; where the shading normal is on the other one, that is decided by eye here.
    agreeing = dot(n, own) > 0
    assert agreeing.sum() > 200 and (found.z > 1).sum() > 20
    torch.testing.assert_close(ours.stack()[agreeing], blinn.stack()[agreeing], rtol=1e-6, atol=1e-6)


def test_heights_may_have_any_name_and_survive_a_round_trip(tmp_path):
    bumps = {"type": "bumpmap", "arbitrary": SOURCES["bitmap"](), "whatever": {"type": "plastic"}, "scale": 0.25,
             "flip_invalid_normals": False}
    scene = load(torch.float32, sensor=sensor(3, (-0.45, -0.4, 3), (-0.45, -0.4, 0), 3), sun=SUN,
                 square=rectangle((0, 0, 0), bsdf=bumps))
    rb.save(scene, tmp_path / "scene.xml")
    again = rb.load(tmp_path / "scene.xml")
    assert float(again.square.bsdf.scale) == 0.25 and not again.square.bsdf.flip_invalid_normals
    assert again.square.bsdf.nested_bsdf.type == "plastic"
    image = rb.render(scene, spp=2, max_depth=2)
    assert image.min() > 0.1
    torch.testing.assert_close(rb.render(again, spp=2, max_depth=2), image, rtol=1e-5, atol=1e-6)


def test_a_slope_of_zero_gives_the_nested_material():
    nested = material(MATERIALS["brushed metal ggx"])
    bumps = material({"type": "bumpmap", "nested_texture": 0.4, "nested_bsdf": MATERIALS["brushed metal ggx"]})
    wi, wo = directions(500, 1), directions(500, 2)
    zero = Vec3.full(wi.z, 0.0)
    values = (zero, *values_of(bumps, wi.z)[1:])
    for found, plain in zip(bumps.kind().eval_pdf(values, wi, wo), nested.kind().eval_pdf(values_of(nested, wi.z), wi, wo)):
        found, plain = (part.stack() if isinstance(part, Vec3) else part for part in (found, plain))
        assert plain.max() > 0
        torch.testing.assert_close(found, plain, rtol=1e-9, atol=1e-12)


def test_parameters_have_the_names_that_mitsuba_gives_them(mi):
    image, bumps = {"type": "bitmap", "raw": True}, {"type": "bumpmap", "nested": {"type": "diffuse"}, "scale": 0.5}
    heights = mi.TensorXf(np.ascontiguousarray(ramp(), dtype=np.float32))
    theirs = mi.traverse(mi.load_dict(bumps | {"arbitrary": image | {"data": heights}}))
    ours = load(torch.float32, sensor=sensor(2), sun=SUN, wall=rectangle(
        (0, 0, 0), bsdf=bumps | {"arbitrary": image | {"data": ramp()}}))
    names = {name.removeprefix("wall.bsdf.") for name, _ in ours.named_parameters() if name.startswith("wall.bsdf.")}
    assert names == set(theirs.keys())
