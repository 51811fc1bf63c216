"""Another mesh in the place of one that is being optimised: what belongs to it is carried over."""

import warnings

import pytest
import torch
import trimesh
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.scenes import diffuse, load, rgb, sensor
from torch_radbp.optim.closest import closest_in_triangles, closest_points


def finer(vertices, faces):
    """Each triangle in four."""
    return trimesh.remesh.subdivide(vertices, faces)


def ball(**attributes) -> dict:
    mesh = trimesh.creation.icosphere(2)
    return {"type": "mesh", "vertex_positions": torch.tensor(mesh.vertices), "faces": torch.tensor(mesh.faces),
            "bsdf": diffuse(0.6, 0.5, 0.4)} | attributes


def scene_of(**attributes) -> rb.Scene:
    return load(sensor=sensor(12), thing=ball(**attributes), sky={"type": "constant", "radiance": rgb(1, 1.2, 0.9)})


def test_closest_points_are_those_of_all_triangles():
    mesh = trimesh.creation.icosphere(2)
    vertices, faces = torch.tensor(mesh.vertices), torch.tensor(mesh.faces)
    vertices = vertices * torch.tensor([3.0, 1.0, 0.1], dtype=torch.float64)  # triangles of all sizes
    points = torch.randn(300, 3, dtype=torch.float64) * 2
    found = closest_points(points, vertices, faces)
    _, distance = closest_in_triangles(points[:, None], vertices[faces][None].expand(300, -1, -1, -1))
    near = found.of_vertices(vertices, faces)
    torch.testing.assert_close((near - points).norm(dim=1), distance.min(1).values, rtol=1e-12, atol=1e-12)
    assert (found.weights >= 0).all()
    torch.testing.assert_close(found.weights.sum(1), torch.ones(300, dtype=torch.float64))


def test_the_image_is_that_of_before():
    scene = scene_of()
    before = rb.render(scene, spp=4, max_depth=3, seed=1)
    rb.optim.remesh(scene.thing, finer)
    assert len(scene.thing.faces) == 4 * 320
    torch.testing.assert_close(rb.render(scene, spp=4, max_depth=3, seed=1), before, rtol=1e-6, atol=1e-6)


@pytest.mark.filterwarnings("ignore:the faces of `thing` point inwards")  # so that it is black, unless they are turned
@pytest.mark.parametrize("way", ["returned", "given"])
def test_a_mesh_of_trimesh_comes_in_the_place(way):
    """Returned by the remesher, or given itself: of a mesh that stands elsewhere than where it was loaded, and turned."""
    scene = scene_of(flip_normals=True, to_world=rb.look_at([0.1, 0, 0], [0, 0.2, 1], [0, 1, 0]))
    scene.thing.to_world.data[:3, 3] += torch.tensor([0.1, -0.05, 0.2]).to(scene.thing.to_world)
    before, old = rb.render(scene, spp=4, max_depth=3, seed=1), scene.thing.vertex_positions.detach().clone()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.SceneWarning)  # of the material
        finer_mesh = scene.thing.to_trimesh().subdivide()
    rb.optim.remesh(scene.thing, finer_mesh if way == "given" else lambda v, f: trimesh.Trimesh(*finer(v, f), process=False))
    assert len(scene.thing.faces) == 4 * 320
    torch.testing.assert_close(scene.thing.vertex_positions.detach()[:162].sort(0).values, old.sort(0).values)
    torch.testing.assert_close(rb.render(scene, spp=4, max_depth=3, seed=1), before, rtol=1e-5, atol=1e-5)


def test_coordinates_and_attributes_are_those_of_the_closest_points():
    scene = scene_of(vertex_texcoords=torch.rand(162, 2, dtype=torch.float64))
    mesh = scene.thing
    mesh.add_attribute("vertex_height", mesh.vertex_positions.detach()[:, 2:].clone())
    mesh.add_attribute("face_side", (mesh.vertex_positions.detach()[mesh.faces].mean(1)[:, :1] > 0).double())
    old = mesh.vertex_texcoords.detach().clone()
    kept = {tuple(place): uv for place, uv in zip(mesh.vertex_positions.tolist(), old.tolist())}
    rb.optim.remesh(mesh, finer)
    found = [kept.get(tuple(place)) for place in mesh.vertex_positions.tolist()]
    assert sum(uv is not None for uv in found) == 162
    for uv, carried in zip(found, mesh.vertex_texcoords.tolist()):
        assert uv is None or uv == pytest.approx(carried, abs=1e-9)
    torch.testing.assert_close(mesh.vertex_height[:, 0], mesh.vertex_positions[:, 2], rtol=0, atol=1e-9)
    middle = mesh.vertex_positions[mesh.faces].mean(1)[:, 0]
    side = torch.where(middle.abs() > 0.1, middle > 0, mesh.face_side[:, 0] > 0.5)
    assert torch.equal(mesh.face_side[:, 0] > 0.5, side)


@pytest.mark.parametrize("smooth", [False, True])
def test_an_optimizer_goes_on_with_its_moments(smooth):
    scene = scene_of()
    mesh = scene.thing
    mesh.vertex_positions.requires_grad_()
    if smooth:
        steps = rb.optim.LargeSteps(mesh.faces, mesh.vertex_positions, 4.0)
        parametrize.register_parametrization(mesh, "vertex_positions", steps)
    moving = [parameter for parameter in mesh.parameters() if parameter.requires_grad]
    optimizer = rb.optim.AdamUniform(moving, lr=0.01)
    moving[0].grad = moving[0].detach().clone()  # so that the moment is the place
    optimizer.step()
    moment = optimizer.state[moving[0]]["exp_avg"].clone()
    rb.optim.remesh(mesh, finer, optimizer)
    now, = (parameter for parameter in mesh.parameters() if parameter.requires_grad)
    assert optimizer.param_groups[0]["params"] == [now] and now is not moving[0] and moving[0] not in optimizer.state
    state = optimizer.state[now]
    assert state["step"] == 1 and state["exp_avg"].shape == now.shape and len(now) > len(moment)
    assert state["exp_avg"].abs().max() == pytest.approx(float(moment.abs().max()), rel=0.05)
    if smooth:
        assert mesh.parametrizations.vertex_positions[0].smoothness == 4.0
    rb.render(scene, spp=2, max_depth=2).sum().backward()
    optimizer.step()
    assert mesh.vertex_positions.isfinite().all()


def test_what_cannot_be_remeshed_is_named():
    scene = load(sensor=sensor(), sky={"type": "constant"}, thing={"type": "sphere"}, mesh=ball())
    with pytest.raises(TypeError, match="got Sphere"):
        rb.optim.remesh(scene.thing, finer)
    with pytest.raises(ValueError, match="degenerate"):
        rb.optim.remesh(scene.mesh, lambda v, f: (v * 0, f))
    parametrize.register_parametrization(scene.mesh, "vertex_positions", torch.nn.Identity())
    with pytest.raises(ValueError, match="parametrisation Identity"):
        rb.optim.remesh(scene.mesh, finer)


BAD = {
    "nothing": (lambda v, f: None, r"must return vertices \(V, 3\) and faces \(F, 3\), got NoneType"),
    "one": (lambda v, f: (v,), "got 1 values"),
    "three": (lambda v, f: (v, f, f), "got 3 values"),
    "a scene": (lambda v, f: trimesh.Scene(trimesh.Trimesh(v, f)), "got Scene"),
    "a mesh without faces": (lambda v, f: trimesh.Trimesh(v, f[:0]), r"one or more of each, got \(162, 3\) and \(0, 3\)"),
    "words": (lambda v, f: ("v", f), "got str and ndarray"),
    "nothing in a pair": (lambda v, f: (v, None), "got ndarray and NoneType"),
    "ragged": (lambda v, f: (v, [[0, 1], [0, 1, 2]]), "got ndarray and list"),
    "flat vertices": (lambda v, f: (v[:, :2], f), r"one or more of each, got \(162, 2\) and \(320, 3\)"),
    "quads": (lambda v, f: (v, f[:, [0, 1, 2, 2]]), r"got \(162, 3\) and \(320, 4\)"),
    "empty": (lambda v, f: (v, f[:0]), r"got \(162, 3\) and \(0, 3\)"),
    "faces of numbers": (lambda v, f: (v, f * 1.0), "whole numbers, got torch.float64 and torch.float64"),
    "exchanged": (lambda v, f: (f, v), "whole numbers, got torch.int64 and torch.float64"),
    "NaN": (lambda v, f: (v * [float("nan"), 1, 1], f), "returned 162 of 162 vertices that are NaN or infinite"),
    "beyond the end": (lambda v, f: (v, f + 1), "returned faces of the vertices 1 to 162; there are 162, from 0 to 161"),
    "below zero": (lambda v, f: (v, f - 1), "returned faces of the vertices -1 to 160; there are 162"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("remesher, message", BAD.values(), ids=BAD)
def test_what_a_remesher_returns_is_checked_and_the_mesh_stays_as_it_was(remesher, message):
    scene = load(sensor=sensor(), sky={"type": "constant"}, mesh=ball())
    before = scene.mesh.vertex_positions
    with pytest.raises(ValueError, match=message):
        rb.optim.remesh(scene.mesh, remesher)
    assert scene.mesh.vertex_positions is before and len(scene.mesh.faces) == 320
    with pytest.raises(TypeError, match="a function of vertices and faces, or a trimesh.Trimesh, got NoneType"):
        rb.optim.remesh(scene.mesh, None)


def test_lists_and_small_integers_are_taken():
    scene = load(sensor=sensor(), sky={"type": "constant"}, mesh=ball())
    rb.optim.remesh(scene.mesh, lambda v, f: (v.tolist(), f[:300].astype("int32")))
    assert len(scene.mesh.faces) == 300
