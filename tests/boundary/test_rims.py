"""Curves inside of triangles at which shading normals turn away from the viewer, against closed forms."""

import math
import warnings

import numpy as np
import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.boundary.closed_forms import GLOW, SIZE, along, assert_close, derivative, parallel
from tests.deep import deep, deep_but
from tests.gradients import cotangent, relative_error, unwarned_renderer
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from tests.scenes.meshes import POSE, ball, icosphere
from torch_radbp.io.values.transform import rotate, scale, translate

RADIANCE = torch.tensor([3, 2, 1], dtype=torch.float64)
PIXEL = 2 / SIZE  # of `parallel`


def total_of(scene: rb.Scene) -> Tensor:
    """(3,) sums of the image."""
    with torch.no_grad():
        return rb.render(scene, spp=2048, max_depth=1)[0].sum((1, 2))


def growing(pose: Tensor) -> Tensor:
    """The direction in which a shape of this pose grows about its own origin."""
    direction = torch.zeros_like(pose)
    direction[:3, :3] = pose[:3, :3]
    return direction


def assert_grows(shape: dict, pose: np.ndarray, share: float) -> None:
    """Scaled by s, a lamp shows s^2 as much without perspective, black bands included: 2 of it more."""
    scene = load(camera=parallel(rfilter="gaussian"), ball=shape | GLOW | {"to_world": pose})
    direction = growing(scene.get_parameter("ball.to_world").detach())
    assert_close(derivative(scene, "ball.to_world", direction, spp=256), 2 * total_of(scene), share)


# From bands of a pixel, which coarse meshes have, to those narrower than the rounding of rays.
@pytest.mark.parametrize("subdivisions, share", [(1, 0.01), (3, 0.015), deep(2, 0.01), deep(4, 0.015), deep(5, 0.02),
                                                 deep(6, 0.01)])
@pytest.mark.parametrize("bumps", [0.1, deep(0.0)])
def test_a_smooth_lamp_that_grows_gains_what_it_shows(subdivisions, share, bumps):
    assert_grows(ball(subdivisions, bumps), POSE, share)


# Facets seen nearly edge-on, and outlines that fold within 1e-5 of their distance, where 29%, 6% and 2% were lost.
@pytest.mark.parametrize("subdivisions, bumps, turn", [(0, 0.1, 34), (1, 0.0, 30), deep(2, 0.0, 39), (3, 0.1, 0),
                                                       deep(4, 0.1, 1)])
def test_curves_beside_each_other_count_once_each(subdivisions, bumps, turn):
    numbers = np.random.default_rng(0).normal(size=(turn + 1, 3, 3))[turn]
    rotation = np.eye(4)
    rotation[:3, :3] = np.linalg.qr(numbers)[0]
    rotation[:3, :3] *= np.sign(np.linalg.det(rotation))
    assert_grows(ball(subdivisions, bumps), translate((0.1, 0.05, 0)) @ rotation @ scale((0.6, 0.6, 0.6)), 0.01)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_vertices_of_a_smooth_lamp_that_move_out_gain_what_it_shows(dtype):
    """As of a pose; its normals stay: Mitsuba's set-up "scale sphere emitter on black"."""
    vertices, faces = icosphere(2)
    mesh = {"type": "mesh", "vertex_positions": 0.6 * vertices, "vertex_normals": vertices, "faces": faces}
    scene = load(dtype, camera=parallel(), ball=mesh | GLOW)
    found = derivative(scene, "ball.vertex_positions", scene.get_parameter("ball.vertex_positions").detach(), spp=256)
    assert_close(found, 2 * total_of(scene))


def test_a_ball_of_exact_normals_shows_a_disk():
    """Of area pi r^2: it grows by 2 pi r, and shifted under a weight that rises by 1 a pixel it gains its area a pixel."""
    vertices, faces = icosphere(4)
    mesh = {"type": "mesh", "vertex_positions": vertices, "vertex_normals": vertices, "faces": faces}
    scene = load(camera=parallel(), ball=mesh | GLOW | {"to_world": scale((0.6, 0.6, 0.6))})
    area = math.pi * 0.6**2 / PIXEL**2
    grow = growing(scene.get_parameter("ball.to_world").detach()) / 0.6
    assert_close(derivative(scene, "ball.to_world", grow, spp=256), 2 * area / 0.6 * RADIANCE, 0.015)
    weights = torch.arange(SIZE, dtype=torch.float64).expand(SIZE, SIZE)
    assert_close(derivative(scene, "ball.to_world", along(0), weights, spp=256), area * RADIANCE / PIXEL, 0.015)


CAMERAS = {"perspective": {}, "thinlens": {"type": "thinlens", "aperture_radius": 0.2, "focus_distance": 3.0}}


@pytest.mark.parametrize("kind", deep_but(["perspective"], CAMERAS))
def test_a_narrower_view_magnifies_a_smooth_lamp(kind):
    scene = load(camera=sensor(SIZE, rfilter="gaussian") | CAMERAS[kind], ball=ball() | GLOW | {"to_world": POSE})
    half = math.radians(20)
    expected = -total_of(scene) / (math.sin(half) * math.cos(half)) * math.radians(1)
    spp = 4096 if kind == "thinlens" else 256
    found = derivative(scene, "camera.x_fov", torch.tensor(1.0, dtype=torch.float64), spp=spp)
    assert_close(found, expected, 0.02)


@pytest.mark.parametrize("distortion", [deep({"k1": 0.1}), {"distortion": "fisheye", "k1": 0.05}])
def test_a_distorted_image_of_a_smooth_lamp_is_magnified_by_its_focal_length(distortion):
    view = {key: value for key, value in sensor(SIZE).items() if key != "fov"} | {"type": "calibrated", "fx": 20.0}
    scene = load(camera=view | distortion, ball=ball() | GLOW | {"to_world": POSE})
    one = torch.tensor(1.0, dtype=torch.float64)
    both = sum(derivative(scene, f"camera.{name}", one, spp=256) for name in ("fx", "fy"))
    assert_close(both, 2 * total_of(scene) / 20.0)


def test_zero_sets_shade_smoothly_and_have_rims():
    x, y, z = torch.meshgrid(*(torch.linspace(-1, 1, 8, dtype=torch.float64),) * 3, indexing="ij")
    grid = (torch.sqrt(x**2 + y**2 + z**2) - 0.8)[..., None].numpy().astype(np.float32)
    pose = translate((-0.6, -0.55, 0)) @ rotate((1, 2, 3), 20) @ scale((1.2, 1.2, 1.2))
    scene = load(camera=parallel(), ball={"type": "sdfgrid", "grid": grid, "to_world": pose, **GLOW})
    matrix = scene.get_parameter("ball.to_world").detach()
    assert_close(derivative(scene, "ball.to_world", growing(matrix), spp=256), 2 * total_of(scene))


def half_turned(**attributes) -> dict:
    """A square of side 1 at z = 0 of which the left half shows the back of its shading normals: their z rises by 1."""
    corners = torch.tensor([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]], dtype=torch.float64)
    rise = math.sqrt(0.75)
    normals = torch.tensor([[rise, 0, -0.5], [rise, 0, 0.5], [rise, 0, 0.5], [rise, 0, -0.5]], dtype=torch.float64)
    return {"type": "mesh", "vertex_positions": corners, "vertex_normals": normals,
            "faces": torch.tensor([[0, 1, 2], [0, 2, 3]])} | attributes


TURN = torch.tensor([[0, 0, 0], [-0.5 / math.sqrt(0.75), 0, 1], [-0.5 / math.sqrt(0.75), 0, 1], [0, 0, 0]],
                    dtype=torch.float64)  # of the normals on the right, towards the viewer: the rim goes left by 1/2


@pytest.mark.parametrize("rfilter", ["box", deep("lanczos")])
def test_normals_that_turn_move_the_rim(rfilter):
    film = parallel(rfilter=rfilter)["film"] | {"crop_offset_x": 3, "crop_offset_y": 6, "crop_width": 10, "crop_height": 5}
    scene = load(camera=parallel() | {"film": film}, square=half_turned(**GLOW))
    found = derivative(scene, "square.vertex_normals", TURN, spp=4096 if rfilter == "lanczos" else 256)
    assert_close(found, 0.5 / PIXEL * 5 * RADIANCE, 0.02)


def test_a_rim_along_an_edge_counts_once():
    """Three columns of vertices, the normals in the middle across the view: as these turn by d, the rim goes left by d."""
    x, y = torch.cartesian_prod(torch.tensor([-0.5, 0, 0.5]), torch.tensor([-0.5, 0.5])).double().unbind(1)
    mesh = {"type": "mesh", "vertex_positions": torch.stack([x, y, 0 * x], 1),
            "vertex_normals": torch.stack([torch.sqrt(1 - x**2), 0 * x, x], 1),
            "faces": torch.tensor([[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]])}
    scene = load(camera=parallel(), square=mesh | GLOW)
    turn = torch.zeros(6, 3, dtype=torch.float64)
    turn[2:4, 2] = 1.0
    assert_close(derivative(scene, "square.vertex_normals", turn, spp=256), 1 / PIXEL**2 * RADIANCE)


def test_a_two_sided_surface_shows_its_other_material_beyond_the_rim():
    sides = {"type": "twosided", "front": diffuse(0.8, 0.6, 0.9), "back": diffuse(0.3, 0.2, 0.6)}
    scene = load(camera=parallel(), sky={"type": "constant", "radiance": rgb(1, 1, 1)}, square=half_turned(bsdf=sides))
    jump = torch.tensor([0.5, 0.4, 0.3], dtype=torch.float64)
    found = derivative(scene, "square.vertex_normals", TURN, spp=4096, max_depth=2, terms=["primary"])
    assert_close(found, 0.5 / PIXEL**2 * jump, 0.02)
    albedo = unwarned_renderer(scene, spp=256).aovs(["albedo", "depth", "alpha"], seed=1)
    parameter = scene.get_parameter("square.vertex_normals")
    gradient, none, nothing = (torch.autograd.grad(albedo[name].sum(), parameter, retain_graph=True, allow_unused=True)[0]
                               for name in albedo)
    assert_close((gradient * TURN).sum()[None], 0.5 / PIXEL**2 * jump.sum()[None], 0.02)
    assert all(part is None or (part == 0).all() for part in (none, nothing))


def test_hidden_rims_contribute_nothing():
    screen = rectangle((0, 0, 0.9), 0.9, **GLOW)
    scene = load(camera=parallel(), screen=screen, ball=ball() | GLOW | {"to_world": POSE})
    assert (derivative(scene, "ball.to_world", torch.ones(4, 4, dtype=torch.float64), spp=64) == 0).all()
    scene = load(camera=parallel(), ball=ball() | GLOW | {"to_world": POSE})
    assert (derivative(scene, "ball.to_world", along(0), spp=64, hide_emitters=True) == 0).all()


def test_an_instance_has_the_rims_of_its_copy():
    group = {"type": "shapegroup", "ball": ball() | {"bsdf": diffuse(0.7, 0.5, 0.3)}}
    shown = {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": POSE}
    sky = {"type": "constant", "radiance": rgb(1, 1, 1)}
    scenes = (load(camera=parallel(), sky=sky, group=group, shape=shown),
              load(camera=parallel(), sky=sky, shape=group["ball"] | {"to_world": POSE}))
    weights = torch.linspace(0, 1, SIZE, dtype=torch.float64)[:, None].expand(SIZE, SIZE)
    found, expected = (derivative(scene, "shape.to_world", along(1), weights, spp=1024, max_depth=2) for scene in scenes)
    assert_close(found, expected, 0.03)


@pytest.mark.parametrize("name", deep_but(["ball.vertex_positions"], ["ball.vertex_positions", "camera.to_world"]))
def test_forward_mode_and_the_backward_pass_agree_at_rims(name):
    scene = load(camera=sensor(8), ball=ball() | GLOW | {"to_world": POSE})
    parameter = scene.get_parameter(name).requires_grad_()
    direction = torch.randn(parameter.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    image = unwarned_renderer(scene, spp=4, max_depth=1, compile=False)(seed=2)
    weights = cotangent(image.detach())
    backward = (torch.autograd.grad(image, parameter, weights)[0] * direction).sum()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.SilhouetteWarning)
        tangent = rb.jvp(scene, {name: direction}, spp=4, max_depth=1, seed=2, compile=False)
    assert backward.abs() > 0 and relative_error((tangent * weights).sum()[None], backward[None]) < 1e-10
