"""Large steps, the optimiser for them, and losses of meshes, against closed forms and dense matrices."""

import copy
import math

import pytest
import torch
import trimesh
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.gradients import relative_error
from tests.scenes import load, sensor


def tensors(mesh: trimesh.Trimesh, dtype: torch.dtype = torch.float64):
    return torch.tensor(mesh.vertices, dtype=dtype), torch.tensor(mesh.faces)


@pytest.fixture
def ball():
    return tensors(trimesh.creation.icosphere(2))


def dense_laplacian(faces: torch.Tensor, count: int) -> torch.Tensor:
    adjacency = torch.zeros(count, count, dtype=torch.float64)
    for a, b, c in faces.tolist():
        for i, j in ((a, b), (b, c), (c, a)):
            adjacency[i, j] = adjacency[j, i] = 1
    return adjacency.sum(1).diag() - adjacency


def test_vertices_solve_the_equation_of_the_reference(ball):
    vertices, faces = ball
    system, u = rb.optim.LargeSteps(faces, vertices, smoothness=3.0), torch.randn_like(vertices)
    matrix = torch.eye(len(vertices)).double() + 3.0 * dense_laplacian(system.place[faces], len(vertices))
    expected = torch.linalg.solve(matrix, u)
    assert expected.abs().max() > 0.05
    assert relative_error(system(u), expected[system.place]) < 1e-12


def test_its_derivatives_are_those_of_differences():
    vertices, faces = tensors(trimesh.creation.box())
    u = torch.rand(8, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(rb.optim.LargeSteps(faces, vertices), (u,), check_forward_ad=True)
    assert torch.autograd.gradgradcheck(rb.optim.LargeSteps(faces, vertices), (u,))


@pytest.mark.parametrize("dtype, tolerance", [(torch.float64, 1e-12), (torch.float32, 2e-5)], ids=str)
def test_what_is_registered_leaves_the_vertices_as_they_are(dtype, tolerance):
    vertices, faces = tensors(trimesh.creation.icosphere(2), dtype)
    seam = torch.cat([faces, faces + len(vertices)])  # the same ball twice: each place has two vertices
    sky = {"type": "constant"}
    twice = {"type": "mesh", "vertex_positions": torch.cat([vertices, vertices]), "faces": seam}
    mesh = load(dtype, sensor=sensor(), sky=sky, thing=twice).thing
    before = mesh.vertex_positions.detach().clone()
    parametrize.register_parametrization(mesh, "vertex_positions", rb.optim.LargeSteps(mesh.faces, mesh.vertex_positions))
    assert mesh.parametrizations.vertex_positions.original.shape == vertices.shape
    torch.testing.assert_close(mesh.vertex_positions, before, rtol=0, atol=tolerance)
    other = copy.deepcopy(mesh)
    with torch.no_grad():
        other.parametrizations.vertex_positions.original += 0.1
    torch.testing.assert_close(other.vertex_positions, mesh.vertex_positions + 0.1, rtol=0, atol=2 * tolerance)


def test_a_seam_whose_sides_differ_by_rounding_does_not_open():
    vertices, faces = tensors(trimesh.creation.icosphere(2), torch.float32)
    other_side = vertices * (1 + 1e-7 * torch.randn_like(vertices))
    assert not torch.equal(other_side, vertices)
    system = rb.optim.LargeSteps(torch.cat([faces, faces + len(vertices)]), torch.cat([vertices, other_side]))
    one, other = system(torch.randn(system.count, 3)).chunk(2)
    assert system.count == len(vertices) and torch.equal(one, other)
    assert one.std() > 0.01


def test_bad_arguments_are_named(ball):
    vertices, faces = ball
    with pytest.raises(ValueError, match="smoothness must not be negative, got -1"):
        rb.optim.LargeSteps(faces, vertices, -1)
    with pytest.raises(ValueError, match="vertex 161, and there are 5"):
        rb.optim.LargeSteps(faces, vertices[:5])
    with pytest.raises(ValueError, match="lr must be positive"):
        rb.optim.AdamUniform([vertices.requires_grad_()], lr=0)


def test_a_step_is_in_proportion_to_the_gradient():
    x = torch.zeros(4, 3, dtype=torch.float64, requires_grad=True)
    optimizer = rb.optim.AdamUniform([x], lr=0.5)
    gradient = torch.randn(4, 3, dtype=torch.float64)
    x.grad = gradient.clone()
    optimizer.step()
    torch.testing.assert_close(x.detach(), -0.5 * gradient / gradient.abs().max(), rtol=1e-9, atol=0)


def test_adam_uniform_is_adam_for_one_number():
    one, other = (torch.tensor([2.0], dtype=torch.float64, requires_grad=True) for _ in range(2))
    optimizers = rb.optim.AdamUniform([one], lr=0.1, eps=1e-8), torch.optim.Adam([other], lr=0.1, eps=1e-8)
    for _ in range(20):
        for optimizer, x in zip(optimizers, (one, other)):
            optimizer.zero_grad()
            optimizer.step(lambda x=x: (x.sin() ** 2).sum().backward())
    torch.testing.assert_close(one, other, rtol=1e-12, atol=0)
    assert one.item() != 2.0


def test_losses_of_a_plane_are_zero_and_those_of_a_cube_are_by_hand():
    plane = torch.tensor([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]).double()
    faces = torch.tensor([[0, 1, 2], [1, 3, 2]])
    assert rb.optim.normal_consistency_loss(plane, faces) == 0
    folded = plane.clone()
    folded[3] = torch.tensor([0.5, 0.5, math.sqrt(0.5)])  # at a right angle
    assert rb.optim.normal_consistency_loss(folded, faces).item() == pytest.approx(1.0, abs=1e-12)
    # Of each vertex the mean of its neighbours: the others, but for the far ends of the diagonal, which lack each other.
    ends = [plane[[1, 2]].mean(0) - plane[0], plane[[0, 2, 3]].mean(0) - plane[1], plane[[0, 1, 3]].mean(0) - plane[2],
            plane[[1, 2]].mean(0) - plane[3]]
    assert rb.optim.laplacian_loss(plane, faces).item() == pytest.approx(sum(float(end @ end) for end in ends) / 4)
    assert rb.optim.normal_consistency_loss(plane, faces[:1]) == 0


def test_losses_have_derivatives():
    vertices, faces = tensors(trimesh.creation.icosphere(1))  # every entry is moved
    vertices = (vertices + 0.05 * torch.randn_like(vertices)).requires_grad_()
    for loss in (rb.optim.laplacian_loss, rb.optim.normal_consistency_loss):
        assert torch.autograd.gradcheck(lambda v, loss=loss: loss(v, faces), (vertices,))
        assert torch.autograd.grad(loss(vertices, faces), vertices)[0].abs().max() > 1e-5
