"""Shapes in recipes: vertices move by large steps, normals follow, and the true surface may have other triangles."""

import math

import pytest
import torch
import trimesh
from rich.console import Console
from safetensors.torch import load_file

import torch_radbp as rb
from torch_radbp.formats.image import save_image
from torch_radbp.training.commands.optimize import recovered_table
from torch_radbp.training.recipe_file import read_recipe
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.recovery.shapes import Surface, chamfer_distance
from torch_radbp.training.run import run

BALL = """    <shape type="ply" id="ball">
        <string name="filename" value="$ball"/>
        <transform name="to_world"><scale value="2"/><translate y="0.6" z="0.5"/></transform>
        <ref id="paint"/>
    </shape>
    <emitter type="constant" id="sky"/>
</scene>"""
SHAPE = """name = "ball.vertex_positions"
parametrisation = "large_steps"
smoothness = 5
truth = "large.ply"
optimizer = { name = "adam_uniform", learning_rate = 0.02 }
"""


def surface(mesh: trimesh.Trimesh) -> Surface:
    return Surface(torch.tensor(mesh.vertices), torch.tensor(mesh.faces))


@pytest.fixture
def shape_recipe(folder, edit_recipe):
    """A ball of radius 0.3 in the scene, from which one of radius 0.44 is to be found: the target's."""
    for name, radius in (("small", 0.15), ("large", 0.22)):
        trimesh.creation.icosphere(1 if name == "small" else 2, radius=radius).export(folder / f"{name}.ply")
    width = '<default name="width" value="8"/>'
    scene = (folder / "scene.xml").read_text().replace(width, f'{width}<default name="ball" value="large.ply"/>')
    (folder / "scene.xml").write_text(scene.replace("</scene>", BALL))
    image = rb.render(rb.load(folder / "scene.xml"), spp=256, seed=123, max_depth=2, caster="brute")[0].detach()
    assert image.std() > 0.05
    save_image(folder / "target.exr", image)
    edit_recipe('name = "paint.reflectance.value"\ninitial = 0.5\nbounds = [0.0, 1.0]\ntruth = "scene"\n', SHAPE)
    return edit_recipe("steps = 6", 'steps = 6\nvariables = { ball = "small.ply" }')


def test_the_distance_of_concentric_balls_is_that_of_their_radii():
    one, other = (surface(trimesh.creation.icosphere(4, radius=radius)) for radius in (1.0, 1.1))
    assert chamfer_distance(one, other) == pytest.approx(0.1, rel=0.01)
    assert chamfer_distance(one, one) < 1e-9


def test_the_distance_of_a_surface_from_a_part_of_it_counts_what_is_missing():
    """Of a square of side 2 the left half: nothing there is far, and the right half is off by 1/2 on average."""
    corners = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=torch.float64)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    half = corners.clone()
    half[1:3, 0] = 0
    assert chamfer_distance(Surface(corners, faces), Surface(half, faces)) == pytest.approx(0.25 / 2, rel=0.05)


def test_points_of_a_surface_are_spread_by_area():
    mesh = trimesh.creation.box((1, 2, 3))
    points = surface(mesh).points(2000)
    assert (points.abs() <= torch.tensor([0.5, 1.0, 1.5], dtype=torch.float64) + 1e-12).all()
    on_ends = ((points[:, 2].abs() - 1.5).abs() < 1e-9).double().mean()
    assert on_ends == pytest.approx(2 * 2 / mesh.area, abs=0.01)


def test_a_ball_grows_to_the_true_one(shape_recipe, folder):
    overrides = ["steps=10", "parameters.0.optimizer.learning_rate=0.25", "render.spp=16", "render.max_depth=2",
                 "report.spp=64", "render.seed=4"]  # by which it ends well below the bounds; others end closer
    summary, report = run(shape_recipe, overrides, folder / "run", False, Console(quiet=True))
    shape = summary["parameters"][0]
    assert shape["chamfer_before"] == pytest.approx(0.14, rel=0.15), "balls of few triangles, of radii 0.3 and 0.44"
    assert shape["chamfer"] < 0.8 * shape["chamfer_before"], "one view shows one side"
    assert summary["images"][0]["rmse"] < 0.7 * summary["images"][0]["rmse_before"]
    assert "Chamfer" in report.read_text(encoding="utf-8")
    console = Console(width=100, record=True, file=open("/dev/null", "w"))
    console.print(recovered_table(summary))
    assert f"{shape['chamfer']:.2g}" in console.export_text()
    written = rb.load(folder / "run" / "scene" / "scene.xml").get_parameter("ball.vertex_positions").detach()
    torch.testing.assert_close(written, load_file(folder / "run" / "parameters.safetensors")["ball.vertex_positions"])


def test_normals_follow_the_vertices_that_a_recipe_moves(shape_recipe):
    recovery = Recovery(read_recipe(shape_recipe))
    ball = recovery.scene.ball
    with torch.no_grad():
        flat = torch.tensor([1.0, 1.0, 0.01]) * ball.vertex_positions
        ball.vertex_positions = flat
    normals = ball.triangles().normals.detach()
    inside = flat[:, :2].sub(flat[:, :2].mean(0)).norm(dim=1) < 0.2
    assert inside.sum() > 8
    assert normals[inside, 2].abs().min() > math.cos(0.3), "a flattened ball faces up and down"


def test_a_truth_that_is_no_mesh_is_named(shape_recipe):
    with pytest.raises(ValueError, match="target.exr: unknown kind of mesh"):
        Recovery(read_recipe(shape_recipe, ["parameters.0.truth=target.exr"]))
