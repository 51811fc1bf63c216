"""Roughness that differs along u and v: which way it runs, how it follows what moves it, and what a colour means there."""

import math

import pytest
import torch
from torch.func import functional_call

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import assert_informative, image_and_gradients
from tests.scenes import diffuse, load, rectangle, rgb, sensor, texels
from torch_radbp.interface.texture import LUMINANCE
from torch_radbp.scene.packing.geometry import growth_of_u
from torch_radbp.scene.packing.pack import pack
from torch_radbp.tensors.vec import Frame, Vec2, Vec3, cross, dot

BRUSHED = {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.15, "alpha_v": 0.5, "eta": rgb(0.4, 1, 2), "k": 2.0}
SKY = {"type": "envmap", "bitmap": texels(5, 8, 3)}


def panel(bsdf: dict, turned: float = 0.0, **attributes) -> dict:
    """A tilted square of two triangles that fills the view, its coordinates turned by an angle and sheared."""
    vertices = torch.tensor([[-3.0, -3, 0.2], [3, -3, -0.4], [3, 3, 0.1], [-3, 3, 0.7]])
    c, s = math.cos(turned), math.sin(turned)
    coordinates = vertices[:, :2] @ torch.tensor([[c, s], [-s, c + 0.3]]) / 6
    return {"type": "mesh", "vertex_positions": vertices, "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]),
            "vertex_texcoords": coordinates, "bsdf": bsdf} | attributes


def scene_of(bsdf: dict, size: int = 2, **attributes) -> rb.Scene:
    return load(camera=sensor(size, (0.3, 0.5, 3), (0.1, -0.1, 0), 35), sky=SKY, panel=panel(bsdf, 0.4, **attributes))


@pytest.mark.parametrize("distribution", deep_but(["ggx"], ["beckmann", "ggx"]))  # whose strokes run the same way
@pytest.mark.parametrize("name", ["panel.vertex_texcoords", "panel.vertex_positions", "panel.vertex_normals"])
def test_the_brush_strokes_follow_coordinates_and_vertices(name, distribution):
    """Attached, at a fixed seed: the derivative of what is rendered."""
    normals = torch.nn.functional.normalize(torch.tensor([[0.1, -0.1, 1], [0.2, 0.05, 1], [-0.1, 0.2, 1], [0, 0.1, 1]]))
    scene = scene_of(BRUSHED | {"distribution": distribution}, vertex_normals=normals)
    renderer = rb.Renderer(scene, spp=1, max_depth=2, sampling="attached", nee=False, share_samples=True)
    value = scene.get_parameter(name).detach().clone().requires_grad_()

    def image(value):
        return functional_call(renderer, {f"scene.{name}": value}, kwargs={"seed": 2})

    rendered = image(value)
    assert_informative(rendered.detach(), list(torch.autograd.grad(rendered.sum(), value)))
    assert torch.autograd.gradcheck(image, [value], eps=1e-6, atol=1e-7, rtol=1e-5)


def test_what_does_not_follow_them_costs_nothing():
    assert pack(scene_of(BRUSHED)).triangles.along is not None
    plain = pack(scene_of({"type": "roughconductor", "alpha": 0.2}))
    assert plain.triangles.along is None and plain.triangles.vertices.uv is None
    assert not any(appearance.kind.oriented for appearance in plain.layout.appearances)


def frames(count: int = 200) -> tuple[Vec3, Vec3]:
    generator = torch.Generator().manual_seed(0)
    n, along = torch.randn(2, count, 3, generator=generator, dtype=torch.float64)
    return Vec3.of(torch.nn.functional.normalize(n, dim=-1)), Vec3.of(torch.nn.functional.normalize(along, dim=-1))


def test_the_frame_is_orthonormal_right_handed_and_as_near_to_u_as_can_be():
    n, along = frames()
    frame = Frame.along(n, along)
    basis = torch.stack([axis.stack() for axis in frame], 1)
    torch.testing.assert_close(basis @ basis.mT, torch.eye(3, dtype=torch.float64).expand_as(basis))
    torch.testing.assert_close(cross(frame.s, frame.t).stack(), n.stack())
    assert (dot(frame.s, along) > 0).all() and dot(frame.t, along).abs().max() < 1e-12


def test_where_u_does_not_tell_the_frame_is_the_one_around_the_normal():
    n, _ = frames()
    for along in (n, -n, n * 0.0):
        for one, other in zip(Frame.along(n, along), Frame.of(n)):
            torch.testing.assert_close(one.stack(), other.stack())


def test_u_grows_the_same_way_whichever_way_round_a_triangle_is_numbered():
    e1, e2 = Vec3.of(torch.tensor([[2.0, 0, 0]])), Vec3.of(torch.tensor([[0.0, 3, 0]]))
    a, b, c = (Vec2.of(torch.tensor([uv])) for uv in ([0.1, 0.2], [0.1, 0.7], [-0.4, 0.2]))
    for first, second, uv in ((e1, e2, (a, b, c)), (e2, e1, (a, c, b))):
        torch.testing.assert_close(growth_of_u(first, second, *uv).stack(), torch.tensor([[0.0, -1, 0]]))
    assert (growth_of_u(e1, e2, a, a, a).stack() == 0).all()


@pytest.mark.parametrize("material, name", [
    *(("roughconductor", name) for name in ("alpha", "alpha_u", "alpha_v")), ("roughdielectric", "alpha_v"),
    *(deep("roughdielectric", name) for name in ("alpha", "alpha_u"))])
def test_of_a_roughness_in_colour_the_mean_counts_and_of_an_image_the_luminance(material, name):
    settings = {"spp": 4, "max_depth": 3, "compile": False}
    picture = torch.tensor(texels(3, 2, 9), dtype=torch.float32)
    grey = (picture @ torch.tensor(LUMINANCE))[..., None].expand(-1, -1, 3)
    for coloured, plain, weights, texels_of in (
            ({"type": "bitmap", "data": picture}, {"type": "bitmap", "data": grey}, torch.tensor(LUMINANCE), "data"),
            (rgb(0.1, 0.3, 0.8), 0.4, torch.full((3,), 1 / 3), "value")):
        other = {} if name == "alpha" else {"alpha_u": 0.3, "alpha_v": 0.4}
        images, gradients = zip(*(
            image_and_gradients(scene_of({"type": material, "distribution": "ggx"} | other | {name: alpha}, 4),
                                [f"panel.bsdf.{name}.{texels_of}"], **settings) for alpha in (coloured, plain)))
        assert_informative(images[0], [gradients[0][0]])
        torch.testing.assert_close(images[0], images[1], rtol=1e-5, atol=1e-7)  # loading rounds to float32
        torch.testing.assert_close(gradients[0][0], gradients[0][0].sum(-1, keepdim=True) * weights.double(), rtol=1e-6,
                                   atol=1e-12)
        whole = [gradient.sum(-1) if gradient.ndim else gradient for gradient, in gradients]
        torch.testing.assert_close(*whole, rtol=1e-3, atol=1e-6)


def test_a_view_of_a_roughness_sees_a_texture_that_is_put_in_its_place():
    scene = load(camera=sensor(4), sky=SKY, panel=rectangle((0, 0, 0), 2, bsdf={"type": "roughconductor", "alpha": 0.1}),
                 other=rectangle((0, 0, 9), bsdf=diffuse(0.5)))
    before = rb.render(scene, spp=2, max_depth=2)
    scene.panel.bsdf.alpha = rb.load_dict({"type": "scene", "camera": sensor(2), "sky": SKY, "panel": rectangle(
        (0, 0, 0), bsdf={"type": "roughconductor", "alpha": 0.5})}).double().panel.bsdf.alpha
    after = rb.render(scene, spp=2, max_depth=2)
    assert (before - after).abs().max() > 0.01
