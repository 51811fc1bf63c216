"""Values and derivatives stay finite where formulas divide by zero: at a light, on its axis, at the poles, in the dark."""

import math

import pytest
import torch

import torch_radbp as rb
from tests.gradients import cotangent
from tests.scenes import load, look_at, sensor
from tests.scenes.lights import EMITTERS, FLOOR, sky_image
from torch_radbp.connection.light import LightNumbers, sample_light
from torch_radbp.emitter.envmap import EnvmapKind, density
from torch_radbp.emitter.latitude_longitude import latitude_longitude
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.packing.pack import pack
from torch_radbp.scene.tables.triangle_corners import at_corners, edges
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.vertex.emission import emitted, emitted_pdf
from torch_radbp.vertex.interaction import surface_interaction

DTYPES = [torch.float32, torch.float64]
AXES = [[0, 1, 0], [0, -1, 0], [0, 0, -1], [0, 0, 1], [1, 0, 0], [1e-20, 1, 0], [1e-7, -1, 1e-7], [1e-4, 1, 0],
        [-1e-12, 0, -1]]


def everything(scene: rb.Scene) -> list[torch.Tensor]:
    """All parameters of the emitters, which then require grad."""
    return [p.requires_grad_() for n, p in scene.named_parameters() if "lamp" in n and "bsdf" not in n]


def assert_finite(outputs, inputs) -> None:
    outputs = [out for out in outputs if out.requires_grad]
    gradients = torch.autograd.grad(outputs, inputs, [torch.ones_like(out) for out in outputs], retain_graph=True,
                                    allow_unused=True)
    for value in (*outputs, *(gradient for gradient in gradients if gradient is not None)):
        assert torch.isfinite(value).all()


def at_and_around(place: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Points at a light, at all distances from it, along its axis and across."""
    across = torch.linalg.cross(axis, axis.roll(1))
    distances = [0.0, 1e-30, 1e-20, 1e-12, 1e-7, 1e-6, 1e-3, 1.0, 1e6]
    return torch.stack([place + r * d for r in distances for d in (axis, -axis, across, axis + 1e-6 * across)])


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("name", EMITTERS)
def test_light_samples_are_finite_wherever_the_light_is_seen_from(name, dtype):
    scene = load(dtype, sensor=sensor(2), **FLOOR, **EMITTERS[name])
    inputs = everything(scene)
    tensors = pack(scene)
    pose = next((p for n, p in scene.named_parameters() if n.endswith("lamp.to_world")), None)
    place = scene.get_parameter("lamp.position") if pose is None and name == "point" else (
        torch.zeros(3, dtype=dtype) if pose is None else pose[:3, 3])
    axis = torch.tensor([0.0, 0, 1], dtype=dtype) if pose is None else torch.nn.functional.normalize(pose[:3, 2], dim=0)
    points = at_and_around(place.detach(), axis.detach())
    for u in (0.0, 0.3, 0.5, 1 - 2.0**-24):
        for v in (0.0, 0.7, 1 - 2.0**-24):
            p = points.clone().requires_grad_()
            choice = torch.linspace(-(1 << 31), (1 << 31) - 1, len(p), dtype=torch.float64).to(torch.int32)
            u_bits, v_bits = (torch.full_like(choice, int((number - 0.5) * 2**32)) for number in (u, v))
            light = sample_light(tensors, tensors, Vec3.of(p), LightNumbers(choice, choice, u_bits, v_bits))
            # What a surface makes of it.
            usable = light.pdf > 1e-30
            Ld = light.radiance * (usable / torch.where(usable, light.pdf, 1.0))
            assert_finite((*light.d, *light.radiance, light.pdf, *light.target, *Ld), [p, *inputs])


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_the_environment_is_finite_along_every_axis(dtype):
    scene = load(dtype, sensor=sensor(2), **FLOOR, lamp={"type": "envmap", "bitmap": sky_image()})
    inputs = everything(scene)
    tensors = pack(scene)
    d = torch.tensor(AXES, dtype=dtype, requires_grad=True)
    table, = tensors.lights.tables
    radiance, pdf = EnvmapKind().radiance(table, Vec3.of(d)), density(table, Vec3.of(d))
    uv = latitude_longitude(Vec3.of(d))
    assert_finite((*radiance, pdf, *uv), [d, *inputs])


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_an_emitter_seen_edge_on_or_from_itself_is_finite(dtype):
    scene = load(dtype, sensor=sensor(2), **FLOOR, **EMITTERS["area"])
    inputs = everything(scene)
    tensors = pack(scene)
    prim = torch.full((4,), 3, dtype=torch.int32)
    hit = Hit(prim, *(torch.full((4,), 0.25, dtype=dtype) for _ in range(3)))
    corners = tuple(corner[prim.long()] for corner in tensors.triangles.corners)
    p0, edge, other = (part.stack()[0].detach() for part in edges(*at_corners(tensors.triangles.vertices.p, corners)))
    point = p0 + 0.25 * edge + 0.25 * other
    o = torch.stack([point, point + edge, point + 1e-20 * edge, point - 1e-7 * edge]).requires_grad_()
    d = torch.nn.functional.normalize(edge, dim=0).expand(4, 3).clone().requires_grad_()
    ray = Ray(Vec3.of(o), Vec3.of(d))
    si = surface_interaction(tensors, ray, hit)
    assert_finite((*emitted(tensors, ray, si), emitted_pdf(tensors, ray, si)), [o, d, *inputs])


DARK = {
    "black map": {"type": "envmap", "bitmap": sky_image() * 0},
    "black by scale": {"type": "envmap", "bitmap": sky_image(), "scale": 0.0},
    "black projector": {"type": "projector", "irradiance": {"type": "bitmap", "data": sky_image() * 0}},
    "projector of scale 0": {"type": "projector", "scale": 0.0},
    "spot of no intensity": {"type": "spot", "intensity": 0.0, "cutoff_angle": 120.0, "beam_width": 0.0},
}


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("emitter", DARK.values(), ids=DARK)
def test_lights_that_are_off_have_derivatives(emitter, dtype):
    """What can turn them on: a derivative that is finite and, for texels and colours, not zero."""
    scene = load(dtype, sensor=sensor(8, (0, 0.5, 3.5), (0, 0, 0), 45), **FLOOR, lamp={"to_world": pose(), **emitter})
    name = next(n for n, _ in scene.named_parameters() if n in ("lamp.data", "lamp.irradiance.data", "lamp.intensity.value",
                                                                "lamp.irradiance.value"))
    parameter = scene.get_parameter(name).requires_grad_()
    image = rb.render(scene, spp=16, max_depth=3, rr_depth=100)
    gradient, = torch.autograd.grad(image, parameter, cotangent(image.detach()))
    assert image.max() == 0 and torch.isfinite(gradient).all()
    if "scale" not in emitter:
        assert gradient.abs().max() > 0


def pose():
    return look_at((0.4, 1.6, 0.5), (0, -0.6, 0), (0, 0, 1))


def test_black_texels_have_the_right_derivative():
    """Next-event estimation never picks a black part of the map; BSDF sampling finds it, with full weight.

    The image is linear in the texels: its derivative by one of them is the image of that texel alone.
    """
    image = sky_image()
    black = (image == 0).all(-1)
    assert black.any()
    scene = load(sensor=sensor(8, (0, 0.5, 3.5), (0, 0, 0), 45), **FLOOR, lamp={"type": "envmap", "bitmap": image})
    data = scene.get_parameter("lamp.data").requires_grad_()
    samples = []
    for seed in range(16):
        picture = rb.render(scene, spp=64, max_depth=3, seed=seed, rr_depth=100)
        samples.append(torch.autograd.grad(picture.mean(), data)[0])
    with torch.no_grad():
        data.copy_(torch.from_numpy(black * 1.0)[..., None])
    alone = torch.stack([rb.render(scene, spp=64, max_depth=3, seed=seed, rr_depth=100).detach().mean()
                         for seed in range(100, 116)])
    found = torch.stack(samples)[:, torch.from_numpy(black)].sum((1, 2))
    error = math.hypot(found.std() / 4, alone.std() / 4)
    assert alone.mean() > 20 * error and abs(found.mean() - alone.mean()) < 4 * error
