"""Recipes that recover poses: six numbers in the place of a (4, 4) matrix."""

import math

import pytest
import torch
from rich.console import Console

import torch_radbp as rb
from torch_radbp.formats.image import save_image
from torch_radbp.training.commands.optimize import recovered_table
from torch_radbp.training.recipe_file import read_recipe, write_recipe
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.recovery.rigid import PoseError, Rigid, motion_between, moved
from torch_radbp.training.run import run

COLOUR = 'name = "paint.reflectance.value"\ninitial = 0.5\nbounds = [0.0, 1.0]'
POSE = """name = "wall.to_world"
parametrisation = "rigid"
initial = { rotation = [2.0, -3.0, 4.0], translation = [0.05, 0.1, -0.04] }"""
MATRIX = rb.se3(torch.tensor([0.3, -0.8, 0.5]).double(), torch.tensor([1.0, 2.0, -0.5]).double()) @ torch.diag(
    torch.tensor([2.0, 0.5, 1.5, 1.0]).double()
)


def vector(*entries):
    return torch.tensor(entries, dtype=torch.float64)


def test_rotation_leaves_the_own_origin_where_it_is():
    turned = moved(MATRIX, vector(0.1, 0.2, -0.3), vector(0, 0, 0))
    assert torch.equal(turned[:, 3], MATRIX[:, 3])
    expected = torch.linalg.matrix_exp(torch.tensor([[0, 0.3, 0.2], [-0.3, 0, -0.1], [-0.2, 0.1, 0]]).double())
    torch.testing.assert_close(turned[:3, :3], expected @ MATRIX[:3, :3], atol=1e-7, rtol=0)


def test_translation_is_along_world_axes():
    shifted = moved(MATRIX, vector(0, 0, 0), vector(1, -2, 3))
    torch.testing.assert_close(shifted[:3, 3], MATRIX[:3, 3] + vector(1, -2, 3))
    torch.testing.assert_close(shifted[:3, :3], MATRIX[:3, :3])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 3.1, math.pi - 1e-6])
def test_motion_between_two_matrices_is_the_one_that_moved_them(angle):
    rotation = angle * torch.nn.functional.normalize(vector(1.0, -2.0, 0.7), dim=0)
    translation = vector(0.3, -0.1, 0.2)
    motion = motion_between(MATRIX, moved(MATRIX, rotation, translation))
    torch.testing.assert_close(motion, torch.stack([rotation, translation]), atol=1e-12, rtol=0)
    torch.testing.assert_close(Rigid(MATRIX).right_inverse(Rigid(MATRIX)(motion)), motion, atol=1e-12, rtol=0)


HALF_TURNS = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "xy": (1, 1, 0), "yz": (0, -3, 1), "xyz": (-2, 1, 4)}


@pytest.mark.parametrize("axis", HALF_TURNS)
def test_motion_by_half_a_turn_is_found(axis):
    axis = torch.nn.functional.normalize(vector(*HALF_TURNS[axis]), dim=0)
    half_turn = 2 * axis[:, None] * axis - torch.eye(3).double()  # exactly 180 degrees: symmetric
    other = MATRIX.clone()
    other[:3, :3] = half_turn @ MATRIX[:3, :3]
    rotation, translation = motion_between(MATRIX, other)
    assert rotation.norm().item() == pytest.approx(math.pi, abs=1e-12)
    assert abs(rotation @ axis).item() == pytest.approx(math.pi, abs=1e-12)
    torch.testing.assert_close(moved(MATRIX, rotation, translation), other, atol=1e-12, rtol=0)
    assert PoseError.between(other, MATRIX).angle == pytest.approx(180)


def test_a_pivot_stays_where_it_is():
    pivot = vector(0.3, -2.0, 1.5)
    turned = moved(MATRIX, vector(0.1, 0.2, -0.3), vector(0, 0, 0), pivot)
    in_object = torch.linalg.solve(MATRIX, torch.cat([pivot, vector(1.0)]))
    torch.testing.assert_close((turned @ in_object)[:3], pivot)
    assert (turned[:3, 3] - MATRIX[:3, 3]).norm() > 0.5
    rigid, motion = Rigid(MATRIX, pivot.tolist()), torch.stack([vector(0.2, -0.1, 0.4), vector(0.3, -0.1, 0.2)])
    torch.testing.assert_close(rigid.right_inverse(rigid(motion)), motion, atol=1e-12, rtol=0)


def test_with_a_pivot_numbers_are_along_the_own_axes_in_units_of_its_distance():
    pivot, axes = vector(0.3, -2.0, 1.5), MATRIX[:3, :3] / MATRIX[:3, :3].norm(dim=0)
    distance, rigid = (MATRIX[:3, 3] - pivot).norm(), Rigid(MATRIX, pivot.tolist())
    for axis in range(3):
        raw = torch.zeros(2, 3, dtype=torch.float64)
        raw[1, axis] = 0.1
        torch.testing.assert_close(rigid(raw), moved(MATRIX, vector(0, 0, 0), 0.1 * distance * axes[:, axis]))
        torch.testing.assert_close(rigid(raw.flip(0)), moved(MATRIX, 0.1 * axes[:, axis], vector(0, 0, 0), pivot))


def test_pose_error_is_angle_and_distance():
    error = PoseError.between(moved(MATRIX, vector(0, math.radians(2), 0), vector(0.3, 0, 0.4)), MATRIX)
    assert error == pytest.approx((2.0, 0.5))


def test_gradient_at_the_start_is_that_of_the_six_numbers():
    raw = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(Rigid(MATRIX), (raw,))


@pytest.fixture
def pose_recipe(folder, edit_recipe):
    """A recipe for the pose of the wall, its target from the true pose, the wall larger than the view."""
    text = (folder / "scene.xml").read_text()
    for old, new in {
            'name="width" value="8"': 'name="width" value="32"', 'name="height" value="6"': 'name="height" value="24"',
            'value="picture.png"/>': 'value="picture.png"/><transform name="to_uv"><scale value="5"/></transform>'}.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    assert text.count('<translate y="1" z="-1"/>') == 1
    wall = '<scale value="4"/><rotate x="0.36" y="0.8" z="0.48" angle="10"/><translate y="1" z="0.4"/>'
    (folder / "scene.xml").write_text(text.replace('<translate y="1" z="-1"/>', wall))
    scene = rb.load(folder / "scene.xml")
    image = rb.render(scene, spp=80, seed=9, max_depth=2, caster="brute")[0].detach()
    assert image.mean() > 0.01
    save_image(folder / "target.exr", image)
    return edit_recipe(COLOUR, POSE)


def test_initial_offset_is_applied_to_the_matrix_of_the_scene(pose_recipe, folder):
    parameter = Recovery(read_recipe(pose_recipe)).parameters[0]
    held = rb.load(folder / "scene.xml").get_parameter("wall.to_world").detach()
    expected = moved(held, torch.deg2rad(torch.tensor([2.0, -3.0, 4.0])), torch.tensor([0.05, 0.1, -0.04]))
    torch.testing.assert_close(parameter.value, expected)
    assert parameter.raw.shape == (2, 3)
    assert parameter.raw.detach().abs().max() < 1e-6


def test_a_pivot_changes_steps_but_not_where_a_run_begins(pose_recipe):
    plain, turned = (Recovery(read_recipe(pose_recipe, overrides)).parameters[0]
                     for overrides in ([], ["parameters.0.pivot=[0.0, 1.0, 2.0]"]))
    torch.testing.assert_close(plain.value, turned.value)
    step = torch.tensor([[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    rigid, about = (each.module.parametrizations.to_world[0] for each in (plain, turned))
    moved_plain, moved_turned = rigid(step), about(step @ about.axes)
    torch.testing.assert_close(moved_plain[:3, :3], moved_turned[:3, :3])
    assert (moved_plain[:3, 3] - moved_turned[:3, 3]).norm() > 0.05
    with pytest.raises(ValueError, match=r'pivot = ... needs parametrisation = "rigid", got "clamp"'):
        read_recipe(pose_recipe, ["parameters.0.pivot=[0.0, 1.0, 2.0]", 'parameters.0.parametrisation="clamp"',
                                  "parameters.0.initial=0.5"])


def test_pose_is_recovered_and_written(pose_recipe, folder):
    # At 8 samples one seed in three still turns the wall too little, after 60 steps even.
    overrides = ["steps=24", "optimizer.learning_rate=0.016", "render.spp=16", "render.max_depth=2"]
    summary, report = run(pose_recipe, overrides, folder / "run", False, Console(quiet=True))
    pose = summary["parameters"][0]
    before, after = pose["pose_error_before"], pose["pose_error"]
    assert before["angle"] == pytest.approx(math.sqrt(29), rel=1e-4)
    assert before["distance"] == pytest.approx(math.sqrt(0.0141), rel=1e-4)
    assert after["angle"] < 0.5 * before["angle"] and after["distance"] < 0.5 * before["distance"]
    written = rb.load(folder / "run" / "scene" / "scene.xml").get_parameter("wall.to_world").detach()
    torch.testing.assert_close(written.flatten(), torch.tensor(pose["recovered"]))
    text = report.read_text(encoding="utf-8")
    assert "off by" in text and "wall.to_world, rotation from the start, degrees" in text
    console = Console(width=100, record=True, file=open("/dev/null", "w"))
    console.print(recovered_table(summary))
    table = console.export_text()
    assert "from the start" in table and f"{after['angle']:.3f} deg" in table


def test_offset_survives_writing_the_recipe(pose_recipe, folder):
    recipe = read_recipe(pose_recipe)
    (folder / "copy").mkdir()
    write_recipe(recipe, folder / "copy" / "recipe.toml")
    assert read_recipe(folder / "copy" / "recipe.toml", allow_outside=True) == recipe


def test_pose_of_another_scale_than_the_truth_is_refused(pose_recipe):
    with pytest.raises(ValueError, match="differ in scale"):
        Recovery(read_recipe(pose_recipe, [
            "parameters.0.initial=[[1.0, 0, 0, 0], [0, 1.0, 0, 1], [0, 0, 1.0, 0.4], [0, 0, 0, 1]]"]))


def test_matrix_that_is_not_affine_is_refused(pose_recipe):
    with pytest.raises(ValueError, match="last row of initial must be 0 0 0 1"):
        Recovery(read_recipe(pose_recipe, ["parameters.0.initial=1.0"]))
