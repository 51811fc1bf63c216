"""Radiance along rays that are given: its values and its derivatives, by the scene, by origins and by directions."""

from __future__ import annotations

import math
import warnings

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.deep import deep
from tests.derivatives.frozen import Decisions, HeldCaster
from tests.gradients import assert_informative, cotangent, relative_error, unwarned_renderer
from tests.jit.emulated import Emulated
from tests.rendering.on_gpu import render_on
from tests.scenes import cornell, diffuse, furnace, load, rectangle, rgb, sensor
from torch_radbp.adjoint.attached import bounce_attached
from torch_radbp.adjoint.images import render_images
from torch_radbp.call.view import OF_NO_SENSOR, Shot
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.packing.pack import pack
from torch_radbp.sensor.rays import given_rays
from torch_radbp.tensors.vec import Vec2

quiet = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
HEIGHT, EDGE, ALBEDO, GLOW = 1.0, 0.1, 0.7, 3.0  # of the lamp above the floor, of the screen below it, and of light


def some_rays(count: int = 5, seed: int = 0, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor]:
    """Rays from about (0, 0, 3.5) into the room of `cornell`."""
    generator = torch.Generator().manual_seed(seed)
    origins, directions = (torch.randn(count, 3, generator=generator, dtype=torch.float64) for _ in range(2))
    origins = 0.1 * origins + torch.tensor([0.0, 0.0, 3.5], dtype=torch.float64)
    directions = 0.5 * directions * torch.tensor([0.25, 0.25, 0.0]) - torch.tensor([0.0, 0.0, 1.3])
    return origins.to(dtype), directions.to(dtype)


def test_radiance_in_a_furnace_is_the_closed_form():
    """Exactly, along every ray, at one sample: L = Le sum rho^k; and its derivative by the reflectance."""
    scene = furnace()
    albedo = scene.get_parameter("walls.bsdf.reflectance.value").requires_grad_()
    origins, directions = some_rays(7)
    renderer = rb.Renderer(scene, spp=1, max_depth=6, rr_depth=100, nee=False)
    radiance = renderer.radiance(0.1 * directions, directions - origins)
    rho, emission = torch.tensor([0.3, 0.6, 0.9]).double().requires_grad_(), torch.tensor([1.0, 0.5, 0.25]).double()
    expected = emission * sum(rho**k for k in range(6))
    torch.testing.assert_close(radiance, expected.detach().expand(7, 3), rtol=1e-6, atol=0)
    found, = torch.autograd.grad(radiance.sum(), albedo)
    torch.testing.assert_close(found, 7 * torch.autograd.grad(expected.sum(), rho)[0], rtol=1e-6, atol=0)


def test_what_meets_nothing_sees_the_surroundings_and_what_meets_a_lamp_its_light():
    scene = load(sensor=sensor(), sky={"type": "constant", "radiance": rgb(0.2, 0.3, 0.4)},
                 lamp=rectangle((0, 0, 0), emitter={"type": "area", "radiance": rgb(3, 2, 1)}))
    origins = torch.tensor([[0, 0, 2], [0, 0, 2], [5, 0, 2.0]])
    directions = torch.tensor([[0, 0, -1], [0, 0, 1], [0, 0, -1e-20]])  # of any length
    radiance = rb.Renderer(scene, spp=3, max_depth=2).radiance(origins, directions)
    expected = torch.tensor([[3, 2, 1], [0.2, 0.3, 0.4], [0.2, 0.3, 0.4]], dtype=torch.float64)
    torch.testing.assert_close(radiance, expected, rtol=1e-7, atol=0)


@pytest.mark.parametrize("kind", ["perspective", "orthographic", "thinlens"])
def test_a_camera_s_image_is_the_mean_of_radiance_along_its_rays(kind):
    """In the mean over places in a pixel: random ones, in one pixel all that are traced."""
    lens = {"aperture_radius": 0.1, "focus_distance": 3.0} if kind == "thinlens" else {}
    view = sensor(4, **lens) | {"type": kind}
    if kind == "orthographic":
        del view["fov"]
    scene = cornell(sensors={"view": view})
    renderer, count = rb.Renderer(scene, spp=256, max_depth=4), 512
    image = torch.stack([renderer(seed=seed)[0].flatten(1).t() for seed in range(4)])
    generator = torch.Generator().manual_seed(5)
    places, apertures = (Vec2(*torch.rand(2, 16 * count, generator=generator, dtype=torch.float64)) for _ in range(2))
    pixel = torch.arange(16, dtype=torch.int32).repeat_interleave(count)
    camera = scene.sensors[0].tensors()
    ray, _ = camera.sample_ray(pixel % 4, pixel // 4, places, apertures if lens else None)
    radiance = renderer.radiance(ray.o.stack(), ray.d.stack(), seed=9, spp=1).view(16, count, 3)
    error = (radiance.var(1) / count + image.var(0) / 4).sqrt()
    z = (radiance.mean(1) - image.mean(0)) / error
    assert image.mean() > 0.05 and z.abs().max() < 4.5 and 0.5 < z.std() < 1.4


def corner(x: Tensor, y: Tensor, height: float) -> Tensor:
    """The form factor of a point to a rectangle parallel to its surface, one of whose corners lies right above it.

    Reference: Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", B-3.
    """
    x, y = x / height, y / height
    a, b = torch.sqrt(1 + x * x), torch.sqrt(1 + y * y)
    return (x / a * torch.atan(y / a) + y / b * torch.atan(x / b)) / (2 * math.pi)


def form_factor(x: tuple[Tensor, Tensor], y: tuple[Tensor, Tensor], height: float) -> Tensor:
    """That to a rectangle between two x and two y, counted from the point."""
    return sum(sign * corner(at, beside, height)
               for at, beside, sign in ((x[1], y[1], 1), (x[0], y[1], -1), (x[1], y[0], -1), (x[0], y[0], 1)))


def lit_floor(screen: bool) -> rb.Scene:
    """A floor under a lamp of 1 x 1, half of which a screen hides, that ends at x = `EDGE`."""
    hidden = {"screen": rectangle((EDGE - 2, HEIGHT / 2, 0), 2.0, angle=90, bsdf=diffuse(0))} if screen else {}
    return load(sensor=sensor(), floor=rectangle((0, 0, 0), 3.0, angle=-90, bsdf=diffuse(ALBEDO)), **hidden, lamp=rectangle(
        (0, HEIGHT, 0), 0.5, angle=90, bsdf=diffuse(0), emitter={"type": "area", "radiance": rgb(GLOW, GLOW, GLOW)}))


def light_of_floor(x: Tensor, z: Tensor, edge: Tensor | None) -> Tensor:
    """What the floor reflects at points, in closed form."""
    left = -0.5 - x if edge is None else torch.maximum(-0.5 - x, 2 * (edge - x))
    return GLOW * ALBEDO * form_factor((left, 0.5 - x), (-0.5 - z, 0.5 - z), HEIGHT)


X, Z = torch.tensor([[-0.2, 0.05, 0.3], [0.1, -0.1, 0.0]], dtype=torch.float64)
DOWN = torch.tensor([[0.0, -1.0, 0.0]], dtype=torch.float64).expand(3, 3)


def test_irradiance_under_a_lamp_is_the_closed_form():
    """The mean over directions, spread evenly over a disk below the hemisphere, times pi."""
    scene, count = lit_floor(screen=False), 160
    place = (torch.arange(count, dtype=torch.float64) + 0.5) / count * 2 - 1
    across, along = (part.flatten() for part in torch.meshgrid(place, place, indexing="ij"))
    inside = across**2 + along**2 < 1
    across, along = across[inside], along[inside]
    d = torch.stack([across, torch.sqrt(1 - across**2 - along**2), along], 1)
    for x, z in zip(X, Z):
        origin = torch.stack([x, torch.tensor(1e-4).double(), z])
        found = math.pi * rb.Renderer(scene, spp=1, max_depth=1).radiance(origin.expand_as(d), d).mean()
        expected = math.pi * light_of_floor(x, z, None) / ALBEDO
        assert expected > 0.5 and float(found) == pytest.approx(float(expected), rel=4e-3)


@pytest.mark.parametrize("screen", [False, True], ids=["in full light", "in a soft shadow"])
def test_light_on_a_floor_and_its_slopes_are_the_closed_form(screen):
    """By the place that a ray meets, and by the edge of what casts a soft shadow."""
    scene = lit_floor(screen)
    pose = scene.get_parameter("screen.to_world").requires_grad_() if screen else None
    origins = torch.stack([X, torch.full_like(X, 0.25), Z], 1).requires_grad_()
    renderer, found = rb.Renderer(scene, spp=1024, max_depth=2), []
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is left out
        for seed in range(16):
            light = renderer.radiance(origins, DOWN, seed=seed)[:, 0]
            slopes = torch.autograd.grad(light.sum(), [origins, pose] if screen else [origins])
            found.append(torch.cat([light.detach(), slopes[0][:, 0], *(slope[:1, 3] for slope in slopes[1:])]))
    x, edge = X.clone().requires_grad_(), torch.tensor(EDGE, dtype=torch.float64, requires_grad=True)
    light = light_of_floor(x, Z, edge if screen else None)
    slopes = torch.autograd.grad(light.sum(), [x, edge] if screen else [x])
    expected = torch.cat([light.detach(), slopes[0], *(slope[None] for slope in slopes[1:])])
    assert_informative(light, list(slopes))
    found = torch.stack(found)
    error = found.std(0) / 4
    assert (error < 0.05 * expected.abs() + 0.02).all()
    assert ((found.mean(0) - expected).abs() < 4 * error + 1e-6).all()


PARAMETERS = ("white.reflectance.value", "light.emitter.radiance.value", "box.to_world", "light.to_world")


@quiet
@pytest.mark.parametrize("share, sampling", [(False, "hybrid"), (True, "attached"), deep(False, "attached"),
                                             deep(True, "hybrid")])
def test_strategies_and_plain_autograd_agree(share, sampling):
    """Derivatives by the scene, by origins and by directions; shadows included."""
    scene = cornell()
    wanted = [scene.get_parameter(name).requires_grad_() for name in PARAMETERS]
    origins, directions = (part.requires_grad_() for part in some_rays())
    settings = {"spp": 6, "max_depth": 3, "share_samples": share, "sampling": sampling}

    def rendered(adjoint: rb.AdjointStrategy) -> tuple[Tensor, tuple[Tensor, ...]]:
        radiance = unwarned_renderer(scene, adjoint=adjoint, **settings).radiance(origins, directions, seed=4)
        w = cotangent(radiance.detach())
        return radiance.detach(), torch.autograd.grad(radiance, [origins, directions, *wanted], w)

    expected, gradients = rendered(rb.TapeAdjoint())
    assert_informative(expected, gradients)
    for adjoint in (rb.MemoizedAdjoint(), rb.MemoizedAdjoint(stride=2, keep_hits=False), rb.QuadraticAdjoint()):
        found, others = rendered(adjoint)
        torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-13)
        for gradient, reference in zip(others, gradients):
            assert relative_error(gradient, reference) < 1e-9


@quiet
def test_compiled_and_eager_agree_however_rays_are_divided():
    scene, rays = cornell(), some_rays(50)
    expected = rb.Renderer(scene, spp=6, max_depth=4, compile=False).radiance(*rays, seed=1)
    assert expected.std() > 0.01
    found = [rb.Renderer(scene, spp=6, max_depth=4, chunk=chunk).radiance(*rays, seed=1) for chunk in (None, 7, 64)]
    torch.testing.assert_close(found[0], expected, rtol=1e-10, atol=1e-13)
    assert all(torch.equal(found[0], other) for other in found)
    budget = rb.Renderer(scene, spp=6, max_depth=4, memory_budget="64MiB").radiance(*rays, seed=1)
    assert torch.equal(budget, found[0])


@quiet
def test_the_kernels_of_a_gpu_find_the_same(monkeypatch):
    """By the emulation of `tests/rendering/test_gpu.py`."""
    scene, results = cornell(), []
    render_on(Gpu(Emulated()), monkeypatch)
    for compile in (False, True):
        rays = [part.requires_grad_() for part in some_rays()]
        radiance = unwarned_renderer(scene, spp=4, max_depth=3, compile=compile).radiance(*rays, seed=1)
        results.append([radiance.detach(), *torch.autograd.grad(radiance, rays, cotangent(radiance.detach()))])
    assert_informative(results[0][0], results[0][1:])
    for found, expected in zip(results[1], results[0]):
        assert relative_error(found, expected) < 1e-10


@quiet
def test_forward_mode_is_the_transpose_of_backward_mode():
    scene = cornell()
    rays = some_rays()
    tangents = {name: cotangent(scene.get_parameter(name).detach(), 3) for name in PARAMETERS}
    tangents["box.to_world"][3] = tangents["light.to_world"][3] = 0
    settings = {"spp": 4, "max_depth": 3}
    image = rb.jvp(scene, tangents, rays=rays, seed=4, **settings)
    w, moves = cotangent(image), [cotangent(part, seed) for seed, part in enumerate(rays)]
    renderer = rb.Renderer(scene, **settings)
    value, along = torch.func.jvp(lambda o, d: renderer.radiance(o, d, seed=4), rays, tuple(moves))
    torch.testing.assert_close(value, renderer.radiance(*rays, seed=4))
    wanted = [scene.get_parameter(name).requires_grad_() for name in PARAMETERS]
    rays = [part.requires_grad_() for part in rays]
    gradients = torch.autograd.grad(renderer.radiance(*rays, seed=4), [*wanted, *rays], w)
    assert_informative(image, gradients)
    by_scene = sum(float((gradient * tangent).sum()) for gradient, tangent in zip(gradients, tangents.values()))
    by_rays = sum(float((gradient * tangent).sum()) for gradient, tangent in zip(gradients[len(wanted):], moves))
    assert float((image * w).sum()) == pytest.approx(by_scene, rel=1e-9)
    assert float((along * w).sum()) == pytest.approx(by_rays, rel=1e-9)


@pytest.mark.parametrize("sampling", [deep("attached"), "hybrid"])
def test_gradcheck_by_origins_and_directions(sampling):
    """Of radiance at one seed, attached; with proposal and hits held otherwise, see `tests/derivatives/frozen.py`."""
    scene = cornell()
    origins, directions = some_rays(3)
    renderer = rb.Renderer(scene, spp=4, max_depth=3, rr_depth=100, compile=False, terms=["interior"], share_samples=True,
                           sampling=sampling)
    renderer.jump_watch.looks.clear()
    decisions = Decisions(choices=sampling == "attached")
    held = HeldCaster(renderer.caster_of(pack(scene)), decisions)

    def value(origins: Tensor, directions: Tensor) -> Tensor:
        """Radiance with decisions held, as the loop computes it that plain autograd records."""
        renderer.cache = PackCache()
        rays = given_rays(origins.detach().requires_grad_(), directions.detach().requires_grad_(), scene.dtype, scene.device)
        with decisions, torch.enable_grad():
            call = renderer.prepared([Shot(rays, OF_NO_SENSOR, rays.film.window())], 5, 4, None)
            integrand = call.make_integrand(call.scene)
            integrand = integrand if sampling == "attached" else integrand._replace(caster=held)
            with torch.no_grad():
                return render_images(call, integrand, record=False, bounce=bounce_attached(integrand)).values[0, :, :, 0].t()

    attached = [part.clone().requires_grad_() for part in (origins, directions)]
    radiance = renderer.radiance(*attached, seed=5)
    torch.testing.assert_close(value(origins, directions), radiance.detach(), rtol=1e-12, atol=1e-14)
    w = cotangent(radiance.detach())
    gradients = torch.autograd.grad(radiance, attached, w)
    assert_informative(radiance.detach(), gradients)
    step = 1e-6
    for number, gradient in enumerate(gradients):
        for axis in range(3):
            moved = []
            for sign in (1, -1):
                rays = [origins.clone(), directions.clone()]
                rays[number][:, axis] += sign * step  # each ray has a radiance of its own
                moved.append((value(*rays) * w).sum(1))
            difference, wanted = (moved[0] - moved[1]) / (2 * step), gradient[:, axis]
            assert ((difference - wanted).abs() <= (1e-6 * wanted.abs()).clamp_min(1e-8)).all()


@quiet
def test_gradients_go_on_into_what_made_the_rays_in_its_own_dtype():
    scene = cornell(torch.float32)
    pose = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    origins, directions = some_rays(4)
    radiance = rb.Renderer(scene, spp=4, max_depth=2).radiance(origins + pose, directions)
    assert radiance.dtype == torch.float32 and radiance.shape == (4, 3)
    gradient, = torch.autograd.grad(radiance.sum(), pose)
    assert gradient.dtype == torch.float64 and gradient.isfinite().all() and gradient.abs().max() > 0
    radiance.mul_(2)  # it is no view


def test_samples_are_those_of_the_renderer_and_seeds_differ():
    scene, rays = cornell(), some_rays()
    renderer = rb.Renderer(scene, spp=2, max_depth=3)
    first = renderer.radiance(*rays, seed=1)
    assert torch.equal(first, renderer.radiance(*rays, seed=1)) and not torch.equal(first, renderer.radiance(*rays, seed=2))
    assert torch.equal(first, rb.Renderer(scene, max_depth=3).radiance(*rays, seed=1, spp=2))
    assert not torch.equal(first, renderer.radiance(*rays, seed=1, spp=3))


def test_a_loop_along_rays_without_a_seed_is_warned_of():
    scene, rays = cornell(), some_rays()
    colour = scene.get_parameter("white.reflectance.value").requires_grad_()
    renderer = rb.Renderer(scene, spp=1, max_depth=2)
    renderer.radiance(*rays)
    with torch.no_grad():
        colour *= 0.9
    with pytest.warns(rb.RepeatedNoiseWarning) as told:
        renderer.radiance(*rays)
    assert told[0].filename == __file__


def plate(dtype: torch.dtype = torch.float64, **lamp) -> rb.Scene:
    """A plate above a floor under a lamp."""
    return load(dtype, sensor=sensor(), floor=rectangle((0, 0, 0), 3.0, angle=-90, bsdf=diffuse(0.7)),
                plate=rectangle((0, 0.6, 0), 0.3, angle=90, bsdf=diffuse(0.5)), **lamp)


POINT = {"lamp": {"type": "point", "position": [0.1, 2.0, 0.2], "intensity": rgb(4, 4, 4)}}
SKY = {"sky": {"type": "constant"}}


def down_to(x: float, height: float, count: int = 6, spread: float = 0.2) -> tuple[Tensor, Tensor]:
    """Parallel rays down to the floor around (x, 0, 0)."""
    steps = torch.linspace(-spread, spread, count, dtype=torch.float64)
    across, along = (part.flatten() for part in torch.meshgrid(steps, steps, indexing="ij"))
    origins = torch.stack([x + across, torch.full_like(across, height), along], 1)
    return origins, torch.tensor([[0.0, -1.0, 0.0]], dtype=torch.float64).expand_as(origins)


def said(scene: rb.Scene, rays: tuple[Tensor, Tensor], name: str | None = "plate.to_world", **settings) -> list[str]:
    """What is warned of before a derivative."""
    if name is not None:
        scene.get_parameter(name).requires_grad_()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rb.Renderer(scene, spp=2, max_depth=2, **settings).radiance(*rays, seed=0)
    return [str(warning.message) for warning in caught]


@pytest.mark.parametrize("rays, warned", {
    "parallel, past the plate": (down_to(0.3, 1.5), True),
    "parallel, onto the plate alone": (down_to(0.0, 1.5), False),
    "parallel, below the plate": (down_to(0.3, 0.4), False),
    "beside it": (down_to(1.5, 1.5), False),
    "from one point": ((torch.tensor([[0.0, 1.5, 0.0]]).double().expand(36, 3),
                        down_to(0.3, 0.0)[0] - torch.tensor([0.0, 1.5, 0.0])), True),
    "everywhere": ((torch.tensor([[1.0, 1.5, 0.0]]).double().expand(64, 3), cotangent(torch.zeros(64, 3)).double()), True),
    "a single one": ((torch.tensor([[0.0, 1.5, 0.0]]).double(), torch.tensor([[0.1, -1.0, 0.0]]).double()), False),
}.values(), ids=str)
def test_silhouettes_that_move_among_the_rays_are_named(rays, warned):
    messages = said(plate(**SKY), rays)
    assert len(messages) == warned
    assert all("`plate.to_world` lack the contribution of silhouettes" in message and "no area" in message
               for message in messages)


def test_a_shadow_s_sharp_border_among_the_rays_is_named_and_a_soft_one_is_not():
    lamp = {"lamp": rectangle((0, 2, 0), 0.5, angle=90, emitter={"type": "area", "radiance": rgb(4, 4, 4)})}
    below = down_to(0.4, 0.3)
    message, = said(plate(**POINT), below)
    assert "`plate.to_world` lack the contribution of the borders of shadows" in message and "no area" in message
    assert not said(plate(**lamp), below) and not said(plate(**POINT), down_to(1.5, 0.3))
    assert said(plate(**lamp), below, terms=["interior"])  # that is left out then, too


def test_shadows_are_looked_for_among_other_rays_anew():
    scene = plate(**POINT)
    scene.get_parameter("plate.to_world").requires_grad_()
    renderer = rb.Renderer(scene, spp=2, max_depth=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        renderer.radiance(*down_to(1.5, 0.3), seed=0)
    with pytest.warns(rb.SilhouetteWarning, match="borders of shadows"):
        renderer.radiance(*down_to(0.4, 0.3), seed=1)


def test_rays_that_move_over_edges_are_named():
    origins, directions = down_to(0.3, 1.5)
    message, = said(plate(**SKY), (origins.requires_grad_(), directions), None)
    assert "`Rays.origins` lack the contribution of silhouettes" in message


def test_what_an_image_has_is_not_said_of_it_before_or_after():
    """One renderer for images and rays: the image has the term, whatever is said about rays."""
    scene = plate(**SKY)
    scene.get_parameter("plate.to_world").requires_grad_()
    renderer = rb.Renderer(scene, spp=2, max_depth=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        renderer(seed=0)
        with pytest.raises(rb.SilhouetteWarning):
            renderer.radiance(*down_to(0.3, 1.5), seed=0)
        renderer(seed=0)


@quiet
def test_textures_of_a_pyramid_are_read_at_their_finest():
    """A ray has no width, so that what it sees first is not blurred."""
    data = torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(1)).numpy()

    def seen(filter_type: str) -> Tensor:
        bitmap = {"type": "bitmap", "data": data, "raw": True, "filter_type": filter_type}
        scene = load(sensor=sensor(), sky={"type": "constant"}, wall=rectangle((0, 0, 0), bsdf={
            "type": "diffuse", "reflectance": bitmap}))
        steps = torch.linspace(-0.9, 0.9, 12, dtype=torch.float64)
        origins = torch.stack([steps, 0.3 * steps, torch.full_like(steps, 40)], 1)
        ahead = torch.tensor([[0.0, 0.0, -1.0]]).expand(12, 3)
        return rb.Renderer(scene, spp=8, max_depth=2, nee=False).radiance(origins, ahead)

    fine = seen("bilinear")
    assert fine.std() > 0.1
    torch.testing.assert_close(seen("trilinear"), fine, rtol=1e-6, atol=1e-7)


@pytest.mark.hostile
@pytest.mark.parametrize("origins, directions, error, words", {
    "none": (torch.zeros(0, 3), torch.zeros(0, 3), ValueError, r"origins of rays must have shape \(N, 3\) with N of at"),
    "another shape": (torch.zeros(4, 3), torch.zeros(4, 2), ValueError, r"directions of rays .*got \(4, 2\)"),
    "one ray": (torch.zeros(3), torch.ones(3), ValueError, r"got \(3,\)"),
    "two counts": (torch.zeros(1, 3), torch.ones(4, 3), ValueError, "got 1 origins and 4 directions; a single origin is"),
    "NaN": (torch.full((2, 3), torch.nan), torch.ones(2, 3), ValueError, "origins of rays must be finite, got NaN or inf"),
    "infinite": (torch.zeros(2, 3), torch.tensor([[1.0, 0, 0], [torch.inf, 0, 0]]), ValueError,
                 "directions of rays must be finite, got NaN or infinity in 1 of 2, first in row 1"),
    "zero": (torch.zeros(2, 3), torch.tensor([[1.0, 0, 0], [0, 0, 0]]), ValueError,
             "directions of rays must not be zero, got 1 of 2, first in row 1"),
    "integers": (torch.zeros(2, 3, dtype=torch.int64), torch.ones(2, 3), TypeError, "floating-point tensor .*torch.int64"),
    "a list": ([[0, 0, 0]], torch.ones(1, 3), TypeError, "got list"),
    "elsewhere": (torch.zeros(1, 3, device="meta"), torch.ones(1, 3), ValueError, "on meta, and the scene on cpu"),
}.values(), ids=str)
def test_what_are_no_rays_is_refused_with_words(origins, directions, error, words):
    with pytest.raises(error, match=words):
        rb.Renderer(cornell()).radiance(origins, directions)


@pytest.mark.hostile
def test_jvp_along_rays_takes_no_arguments_of_images():
    scene = cornell()
    with pytest.raises(ValueError, match="along rays there are no sensors, windows and aovs"):
        rb.jvp(scene, {"white.reflectance.value": torch.ones(3)}, rays=some_rays(), window=(0, 0, 2, 2))


@quiet
@pytest.mark.hostile
def test_a_gradient_by_rays_that_is_not_finite_is_named():
    """A bright point light at a thousandth of a unit: what is asked of its light is finite in float32, and its slope not."""
    scene = load(torch.float32, sensor=sensor(), floor=rectangle((0, 0, 0), 1.0, bsdf=diffuse(0.5)), lamp={
        "type": "point", "position": [0.0, 0.0, 1e-3], "intensity": rgb(1e18, 1e18, 1e18)})
    origins = torch.tensor([[5e-4, 0.0, 5e-4]], requires_grad=True)
    radiance = rb.Renderer(scene, spp=1, max_depth=2).radiance(origins, torch.tensor([[0.0, 0.0, -1.0]]))
    assert radiance.isfinite().all()
    with pytest.raises(rb.NonFiniteError, match="the gradient of `origins` of the rays is NaN or infinite"):
        (1e12 * radiance).sum().backward()
