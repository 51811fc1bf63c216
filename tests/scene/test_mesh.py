"""Meshes have a pose, and normals that follow their vertices if they are asked to."""

import pytest
import torch

import torch_radbp as rb
from tests.scenes import load, rectangle, rgb, sensor
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.shape.normals import angle_weighted_normals

FIRST = translate((0.1, -0.2, 0.3)) @ rotate((1, 2, 0.5), 40) @ scale((0.5, 0.4, 0.3))
SECOND = translate((-0.3, 0.2, 0.1)) @ rotate((0.3, -1, 2), 25) @ scale((0.3, 0.6, 0.5))
SHEET = {"vertex_positions": torch.tensor([[-1.0, -1, 0], [1, -1, 0.3], [1.1, 1, -0.2], [-0.9, 1, 0.5], [0, 0, 0.4]]),
         "faces": torch.tensor([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])}
FILE = "v -1 -1 0\nv 1 -1 0.3\nv 1 1 0.2\nvn 0 0.6 0.8\nvn 0 0 1\nf 1//1 2//2 3//1\n"


def shape_of(**attributes) -> torch.nn.Module:
    return load(sensor=sensor(2), sky={"type": "constant"}, shape=attributes).shape


@pytest.fixture(params=["cube", "obj", "mesh", "smooth mesh"])
def attributes(request, tmp_path):
    if request.param == "obj":
        (tmp_path / "m.obj").write_text(FILE)
        return {"type": "obj", "filename": str(tmp_path / "m.obj")}
    if request.param == "cube":
        return {"type": "cube"}
    return {"type": "mesh", "recompute_normals": request.param == "smooth mesh"} | SHEET


def test_the_pose_of_a_mesh_is_the_one_that_it_might_have_been_loaded_with(attributes):
    mesh, other = shape_of(**attributes, to_world=FIRST), shape_of(**attributes, to_world=SECOND)
    assert torch.equal(mesh.triangles().vertices, mesh.vertex_positions)  # in world space, as Mitsuba's
    with torch.no_grad():
        mesh.to_world.copy_(torch.as_tensor(SECOND))
    torch.testing.assert_close(mesh.triangles().vertices, other.vertex_positions, rtol=0, atol=1e-6)
    assert (mesh.triangles().vertices - mesh.vertex_positions).abs().max() > 0.1
    if other.triangles().normals is not None:
        torch.testing.assert_close(mesh.triangles().normals, other.triangles().normals, rtol=0, atol=1e-6)


def test_a_pose_that_stands_still_has_its_derivatives_and_changes_no_bit(attributes):
    mesh = shape_of(**attributes, to_world=FIRST)
    before = mesh.triangles()

    def vertices(pose: torch.Tensor) -> torch.Tensor:
        return torch.func.functional_call(_Triangles(mesh), {"mesh.to_world": pose}, ())

    assert torch.equal(vertices(mesh.to_world.clone().requires_grad_()), before.vertices)
    assert torch.autograd.gradcheck(vertices, mesh.to_world.clone().requires_grad_(), check_forward_ad=True)


class _Triangles(torch.nn.Module):
    def __init__(self, mesh: torch.nn.Module):
        super().__init__()
        self.mesh = mesh

    def forward(self) -> torch.Tensor:
        return self.mesh.triangles().vertices


def test_recomputed_normals_are_those_of_the_moved_vertices_and_no_parameter():
    mesh = shape_of(type="mesh", recompute_normals=True, **SHEET)
    assert {name for name, _ in mesh.named_parameters() if "bsdf" not in name} == {"vertex_positions", "to_world"}
    with torch.no_grad():
        mesh.vertex_positions[4, 2] += 0.7
    expected = angle_weighted_normals(mesh.vertex_positions, mesh.faces)
    assert torch.equal(mesh.triangles().normals, expected)
    assert (expected - angle_weighted_normals(SHEET["vertex_positions"].double(), SHEET["faces"])).abs().max() > 0.1


def test_smooth_normals_have_derivatives_that_triangles_without_area_do_not_spoil():
    faces = torch.cat([SHEET["faces"], torch.tensor([[0, 0, 1], [2, 2, 2], [5, 6, 5]])])
    loose = torch.tensor([[3.0, 3, 3], [3.0, 3, 4]])  # on which no proper triangle stands
    vertices = torch.cat([SHEET["vertex_positions"], loose]).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda v: angle_weighted_normals(v, faces), vertices, check_forward_ad=True)
    normals = angle_weighted_normals(vertices, faces)
    assert torch.equal(normals[5:].detach(), torch.tensor([[1.0, 0, 0]] * 2, dtype=torch.float64))
    tiny = angle_weighted_normals(1e-9 * vertices.float(), faces)
    torch.testing.assert_close(tiny[:5].double(), normals[:5], rtol=0, atol=1e-5)


def test_an_image_depends_on_positions_by_their_normals_too():
    """A vertex that moves in its plane leaves the normals; one that moves out of it turns them."""
    def gradient(**attributes) -> torch.Tensor:
        scene = load(camera=sensor(6, fov=20), lamp={"type": "directional", "direction": [0.5, 0.2, -1],
                     "irradiance": rgb(3, 3, 3)}, shape={"type": "mesh", "bsdf": {"type": "diffuse"}} | SHEET | attributes)
        positions = scene.get_parameter("shape.vertex_positions").requires_grad_()
        rb.render(scene, spp=4, max_depth=2, seed=3).sum().backward()
        return positions.grad

    frozen = angle_weighted_normals(SHEET["vertex_positions"].double(), SHEET["faces"])
    smooth, still = gradient(recompute_normals=True), gradient(vertex_normals=frozen)
    assert torch.isfinite(smooth).all() and (smooth - still).abs().max() > 0.1 * smooth.abs().max() > 0


def test_flat_and_smooth_at_once_is_refused(tmp_path):
    (tmp_path / "m.obj").write_text(FILE)
    with pytest.raises(rb.SceneError, match="face_normals shades flat and recompute_normals shades smooth: choose one"):
        shape_of(type="obj", filename=str(tmp_path / "m.obj"), face_normals=True, recompute_normals=True)


def test_normals_that_are_given_and_recomputed_are_refused():
    with pytest.raises(rb.SceneError, match="leave vertex_normals out"):
        shape_of(type="mesh", vertex_normals=torch.ones(5, 3), recompute_normals=True, **SHEET)


def test_smooth_normals_of_a_file_are_those_of_the_mesh_in_world_space(tmp_path):
    """As in Mitsuba: a transform that stretches the mesh turns them otherwise than it turns normals."""
    corners = SHEET["vertex_positions"].tolist()
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in SHEET["faces"].tolist()]
    (tmp_path / "m.obj").write_text("\n".join(lines) + "\n")
    mesh = shape_of(type="obj", filename=str(tmp_path / "m.obj"), to_world=scale((3, 0.2, 1)) @ rotate((1, 2, 0.5), 40))
    expected = angle_weighted_normals(mesh.vertex_positions, mesh.faces)
    torch.testing.assert_close(mesh.vertex_normals, expected, rtol=0, atol=1e-6)


def test_a_moved_mesh_is_saved_where_it_is(tmp_path):
    scene = load(sensor=sensor(2), sky={"type": "constant"}, floor=rectangle((0, 0, 0)),
                 shape={"type": "cube", "to_world": FIRST})
    with torch.no_grad():
        scene.shape.to_world.copy_(torch.as_tensor(SECOND))
    rb.save(scene, tmp_path / "moved.xml")
    saved = rb.load(tmp_path / "moved.xml")
    assert saved.shape.type == "ply" and len(saved.shape.faces) == 12
    moved = scene.shape.triangles().vertices.detach().float()
    torch.testing.assert_close(saved.shape.vertex_positions, moved, rtol=0, atol=1e-6)
