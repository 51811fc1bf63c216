"""Derivatives of quantities, backward and forward: against finite differences of the same samples, and unbiased."""

import pytest
import torch
from torch.autograd import forward_ad
from torch.func import functional_call

import torch_radbp as rb
from tests.gradients import unwarned_renderer, z_score
from tests.scenes import load, rectangle, sensor, texels
from tests.scenes.aovs import NETWORK_FREE, landscape
from torch_radbp.rendering.jvp import render_with_tangents

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
SETTINGS = {"spp": 2, "max_depth": 1, "terms": ["interior"], "share_samples": True}
SLOPE, EXTENT = 0.5, 1000.0
MIXED = 2  # directions in which a parameter is moved
FILM = {"type": "hdrfilm", "width": 2, "height": 512, "rfilter": {"type": "box"}}
# What has to have a derivative with respect to what; everything else has to be zero, or close to it by rounding.
FOLLOWS = {
    "hills.vertex_positions": {"depth", "position", "uv", "geo_normal", "sh_normal", "dp_du", "dp_dv", "albedo"},
    "hills.vertex_normals": {"sh_normal"},
    "hills.to_world": {"depth", "position", "uv", "geo_normal", "sh_normal", "dp_du", "dp_dv", "albedo"},
    "sensor.to_world": {"depth", "position", "uv", "sh_normal", "albedo"},
    "sensor.x_fov": {"depth", "position", "uv", "sh_normal", "albedo"},
    "hills.vertex_texcoords": {"uv", "dp_du", "dp_dv", "albedo"},
    "hills.bsdf.reflectance.data": {"albedo"},
}


class Quantities(torch.nn.Module):
    """Quantities without the image, for `functional_call`."""

    def __init__(self, scene, names):
        super().__init__()
        self.renderer, self.names = rb.Renderer(scene, **SETTINGS), names

    def forward(self):
        found = self.renderer.aovs(self.names, seed=3)
        return tuple(found[name] for name in self.names)


def images(scene, names, parameter):
    """The quantities as a function of one parameter."""
    module = Quantities(scene, names)
    return lambda value: functional_call(module, {f"renderer.scene.{parameter}": value})


def weighted(of):
    """One number of each quantity: a sum over its pixels with fixed weights, so that a Jacobian has few rows."""
    def sums(value):
        generator = torch.Generator().manual_seed(5)
        return tuple((torch.rand(image.shape, dtype=image.dtype, generator=generator) * image).sum() for image in of(value))

    return sums


def gradcheck(of, value, atol=2e-5):
    """Both modes against finite differences, along directions that each mix all entries: a wrong one shows in each."""
    base = value.detach()
    mixed = torch.randn(min(MIXED, base.numel()), *base.shape, dtype=base.dtype, generator=torch.Generator().manual_seed(6))
    steps = torch.zeros(len(mixed), dtype=base.dtype, requires_grad=True)
    return torch.autograd.gradcheck(weighted(lambda step: of(base + torch.tensordot(step, mixed, 1))), steps, eps=1e-6,
                                    atol=atol, rtol=1e-5, check_forward_ad=True, check_undefined_grad=False)


@pytest.mark.parametrize("parameter", FOLLOWS)
def test_gradcheck_backward_and_forward(parameter):
    scene = landscape(size=3)
    value = dict(scene.named_parameters())[parameter].detach().clone().requires_grad_()
    follows = images(scene, tuple(name for name in NETWORK_FREE if name in FOLLOWS[parameter]), parameter)
    for image, name in zip(follows(value), FOLLOWS[parameter]):
        (gradient,) = torch.autograd.grad(image.square().sum(), value, retain_graph=True)
        assert torch.isfinite(gradient).all() and gradient.abs().max() > 1e-6, name
    assert gradcheck(follows, value)


@pytest.mark.parametrize("parameter", FOLLOWS)
def test_what_does_not_follow_has_no_derivative(parameter):
    scene = landscape(size=3)
    value = dict(scene.named_parameters())[parameter].detach().clone().requires_grad_()
    others = tuple(name for name in NETWORK_FREE if name not in FOLLOWS[parameter])
    for name, image in zip(others, images(scene, others, parameter)(value) if others else ()):
        if image.requires_grad:
            (gradient,) = torch.autograd.grad(image.square().sum(), value, retain_graph=True, allow_unused=True)
            assert gradient is None or gradient.abs().max() < 1e-9, name


def test_beside_rough_glass_whose_paths_are_followed_too():
    """Paths then carry one thing more, in the quantities' loop as in the image's."""
    wall = {"type": "diffuse", "reflectance": {"type": "bitmap", "bitmap": texels(4, 5), "raw": True}}
    scene = load(sensor=sensor(4), sky={"type": "constant"}, wall=rectangle((0, 0, -1), 4, bsdf=wall),
                 pane=rectangle((0, 0, 0), 0.4, bsdf={"type": "roughdielectric", "alpha": 0.2}))
    names = ["depth", "albedo"]
    pose = scene.sensor.to_world.detach().clone().requires_grad_()
    of = images(scene, names, "sensor.to_world")
    assert all(values.isfinite().all() and values.max() > 0 for values in of(pose))
    assert gradcheck(of, pose)


def test_normal_maps_turn_the_normals_and_have_derivatives():
    maps = {"type": "normalmap", "normalmap": {"type": "bitmap", "raw": True, "data": 0.3 + 0.4 * texels(2, 3)},
            "b": {"type": "diffuse", "reflectance": 0.4}}
    scene = landscape(maps, size=3)
    plain = rb.Renderer(landscape(size=3), **SETTINGS).aovs(["sh_normal"])["sh_normal"]
    turned = rb.Renderer(scene, **SETTINGS).aovs(["sh_normal"])["sh_normal"]
    assert (turned - plain).abs().max() > 0.1
    name = "hills.bsdf.normalmap.data"
    value = scene.get_parameter(name).detach().clone().requires_grad_()
    of = images(scene, ("sh_normal",), name)
    assert torch.autograd.grad(of(value)[0].sum(), value)[0].abs().max() > 1e-3
    assert gradcheck(of, value)


def test_a_network_as_colour_has_the_gradient_of_its_albedo():
    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Linear(2, 8), torch.nn.Tanh(), torch.nn.Linear(8, 3), torch.nn.Sigmoid()).double()
    scene = landscape({"type": "diffuse", "reflectance": network}, size=3)
    name = "hills.bsdf.reflectance.module.0.weight"
    value = scene.get_parameter(name).detach().clone().requires_grad_()
    scene.requires_grad_(False)  # derivatives are taken backward or forward, not both at once
    of = images(scene, ("albedo",), name)
    assert torch.autograd.grad(of(value)[0].sum(), value)[0].abs().max() > 1e-4
    assert gradcheck(of, value)
    # It also follows the point at which the network is read.
    parameter = "sensor.to_world"
    pose = scene.get_parameter(parameter).detach().clone().requires_grad_()
    assert gradcheck(images(scene, ("albedo",), parameter), pose)


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_gradients_do_not_depend_on_the_chunk(chunk):
    scene = landscape(size=4)
    vertices = scene.get_parameter("hills.vertex_positions").requires_grad_()
    found = rb.Renderer(scene, spp=4, chunk=chunk).aovs(NETWORK_FREE)
    expected = rb.Renderer(scene, spp=4).aovs(NETWORK_FREE)
    for name in NETWORK_FREE:
        torch.testing.assert_close(found[name], expected[name], rtol=1e-13, atol=1e-13)
    loss, other = (sum(image.square().mean() for image in images.values()) for images in (found, expected))
    gradient, wanted = torch.autograd.grad(loss, vertices)[0], torch.autograd.grad(other, vertices)[0]
    assert wanted.abs().max() > 1e-3
    torch.testing.assert_close(gradient, wanted, rtol=1e-10, atol=1e-12)


def test_jvp_of_torch_and_dual_tensors_agree_with_the_backward_pass():
    scene = landscape(size=3)
    name = "hills.vertex_positions"
    value = scene.get_parameter(name).detach().clone()
    tangent = torch.randn(value.shape, dtype=value.dtype, generator=torch.Generator().manual_seed(1))
    of, renderer = images(scene, ("depth", "sh_normal"), name), rb.Renderer(scene, **SETTINGS)

    def with_image(value):
        arguments = {"seed": 3, "aovs": ("depth", "sh_normal")}
        return functional_call(renderer, {f"scene.{name}": value}, kwargs=arguments)

    _, (_, forward) = torch.func.jvp(with_image, (value,), (tangent,))
    forward = tuple(forward.values())
    with forward_ad.dual_level(), torch.no_grad():
        dual = [forward_ad.unpack_dual(image).tangent for image in of(forward_ad.make_dual(value, tangent))]
    leaf = value.clone().requires_grad_()
    for image, one, other in zip(of(leaf), forward, dual):
        weights = torch.randn(image.shape, dtype=image.dtype, generator=torch.Generator().manual_seed(2))
        (gradient,) = torch.autograd.grad(image, leaf, weights, retain_graph=True)
        assert one.abs().max() > 0.01
        torch.testing.assert_close((gradient * tangent).sum(), (weights * one).sum(), rtol=1e-10, atol=1e-12)
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-14)


def test_what_has_no_derivative_carries_none():
    scene = landscape(size=3)
    scene.get_parameter("hills.bsdf.reflectance.data").requires_grad_()
    found = rb.Renderer(scene, spp=2, max_depth=2).aovs(["xyz", "alpha", "shape_index", "albedo"])
    assert found["albedo"].requires_grad and found["xyz"].max() > 0
    (gradient,) = torch.autograd.grad(found["xyz"].sum() + found["albedo"].sum() * 0, scene.get_parameter(
        "hills.bsdf.reflectance.data"))
    assert (gradient == 0).all()


def test_gradients_in_float32_lose_nothing_when_many_lanes_read_an_entry():
    """Sums in float32 are off by 4e-6 here, and by more where more lanes read an entry; sums in float64 by 3e-8."""
    gradients = []
    for dtype in (torch.float64, torch.float32):
        scene = landscape(dtype=dtype, size=64)
        wanted = [scene.get_parameter(name).requires_grad_() for name in ("hills.bsdf.reflectance.data",
                                                                          "hills.vertex_positions")]
        found = rb.Renderer(scene, spp=64, chunk=1 << 18).aovs(["albedo", "depth"], seed=2)
        loss = found["albedo"].sum() + found["depth"].square().sum()
        gradients.append([gradient.double() for gradient in torch.autograd.grad(loss, wanted)])
    for found, wanted in zip(gradients[1], gradients[0]):
        assert torch.isfinite(wanted).all() and wanted.abs().max() > 1
        assert (found - wanted).abs().max() < 3e-7 * wanted.abs().max()


def slope():
    """A plane z = x / 2 seen along -z from z = 2, on pixels of width 1 beside x = 0: depth beyond the near plane 1 - z."""
    tilt = torch.diag(torch.tensor([EXTENT, EXTENT, 1.0, 1.0], dtype=torch.float64))
    tilt[2, 0] = EXTENT * SLOPE
    return load(camera={"type": "orthographic", "near_clip": 1.0, "far_clip": 10.0, "film": FILM,
                        "to_world": rb.look_at((0, 0, 2), (0, 0, 0), (0, 1, 0))},
                plane={"type": "rectangle", "to_world": tilt.numpy()}, sky={"type": "constant"})


def gradients_of_a_squared_depth(runs=12, **settings):
    """By the slope, of the mean square of depth - 1, at one sample a pixel, for several seeds."""
    scene = slope()
    pose = scene.get_parameter("plane.to_world").requires_grad_()
    renderer = unwarned_renderer(scene, spp=1, terms=["interior"], **settings)
    depths = (renderer.aovs(["depth"], seed=seed)["depth"] for seed in range(runs))
    return torch.stack([EXTENT * torch.autograd.grad(((depth - 1) ** 2).mean(), pose)[0][2, 0] for depth in depths])


def test_the_gradient_of_a_squared_depth_is_unbiased_and_with_shared_samples_it_is_not():
    """Of a pixel at x the mean depth is 1 - s x; over its width, x has the variance 1/12, which the noise adds."""
    expected = torch.tensor(2 * SLOPE * 0.5**2, dtype=torch.float64)
    assert z_score(gradients_of_a_squared_depth()[:, None], expected[None]) < 4.5  # t with 11 degrees of freedom
    shared = gradients_of_a_squared_depth(share_samples=True)[:, None]
    assert z_score(shared, expected[None]) > 10
    assert z_score(shared, expected[None] + 2 * SLOPE / 12) < 4.5


def test_the_derivative_has_the_samples_of_its_seed():
    scene, name = landscape(size=3), "hills.to_world"
    value = scene.get_parameter(name).detach().clone()
    tangent = torch.randn(value.shape, dtype=value.dtype, generator=torch.Generator().manual_seed(1))
    renderer = rb.Renderer(scene, **SETTINGS | {"share_samples": False})
    pose = scene.get_parameter(name).requires_grad_()
    names = ["depth", "sh_normal", "prim_index"]

    def found(seed, seed_grad):
        images = renderer.aovs(names, seed=seed, seed_grad=seed_grad)
        return images, torch.autograd.grad(sum(images[quantity].square().sum() for quantity in names[:2]), pose)[0]

    (one, first), (other, second), (_, third) = found(3, 3), found(3, 9), found(9, 9)
    for quantity in names:  # the one is eager, the other compiled
        torch.testing.assert_close(one[quantity], other[quantity], rtol=1e-13, atol=1e-13)
    assert (first - second).abs().max() > 1e-3 * first.abs().max() and (third - second).abs().max() > 1e-3
    assert not other["prim_index"].requires_grad
    pose.requires_grad_(False)
    forward = render_with_tangents(renderer, {name: tangent}, {"seed": 3, "seed_grad": 9, "aovs": names})[1]
    for quantity in names[:2]:
        torch.testing.assert_close(forward[quantity].image, one[quantity].detach(), rtol=1e-13, atol=1e-13)
    inner = sum((2 * one[quantity] * forward[quantity].tangent).sum() for quantity in names[:2])
    torch.testing.assert_close((second * tangent).sum(), inner.detach(), rtol=1e-10, atol=1e-12)
