"""Transforms of scene XML against Mitsuba 3.9 and against closed forms."""

import numpy as np
import pytest

from tests.io.documents import write_scene
from torch_radbp.io.load import load
from torch_radbp.io.values import transform
from torch_radbp.plugin import SceneWarning

OPERATIONS = [
    '<translate x="1" z="-2"/>',
    '<translate value="1, 2, 3"/>',
    '<translate value="0.5"/>',
    '<scale value="2"/>',
    '<scale x="3"/>',
    '<scale value="1 2 3"/>',
    '<rotate x="1" angle="30"/>',
    '<rotate value="0, 0, 1" angle="-75.5"/>',
    '<rotate x="0.6" y="0.8" angle="200"/>',
    '<lookat origin="1, 2, 4" target="0, 0.5, 0" up="0, 1, 0"/>',
    '<lookat origin="1 2 4" target="0 0 0"/>',
    '<lookat origin="0, 0, 4" target="0, 0, 0" up="0, 0, 0"/>',
    '<matrix value="1 2 3 4 5 6 7 8 10"/>',
    '<matrix value="1,0,0,5, 0,2,0,6, 0,1,3,7, 0,0,0,1"/>',
    '<scale value="2, 1, 1"/><rotate y="1" angle="90"/><translate x="1"/><rotate z="1" angle="10"/>',
    "",
]


@pytest.mark.parametrize("operations", OPERATIONS)
def test_transforms_are_those_of_mitsuba(mi, tmp_path, operations):
    body = f'<shape type="rectangle" id="r"><transform name="to_world">{operations}</transform></shape>'
    path = write_scene(tmp_path, body)
    ours = load(path).get_parameter("r.to_world").detach().numpy()
    theirs = np.array(mi.traverse(mi.load_file(str(path)))["r.to_world"].matrix)
    np.testing.assert_allclose(ours, theirs, atol=2e-6)  # both are single precision, entries up to 10


@pytest.mark.parametrize("axis", ['x="1" y="1"', 'value="0, 0.2, -0.3"'])
def test_a_rotation_axis_of_another_length_scales_as_in_mitsuba_and_warns(mi, tmp_path, axis):
    body = f'<shape type="rectangle" id="r"><transform name="to_world"><rotate {axis} angle="30"/></transform></shape>'
    path = write_scene(tmp_path, body)
    with pytest.warns(SceneWarning, match="<rotate>: the axis has the length .* and not 1, so that it scales and shears"):
        ours = load(path).get_parameter("r.to_world").detach().numpy()
    theirs = np.array(mi.traverse(mi.load_file(str(path)))["r.to_world"].matrix)
    assert abs(np.linalg.det(theirs[:3, :3]) - 1) > 0.01
    np.testing.assert_allclose(ours, theirs, atol=1e-6)


def test_rotation_is_orthogonal_for_an_axis_of_any_length():
    matrix = transform.rotate((1, 2, -3), 77)[:3, :3]
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(matrix @ (1, 2, -3), (1, 2, -3), atol=1e-14)
    assert np.trace(matrix) == pytest.approx(1 + 2 * np.cos(np.deg2rad(77)))


def test_the_first_operation_listed_is_applied_first(tmp_path):
    body = (
        '<shape type="rectangle" id="r"><transform name="to_world"><translate x="1"/><scale value="2"/></transform>'
        "</shape>"
    )
    matrix = load(write_scene(tmp_path, body)).get_parameter("r.to_world")
    assert matrix[0, 3] == 2.0
