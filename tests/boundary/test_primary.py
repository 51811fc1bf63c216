"""What edges in view contribute to derivatives, against closed forms, and what they do not."""

import math
import warnings

import numpy as np
import pytest
import torch
from torch.func import functional_call

import torch_radbp as rb
from tests.boundary.closed_forms import DARK, GLOW, JUMP, SIZE, along, assert_close, derivative, parallel
from tests.deep import deep, deep_but
from tests.gradients import cotangent, relative_error, unwarned_renderer
from tests.scenes import diffuse, load, look_at, rectangle, rgb, sensor
from torch_radbp.boundary.curve import outline
from torch_radbp.boundary.curve.edge_places import jump_of_creases
from torch_radbp.boundary.curve.edges import edges_of
from torch_radbp.boundary.curve.geometry import geometry_of, in_world
from torch_radbp.boundary.curve.outline import Moving, Outlines
from torch_radbp.boundary.terms import primary
from torch_radbp.film.filter import Filter
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.scene.packing.pack import pack
from torch_radbp.shape.surface import grid


@pytest.mark.parametrize("rfilter", deep_but(["box", "lanczos"], [
    "box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos"]))
def test_each_pixel_gains_what_the_filter_counts_at_an_edge_that_moves(rfilter):
    """A half plane that glows, left of x = 0.05: column j changes by jump * filter(edge - centre of j) * velocity.

    The jump is the same all along the edge, so that few samples give it without noise.
    """
    scene = load(camera=parallel(rfilter=rfilter), sky=DARK, plane=rectangle((-9.95, 0, 0), 10, **GLOW))
    kernel: Filter = scene.sensors[0].film.rfilter
    edge, velocity = SIZE / 2 + 0.05 * SIZE / 2, SIZE / 2  # pixels, and pixels per unit of length
    place = torch.linspace(-kernel.radius, kernel.radius, 100001, dtype=torch.float64)
    total = torch.trapezoid(kernel.evaluate(place), place)
    columns = torch.arange(4, 12, dtype=torch.float64)  # whose filters reach no border
    offset = edge - 0.5 - columns
    kernel_there = torch.where(offset.abs() < kernel.radius, kernel.evaluate(offset), 0.0)
    expected = kernel_there / total * velocity * JUMP[0] * SIZE
    parameter = scene.get_parameter("plane.to_world").requires_grad_()
    red = unwarned_renderer(scene, spp=256, max_depth=1)(seed=1)[0, 0].sum(0)
    found = torch.stack([torch.autograd.grad(red[int(j)], parameter, retain_graph=True)[0][0, 3] for j in columns])
    assert expected.abs().max() > 0 and relative_error(found, expected) < 0.03, (found, expected)


def test_two_surfaces_that_meet_jump_there_without_any_silhouette():
    """Two walls meet at an edge x = 0 of which the camera sees both sides, and nothing else: a pan moves the edge."""
    slant, reach = 45, 3 * math.cos(math.pi / 4)
    walls = {name: {"type": "rectangle", "emitter": {"type": "area", "radiance": rgb(*radiance)},
                    "to_world": translate((side * reach, 0, -1)) @ rotate((0, 1, 0), -side * slant) @ scale((3, 30, 1))}
             for name, side, radiance in (("left", -1, (3, 2, 1)), ("right", 1, (0.25, 0.25, 0.25)))}
    scene = load(camera=sensor(8), **walls)
    away = 3.5 + 1 + reach
    pixel = 2 * away * math.tan(math.radians(20)) / 8
    expected = -JUMP * 8 / pixel  # the camera moves right, the edge left, away from the bright wall
    assert_close(derivative(scene, "camera.to_world", along(0)), expected)


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "disk", "rectangle", "cube"])
def test_an_outline_that_grows_gains_its_length(kind):
    """Scaled by s about its middle, an outline of area A has the area s^2 A: the image changes by 2 A * jump."""
    areas = {"sphere": math.pi, "disk": math.pi, "rectangle": 4.0, "cube": 4.0, "cylinder": 2.0}
    pose = translate((0.1, 0.05, 0)) @ scale((0.5, 0.5, 0.5))
    if kind == "cylinder":
        pose = translate((0.1, 0.05, 0)) @ rotate((0, 1, 0), 90) @ scale((0.5, 0.5, 0.5)) @ translate((0, 0, -0.5))
    scene = load(camera=parallel(), sky=DARK, shape={"type": kind, "to_world": pose} | GLOW)
    grow = torch.zeros(4, 4, dtype=torch.float64)
    matrix = scene.get_parameter("shape.to_world").detach()
    grow[:3, :3] = matrix[:3, :3]
    if kind == "cylinder":
        grow[:3, 3] = matrix[:3, 3] - torch.tensor([0.1, 0.05, 0.0])
    expected = 2 * 0.25 * areas[kind] * JUMP / (2 / SIZE) ** 2
    assert_close(derivative(scene, "shape.to_world", grow), expected)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("far", [1e4, 1e5])
def test_an_outline_far_from_the_origin_gains_its_length_too(far, dtype):
    view = parallel() | {"to_world": translate((far, 0, 0)) @ parallel()["to_world"]}
    pose = translate((far + 0.125, 0.0625, 0)) @ scale((0.5, 0.5, 0.5))
    scene = load(dtype, camera=view, sky=DARK, shape={"type": "cube", "to_world": pose} | GLOW)
    grow = torch.diag(torch.tensor([0.5, 0.5, 0.5, 0.0], dtype=dtype))
    assert_close(derivative(scene, "shape.to_world", grow, spp=256), 2 * JUMP / (2 / SIZE) ** 2)


# Of the derivative near the origin: what edges contribute in all, of which the derivative is the difference, is much larger.
FAR_OFF = {"sphere": (GLOW, 0.05), "cube": (GLOW, 0.02), "lit cube": ({"bsdf": diffuse(0.8)}, 0.05)}


@pytest.mark.parametrize("kind, dtype, far", [
    ("sphere", torch.float32, 4e3), deep("cube", torch.float32, 4e3), ("lit cube", torch.float32, 4e3),
    deep("sphere", torch.float64, 1e4), deep("cube", torch.float64, 1e4), deep("lit cube", torch.float64, 1e4)])
def test_outlines_and_creases_far_from_the_origin_are_those_near_it(kind, far, dtype):
    """Slanted faces, of which a ray beside an edge meets one much nearer or farther than the edge itself."""
    look, tolerance = FAR_OFF[kind]
    weight = torch.linspace(0.0, 1.0, SIZE, dtype=dtype).expand(SIZE, SIZE)

    def found(far: float) -> torch.Tensor:
        at = np.array((-0.5, 0.8, 0.3)) * far
        lamp = rectangle((0, 0, 0), 1.0, emitter={"type": "area", "radiance": rgb(300, 200, 100)})
        lamp["to_world"] = translate(at) @ look_at((8, 3, 9), (0, 0, 0), (0, 1, 0))
        pose = translate(at) @ rotate((1, 2, 0.5), 40) @ scale((0.5, 0.4, 0.3))
        scene = load(dtype, camera=sensor(SIZE, at + (1, 2, 3), at), lamp=lamp,
                     shape={"type": kind.split()[-1], "to_world": pose} | look)
        return derivative(scene, "camera.to_world", along(0), weight, spp=256, max_depth=2)

    assert_close(found(far), found(0.0), tolerance)


def camera(kind: str) -> dict:
    view = sensor(SIZE, rfilter="gaussian")
    if kind == "perspective":
        return view
    return view | {"type": "thinlens", "aperture_radius": 0.4, "focus_distance": 3.0}


# Samples by which the noise is far below 2 %: none of an outline through a pinhole; through a lens, a sphere's is rare.
@pytest.mark.parametrize("kind, shape, spp", [("perspective", "sphere", 1 << 11), deep("perspective", "cube", 1 << 11),
                                              deep("thinlens", "sphere", 1 << 14), ("thinlens", "cube", 1 << 12)])
def test_a_narrower_view_magnifies_whatever_is_seen(kind, shape, spp):
    """The light of a thing that is wholly in view is that over 1 / tan^2(x_fov / 2) of the image, with any lens."""
    placed = {"type": shape, "to_world": translate((0.1, 0.05, 0)) @ rotate((1, 2, 3), 40) @ scale((0.2, 0.2, 0.2))}
    scene = load(camera=camera(kind), dark={"type": "constant", "radiance": rgb(0, 0, 0)}, shape=placed | GLOW)
    with torch.no_grad():
        total = rb.render(scene, spp=1024, max_depth=1)[0].sum((1, 2))
    half = math.radians(20)
    expected = -total / (math.sin(half) * math.cos(half)) * math.radians(1)
    assert_close(derivative(scene, "camera.x_fov", torch.tensor(1.0, dtype=torch.float64), spp=spp), expected, 0.02)


@pytest.mark.parametrize("distortion", [{"fx": 20.0, "k1": 0.1}, deep({"fx": 20.0, "distortion": "fisheye", "k1": 0.05})])
def test_a_distorted_image_is_magnified_by_its_focal_length(distortion):
    view = {key: value for key, value in sensor(SIZE).items() if key != "fov"} | {"type": "calibrated", **distortion}
    placed = {"type": "cube", "to_world": rotate((1, 2, 3), 40) @ scale((0.3, 0.3, 0.3))}
    scene = load(camera=view, dark={"type": "constant", "radiance": rgb(0, 0, 0)}, shape=placed | GLOW)
    with torch.no_grad():
        total = rb.render(scene, spp=1024, max_depth=1)[0].sum((1, 2))
    both = sum(derivative(scene, f"camera.{name}", torch.tensor(1.0, dtype=torch.float64)) for name in ("fx", "fy"))
    assert_close(both, 2 * total / 20.0)


def test_a_vertex_that_moves_out_gains_the_area_that_its_edges_sweep():
    corners = torch.tensor([[-0.5, -0.4, 0], [0.6, -0.4, 0], [0.1, 0.5, 0]], dtype=torch.float64)
    scene = load(camera=parallel(), sky=DARK, shape={"type": "mesh", "vertex_positions": corners,
                                                     "faces": torch.tensor([[0, 1, 2]])} | GLOW)
    up = torch.zeros(3, 3, dtype=torch.float64)
    up[2, 1] = 1.0
    assert_close(derivative(scene, "shape.vertex_positions", up), 0.5 * 1.1 * JUMP / (2 / SIZE) ** 2)


def test_edges_behind_a_surface_and_out_of_view_contribute_nothing():
    hidden = {"type": "cube", "to_world": rotate((1, 2, 3), 40) @ scale((0.3, 0.3, 0.3))} | GLOW
    screen = rectangle((0, 0, 1), 0.9, **GLOW)
    beside = {"type": "cube", "to_world": translate((2, 0, 0)) @ scale((0.5, 0.5, 0.5))} | GLOW
    scene = load(camera=parallel(), sky=DARK, hidden=hidden, screen=screen, beside=beside)
    for name in ("hidden", "beside"):
        assert (derivative(scene, f"{name}.to_world", torch.ones(4, 4, dtype=torch.float64)) == 0).all()
    assert (derivative(scene, "screen.to_world", along(0), weights=torch.rand(SIZE, SIZE)) != 0).all()


def test_a_hidden_emitter_hides_nothing():
    cube = {"type": "cube", "to_world": scale((0.5, 0.5, 0.5)), "bsdf": diffuse(0.0)}
    grow = torch.diag(torch.tensor([0.5, 0.5, 0.5, 0.0], dtype=torch.float64))
    found = [derivative(load(camera=parallel(), sky=DARK, cube=cube, **lamp), "cube.to_world", grow, hide_emitters=hide)
             for lamp, hide in (({"lamp": rectangle((0, 0, 1), 0.9, **GLOW)}, True), ({}, True), ({}, False))]
    assert (found[0] == 0).all() and (found[1] == 0).all()  # black before black
    assert (found[2] != 0).all()


def test_an_instance_has_what_its_copy_has():
    cube = {"type": "cube"} | GLOW
    pose = translate((0.1, 0.05, 0)) @ rotate((1, 2, 3), 40) @ scale((0.3, 0.3, 0.3))
    copied = load(camera=parallel(), sky=DARK, shape=cube | {"to_world": pose})
    grey = {"type": "cube", "bsdf": diffuse(0.0)}
    group = {"type": "shapegroup", "cube": grey}
    shown = load(camera=parallel(), sky=DARK, group=group,
                 shape={"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": pose})
    copied = load(camera=parallel(), sky=DARK, shape=grey | {"to_world": pose})
    weights = torch.linspace(0, 1, SIZE, dtype=torch.float64)[:, None].expand(SIZE, SIZE)
    direction = torch.randn(4, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    found, expected = (derivative(scene, "shape.to_world", direction, weights, spp=4096) for scene in (shown, copied))
    assert_close(found, expected, 0.02)


def test_the_pose_of_the_camera_moves_instances_too():
    pose = translate((0.1, 0.05, 0)) @ scale((0.3, 0.3, 0.3))
    group = {"type": "shapegroup", "cube": {"type": "cube", "bsdf": diffuse(0.0)}}
    shown = {f"shape{k}": {"type": "instance", "group": {"type": "ref", "id": "group"},
                           "to_world": translate((0.8 * k - 0.4, 0, 0)) @ pose} for k in range(2)}
    scene = load(camera=parallel(), sky=DARK, group=group, **shown)
    grow = torch.zeros(4, 4, dtype=torch.float64)
    grow[:3, :3] = scene.get_parameter("camera.to_world").detach()[:3, :3]  # a wider view
    expected = -(0.0 - 0.25) * 2 * 2 * 0.6**2 / (2 / SIZE) ** 2 * torch.ones(3, dtype=torch.float64)
    assert_close(derivative(scene, "camera.to_world", grow), expected)


def solid(rfilter: str = "gaussian") -> rb.Scene:
    cube = {"type": "cube", "to_world": rotate((1, 2, 3), 40) @ scale((0.4, 0.4, 0.4)), "bsdf": diffuse(0.7, 0.4, 0.2)}
    return load(camera=sensor(8, rfilter=rfilter), sky=DARK, cube=cube, ball={
        "type": "sphere", "center": [0.4, 0.3, 0.6], "radius": 0.3, "bsdf": diffuse(0.2, 0.4, 0.7)})


@pytest.mark.parametrize("name", deep_but(["cube.to_world"], ["cube.to_world", "camera.to_world"]))
def test_forward_mode_and_plain_autograd_agree_with_the_backward_pass(name):
    scene = solid()
    parameter = scene.get_parameter(name).requires_grad_()
    direction = torch.randn(4, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    images = [unwarned_renderer(scene, spp=4, max_depth=2, compile=False, adjoint=adjoint)(seed=2)
              for adjoint in (rb.MemoizedAdjoint(), rb.TapeAdjoint())]
    weights = cotangent(images[0].detach())
    backward, tape = (torch.autograd.grad(image, parameter, weights)[0] for image in images)
    assert backward.abs().max() > 0 and relative_error(tape, backward) < 1e-10
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.SilhouetteWarning)
        tangent = rb.jvp(scene, {name: direction}, spp=4, max_depth=2, seed=2, compile=False)
    expected = (backward * direction).sum()
    assert abs((tangent * weights).sum() - expected) < 1e-10 * expected.abs()


def test_terms_add_up_and_can_be_left_out():
    scene = solid()
    parameter = scene.get_parameter("cube.to_world").requires_grad_()
    found = {}
    for terms in (("interior",), {"primary"}, ["primary", "interior"]):
        image = unwarned_renderer(scene, spp=4, max_depth=2, terms=terms, compile=False)(seed=2)
        found[len(found)], = torch.autograd.grad(image, parameter, cotangent(image.detach()))
        found[f"image {len(found)}"] = image.detach()
    interior, primary, both = (found[key] for key in found if isinstance(key, int))
    assert interior.abs().max() > 0 and primary.abs().max() > 0
    assert torch.allclose(interior + primary, both, rtol=1e-10)
    first, *others = (found[key] for key in found if isinstance(key, str))
    assert all(torch.equal(first, other) for other in others)


@pytest.mark.parametrize("terms", ["interior", ("interior", "secondary"), ("primary", "edges")])
def test_an_unknown_term_is_refused(terms):
    with pytest.raises(ValueError, match="terms=.* interior, primary"):
        rb.Renderer(solid(), terms=terms)


def test_the_backward_pass_of_its_own_seed_draws_its_own_edges():
    scene = solid()
    parameter = scene.get_parameter("cube.to_world").requires_grad_()
    renderer = unwarned_renderer(scene, spp=4, max_depth=2, terms=["primary"])
    one, two, same = (torch.autograd.grad(renderer(seed=seed, seed_grad=own).sum(), parameter)[0]
                      for seed, own in ((1, 5), (1, 6), (2, 5)))
    assert torch.equal(one, same) and not torch.equal(one, two)


def test_masks_and_depths_move_with_the_edges_of_things():
    """A square of side 1 at z = 0 before a wall at z = -1, seen from z = 3: growing, it covers more of the wall."""
    scene = load(camera=parallel() | {"near_clip": 1.0, "far_clip": 10.0}, sky=DARK, square=rectangle((0, 0, 0), 0.5),
                 wall=rectangle((0, 0, -1), 5))
    parameter = scene.get_parameter("square.to_world").requires_grad_()
    renderer = unwarned_renderer(scene, spp=1024, max_depth=1)
    quantities = renderer.aovs(["depth", "albedo", "m2_depth"], seed=1)
    grow = torch.diag(torch.tensor([0.5, 0.5, 0.0, 0.0], dtype=torch.float64))
    gained = 2.0 * (SIZE / 2) ** 2  # pixels
    for name, jump in (("depth", -1.0), ("m2_depth", 2.0**2 - 3.0**2)):
        gradient, = torch.autograd.grad(quantities[name].sum(), parameter, retain_graph=True)
        assert_close((gradient * grow).sum()[None], torch.tensor([jump * gained], dtype=torch.float64))

    alone = load(camera=parallel(), lamp={"type": "point", "position": [0, 0, 5]}, square=rectangle((0, 0, 0), 0.5))
    parameter = alone.get_parameter("square.to_world").requires_grad_()
    masks = unwarned_renderer(alone, spp=1024, max_depth=2).aovs(["hit", "alpha"], seed=1)
    for mask in masks.values():
        gradient, = torch.autograd.grad(mask.sum(), parameter, retain_graph=True)
        assert_close((gradient * grow).sum()[None], torch.tensor([gained], dtype=torch.float64))


def test_only_creases_and_seams_of_a_smooth_surface_may_jump():
    scene = load(camera=parallel(), sky=DARK, cube={"type": "cube"}, ball={"type": "sphere"})
    tensors = pack(scene)
    counts = [len(shape.faces) for shape in (scene.cube.oriented(), scene.ball.oriented())]

    def jumps(*moving: bool) -> torch.Tensor:
        found = Outlines().of(tensors, counts, Moving(moving, ()), torch.Generator())
        a, b, *opposite = in_world(geometry_of(tensors), (found.edges.a, found.edges.b, *found.edges.opposite), None)
        return jump_of_creases(found, a, b, opposite)

    cube, ball = jumps(True, False), jumps(False, True)
    assert len(cube) == 18 and int((cube > 0).sum()) == 12
    assert 0 < int((ball > 0).sum()) < 0.01 * len(ball)


def test_edges_that_instances_show_are_kept_until_others_do():
    shown = {f"shown{k}": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}} for k in range(3)}
    scene = load(camera=parallel(), sky=DARK, group={"type": "shapegroup", "square": rectangle((0, 0, 0), 0.25)}, **shown)
    outlines = Outlines()

    def found(*moving: bool) -> list[int]:
        edges = outlines.of(pack(scene), [2], Moving((False,), moving), torch.Generator())
        kept = outlines.of(pack(scene), [2], Moving((False,), moving), torch.Generator())
        assert kept is edges and len(edges.edges.a) == len(edges.instance)
        return edges.instance.unique().tolist()

    assert found(True, False, True) == [1, 3]
    assert found(False, True, False) == [2]


def test_nothing_is_traced_where_nothing_moves(monkeypatch):
    scene = solid()
    scene.get_parameter("cube.bsdf.reflectance.value").requires_grad_()

    def refuse(*arguments):
        raise AssertionError("edges are looked for")

    monkeypatch.setattr(Outlines, "of", refuse)
    rb.render(scene, spp=1, max_depth=2).sum().backward()
    scene.get_parameter("cube.to_world").requires_grad_()
    with pytest.raises(AssertionError, match="looked for"):
        rb.render(scene, spp=1, max_depth=2)
    with torch.no_grad():
        rb.render(scene, spp=1, max_depth=2)


@pytest.mark.parametrize("dtype", deep_but([torch.float32], [torch.float32, torch.float64]))
def test_the_loss_of_a_pose_falls_by_its_gradient(dtype):
    """A dark disk that is off by half a pixel finds its place by its outline alone."""
    scene = load(dtype, camera=parallel(32), sky=DARK, disk={"type": "disk", "to_world": scale((0.5, 0.5, 0.5)),
                                                            "bsdf": diffuse(0.0)})
    renderer = unwarned_renderer(scene, spp=64, max_depth=1)
    with torch.no_grad():
        target = renderer(seed=9)
    start = scene.get_parameter("disk.to_world").detach().clone()
    offset = torch.tensor([0.05, -0.03, 0.0], dtype=dtype, requires_grad=True)
    optimizer = torch.optim.Adam([offset], lr=5e-3)
    for seed in range(25):
        pose = start + torch.nn.functional.pad(offset[:, None], (3, 0, 0, 1))
        image = functional_call(renderer, {"scene.disk.to_world": pose}, kwargs={"seed": seed})
        optimizer.zero_grad()
        ((image - target) ** 2).mean().backward()
        optimizer.step()
    assert offset[:2].norm() < 0.01, offset


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.TapeAdjoint()], ids=repr)
def test_what_small_jumps_add_to_the_pose_of_an_instance_is_not_lost_beside_a_large_one(adjoint, monkeypatch):
    """All places of an instance add to one pose, of which float32 would lose each that is 1e-8 of the sum."""
    scene = load(torch.float32, camera=parallel(), sky=DARK,
                 group={"type": "shapegroup", "square": rectangle((0, 0, 0), 0.5)},
                 shown={"type": "instance", "shapegroup": {"type": "ref", "id": "group"}})
    pose = scene.get_parameter("shown.to_world").requires_grad_()
    traced, weight = primary.differences, torch.linspace(1.0, 2.0, SIZE)

    def gradient(first: float, others: float) -> torch.Tensor:
        def chosen(*arguments) -> tuple[torch.Tensor, torch.Tensor]:
            shown, jump = traced(*arguments)
            strength = torch.full_like(jump, others)
            strength[:, 0] = first
            return shown, strength

        monkeypatch.setattr(primary, "differences", chosen)
        image = rb.Renderer(scene, spp=1024, max_depth=1, terms=["primary"], adjoint=adjoint)(seed=1)
        return torch.autograd.grad((image * weight).sum(), pose)[0].double()

    large, small, both = gradient(1e6, 0.0), gradient(0.0, 0.01), gradient(1e6, 0.01)
    assert small.abs().max() > 20 * 2.0**-23 * large.abs().max()
    assert (both - large - small).abs().max() < 2 * 2.0**-23 * large.abs().max()


def test_outlines_of_the_world_and_of_instances_are_looked_at_together():
    """A camera moves before a black square and an instance of another: both move over the image."""
    square, shown = rectangle((0.4, 0, 0), 0.25), {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}
    group = {"type": "shapegroup", "square": rectangle((-0.4, 0, 0), 0.25)}
    weight = torch.linspace(0.0, 1.0, SIZE, dtype=torch.float64).expand(SIZE, SIZE)
    found = {}
    for name, things in {"square": {"square": square}, "shown": {"group": group, "shown": shown},
                         "both": {"square": square, "group": group, "shown": shown}}.items():
        scene = load(camera=parallel(), sky=DARK, **things)
        found[name] = derivative(scene, "camera.to_world", along(0), weight, spp=1024)
    assert_close(found["both"], found["square"] + found["shown"], 0.03)


def test_the_edges_of_a_scene_are_searched_for_once_by_all_that_render_it(monkeypatch):
    scene, searched = solid(), []

    def counting(*arguments):
        searched.append(arguments)
        return edges_of(*arguments)

    monkeypatch.setattr(outline, "edges_of", counting)
    tangent = torch.zeros(4, 4, dtype=torch.float64)
    tangent[0, 3] = 1.0
    for terms in (("interior", "primary"), rb.Renderer(scene).terms):  # the cube moves; shadows are of everything
        derivatives = [rb.jvp(scene, {"cube.to_world": tangent}, spp=4, max_depth=2, terms=terms, compile=False)
                       for _ in range(2)]
        assert len(searched) <= 2 and torch.equal(*derivatives)


def test_edges_that_lie_on_other_bodies_are_divided_once_while_these_stay_where_they_are(monkeypatch):
    """A cube stands on a floor."""
    divided, divide = [], outline.edges_in_parts
    monkeypatch.setattr(outline, "edges_in_parts", lambda *arguments: divided.append(arguments) or divide(*arguments))
    cube = {"type": "cube", "to_world": translate((0, 0, 0.4)) @ scale((0.4, 0.4, 0.4))}
    scene = load(camera=sensor(4), sky=DARK, floor=rectangle((0, 0, 0), 3), cube=cube)
    camera, pose = (scene.get_parameter(name) for name in ("camera.to_world", "cube.to_world"))
    camera.requires_grad_()
    renderer = unwarned_renderer(scene, spp=4, max_depth=2, terms=["interior", "primary"])
    first, second = (torch.autograd.grad(renderer(seed=1)[0, 0].sum(), camera)[0] for _ in range(2))
    assert first.abs().max() > 0 and torch.equal(second, first) and len(divided) == 1
    with torch.no_grad():
        pose[0, 3] += 0.1
    moved, = torch.autograd.grad(renderer(seed=1)[0, 0].sum(), camera)
    assert not torch.equal(moved, first) and len(divided) == 2


def test_the_memory_plan_counts_jumps():
    uv, faces = grid(400, 400)
    sheet = {"type": "mesh", "vertex_positions": uv @ torch.eye(2, 3, dtype=uv.dtype), "faces": faces}
    scene = load(camera=sensor(8), sky=DARK, sheet=sheet)
    renderers = [rb.Renderer(scene, spp=1, max_depth=1, terms=terms) for terms in (["interior"], ["interior", "primary"])]
    before = [renderer.memory_plan().peak for renderer in renderers]
    assert before[0] == before[1]  # nothing moves
    scene.get_parameter("camera.to_world").requires_grad_()
    interior, both = (renderer.memory_plan().peak for renderer in renderers)
    assert both > interior


def test_jumps_are_the_same_bits_however_many_paths_are_traced_together():
    found = []
    for chunk in (None, 1024):
        scene = solid()
        pose = scene.get_parameter("cube.to_world").requires_grad_()
        renderer = unwarned_renderer(scene, spp=256, max_depth=2, chunk=chunk, terms=["primary"])
        image = renderer(seed=1)
        found.append(torch.autograd.grad((image * cotangent(image.detach())).sum(), pose)[0])
    assert torch.equal(*found)
