"""Grids of distances: the surface, its normals and derivatives, what is refused, and what is remembered."""

import numpy as np
import pytest
import torch
from torch.autograd import forward_ad

import torch_radbp as rb
from tests.scenes import load, sensor
from tests.shape.surfaces import meets
from torch_radbp.io.values.transform import scale
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.packing.pack import pack
from torch_radbp.shape import sdfgrid, zero_set
from torch_radbp.shape.marching_cubes import case_table, faces, fan, loops
from torch_radbp.shape.zero_set import vertices, zero_net

RADIUS = 0.35


def ball(depth: int, height: int, width: int, middle=(0.5, 0.5, 0.5)) -> torch.Tensor:
    """Distances from a ball in the unit cube."""
    z, y, x = torch.meshgrid(*(torch.linspace(0, 1, count, dtype=torch.float64) for count in (depth, height, width)),
                             indexing="ij")
    return (torch.stack([x - middle[0], y - middle[1], z - middle[2]]).norm(dim=0) - RADIUS)[..., None]


def noise(*size: int) -> torch.Tensor:
    """Values of both signs, which make every case of marching cubes."""
    return torch.randn(*size, 1, generator=torch.Generator().manual_seed(2), dtype=torch.float64)


def shape(grid=None, **attributes) -> sdfgrid.SDFGrid:
    given = {"type": "sdfgrid"} | ({} if grid is None else {"grid": grid}) | attributes
    return load(sensor=sensor(2), sky={"type": "constant"}, shape=given).shape


def edges_of(triangles: torch.Tensor) -> torch.Tensor:
    """The directed edges of triangles, (3 F, 2)."""
    return torch.cat([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def test_triangles_of_every_case_lie_in_the_cell_and_cut_every_edge_whose_ends_differ():
    table = case_table()
    assert table.count.sum() == 820 and table.count.max() == 5
    for case in range(256):
        cut = {edge for face in faces() for (one, edge), (other, _) in zip(face, face[1:] + face[:1])
               if (case >> one & 1) != (case >> other & 1)}
        assert {edge for loop in loops(case) for edge in loop} == cut
        assert sum(len(fan(loop)) for loop in loops(case)) == table.count[case]


@pytest.mark.parametrize("normals", ["smooth", "analytic"])
def test_vertices_are_on_the_surface_and_normals_point_outwards(normals):
    surface = shape(ball(33, 31, 35), normals=normals).triangles()
    outwards = surface.vertices - 0.5
    # The interpolant of a ball's distances is off by h^2 / 8 r, with h the diagonal of a voxel.
    assert ((outwards.norm(dim=1) - RADIUS).abs() < 3 / (8 * 30**2 * RADIUS)).all()
    outwards = torch.nn.functional.normalize(outwards, dim=1)
    assert (surface.normals * outwards).sum(1).min() > (0.9999 if normals == "smooth" else 0.997)
    first, second, third = surface.vertices[surface.faces].unbind(1)
    areas = torch.linalg.cross(second - first, third - first) / 2
    assert ((areas * (first - 0.5)).sum(1) > 0).all()
    assert float((areas * first).sum() / 3) == pytest.approx(4 / 3 * torch.pi * RADIUS**3, rel=0.01)


def test_the_surface_has_no_cracks_whatever_the_signs():
    """Every edge that is not on a face of the cube belongs to two triangles, which run along it in opposite directions."""
    for size in ((2, 3, 2), (62, 5, 4)):  # on a finer lattice, and on the grid's own
        surface = shape(noise(*size)).triangles()
        edges, count = edges_of(surface.faces).unique(dim=0, return_counts=True)
        assert (count == 1).all()
        one, other = ({tuple(edge) for edge in part.tolist()} for part in (edges, edges.flip(1)))
        ends = surface.vertices[torch.tensor(sorted(one - other))]
        on_the_cube = ((ends == 0) | (ends == 1))
        assert (on_the_cube[:, 0] & on_the_cube[:, 1]).any(1).all()
        assert len(one & other) > 1000  # of both kinds


def test_the_surface_stays_where_it_is_on_a_finer_lattice():
    """All vertices are where the trilinear interpolant is zero."""
    made = shape(noise(4, 5, 6))
    values, points = made.grid[..., 0], made.triangles().vertices
    found = torch.nn.functional.grid_sample(values[None, None], (2 * points - 1).view(1, 1, 1, -1, 3), align_corners=True)
    assert found.abs().max() < 1e-12


@pytest.fixture
def lattice_of_the_grid(monkeypatch):
    """No finer one, so that vertices are few."""
    monkeypatch.setattr(zero_set, "LEAST_CELLS", 1)


def test_positions_follow_the_values_as_the_implicit_function_theorem_says(lattice_of_the_grid):
    """d p = -d f / f' along an edge."""
    values, tangent = noise(8, 5, 6)[..., 0].chunk(2)
    net = zero_net(values, of_voxels=False)

    def points(moved):
        return (net.voxel + vertices(moved, net)[0].place.stack()).sum(1)

    with forward_ad.dual_level():
        change = forward_ad.unpack_dual(points(forward_ad.make_dual(values, tangent))).tangent
    step = 1e-6
    differences = (points(values + step * tangent) - points(values - step * tangent)) / (2 * step)
    assert len(differences) > 100 and differences.abs().min() > 1e-4
    torch.testing.assert_close(change, differences, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("normals", ["smooth", "analytic"])
def test_gradcheck_of_the_triangles(normals, lattice_of_the_grid):
    grid = shape(ball(3, 4, 3) + 0.1 * noise(3, 4, 3), normals=normals)
    make, arguments = grid.connections()
    net = make(arguments[0].detach(), *arguments[1:])
    weights = torch.randn(len(net.axis), 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64)

    def surface(values, pose):
        triangles = torch.func.functional_call(Told(grid, net), {"shape.grid": values, "shape.to_world": pose}, ())
        return (triangles.vertices * weights).sum(0), (triangles.normals * weights).sum(0)

    pose = torch.eye(4, dtype=torch.float64) + 0.1 * noise(4, 4)[..., 0] * torch.tensor([1.0, 1, 1, 0])[:, None]
    inputs = grid.grid.detach().clone().requires_grad_(), pose.requires_grad_()
    assert torch.autograd.gradcheck(surface, inputs, atol=1e-6, rtol=1e-4)


class Told(torch.nn.Module):
    """A shape as a function of its parameters, with its triangles held."""

    def __init__(self, shape, net):
        super().__init__()
        self.shape, self.net = shape, net

    def forward(self):
        return self.shape.triangles(self.net)


def test_a_mirroring_pose_keeps_normals_outwards():
    si = meets((-0.5, 0.5, 5), (0, 0, -1), {"shape": {"type": "sdfgrid", "grid": ball(40, 40, 40),
                                                     "to_world": scale((-1, 1, 1))}})
    assert si.valid.all() and abs(float(si.t) - 4.15) < 1e-3
    normal = si.frame.n.stack()[0]
    torch.testing.assert_close(normal, torch.tensor([0.0, 0, 1], dtype=normal.dtype), rtol=0, atol=1e-3)


@pytest.mark.parametrize("attributes, message", [
    ({"grid": None}, "an sdfgrid needs either filename or grid"),
    ({"normals": "flat"}, "normals 'flat' is not known; known: analytic, smooth"),
    ({"grid": np.ones((3, 3, 3))}, r"grid must have shape \(Z, Y, X, 1\), got \(3, 3, 3\)"),
    ({"grid": np.ones((3, 3, 3, 1))}, "grid must have values below 0 .inside. and others, or there is no surface; they are "
                                      "from 1 to 1"),
    ({"grid": -np.ones((3, 3, 3, 1))}, "grid must have values below 0"),
    ({"grid": np.zeros((1, 3, 3, 1))}, r"grid must have at least 2 values along each axis, got \(1, 3, 3\)"),
    ({"grid": np.full((2, 2, 2, 1), np.nan)}, "grid must be finite"),
    ({"watertight": True}, "sdfgrid has no attribute 'watertight'"),
])
def test_bad_attributes(attributes, message):
    with pytest.raises(rb.SceneError, match=message):
        shape(**{"grid": ball(4, 4, 4)} | attributes)


def test_a_surface_that_vanishes_is_an_error():
    scene = load(sensor=sensor(2), sky={"type": "constant"}, shape={"type": "sdfgrid", "grid": ball(5, 5, 5)})
    scene.shape.grid.data += 10
    with pytest.raises(ValueError, match="the grid must have values below 0"):
        rb.render(scene, spp=1)


def test_triangles_are_found_again_only_if_the_grid_has_changed(monkeypatch):
    scene = load(sensor=sensor(2), sky={"type": "constant"}, shape={"type": "sdfgrid", "grid": ball(6, 6, 6)})
    calls, plain = [], sdfgrid.zero_net
    monkeypatch.setattr(sdfgrid, "zero_net", lambda *arguments: calls.append(1) or plain(*arguments))
    scene.shape.grid.requires_grad_()
    kept = PackCache()
    for expected in (1, 1):
        pack(scene, kept)
        kept = PackCache(kept.close())
        assert len(calls) == expected
    scene.shape.grid.data[2, 2, 2] -= 0.01
    triangles = pack(scene, kept).triangles
    assert triangles.vertices.p.x.requires_grad and len(calls) == 2
    assert len(triangles.corners[0]) == len(scene.shape.triangles().faces)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("normals", ["smooth", "analytic"])
@pytest.mark.parametrize("seed", range(6))
def test_values_of_zero_have_finite_derivatives(seed, normals, dtype):
    """Of grids of -1, 0 and 1, in which whole edges and voxels are zero: what has no direction has no derivative."""
    generator = torch.Generator().manual_seed(seed)
    values = torch.tensor([-1.0, 0.0, seed % 2, 0.0, 0.0])
    size = (2, 3, 5)[seed % 3]
    grid = values[torch.randint(0, 5, (size, size, size, 1), generator=generator)]
    grid[0, 0, 0] = -1.0
    shape = sdfgrid.SDFGrid(grid=grid, normals=normals).to(dtype)
    shape.grid.requires_grad_()
    triangles = shape.triangles()
    weights = torch.randn(triangles.vertices.shape, generator=generator).to(dtype)
    gradient, = torch.autograd.grad(((triangles.vertices + triangles.normals) * weights).sum(), shape.grid)
    assert bool(torch.isfinite(triangles.vertices).all() & torch.isfinite(triangles.normals).all())
    assert torch.allclose(triangles.normals.norm(dim=1), torch.ones((), dtype=dtype), atol=1e-5)
    assert float(gradient.abs().max()) < 1e7  # thousands of vertices whose normals turn within a hundredth of a voxel


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
@pytest.mark.parametrize("normals", ["smooth", "analytic"])
def test_a_signed_distance_cut_off_at_zero_renders_with_finite_derivatives(normals):
    """A band of -1 around a ball inside of zeros, as of a truncated field."""
    x = torch.linspace(-1, 1, 9)
    grid = torch.where(sum(part.square() for part in torch.meshgrid(x, x, x, indexing="ij")) < 0.3, -1.0, 0.0)[..., None]
    scene = load(sensor=sensor(6, (1.5, 1.2, 2.5), (0.5, 0.5, 0.5)), sky={"type": "constant", "radiance": 1.0},
                 ball={"type": "sdfgrid", "grid": grid, "normals": normals})
    values = scene.get_parameter("ball.grid").requires_grad_()
    gradient, = torch.autograd.grad(rb.render(scene, spp=2, max_depth=2, terms=["interior"]).sum(), values)
    assert 0 < float(gradient.abs().max()) < 1e6
