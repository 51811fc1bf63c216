"""Values of XML files that exporters round, and files that people have beside them."""

import pytest

import torch_radbp as rb
from torch_radbp.plugin import SceneError, SceneWarning

SCENE = """<scene version="3.0.0"><sensor type="perspective"/><emitter type="constant"/>
<shape type="{shape}">{inside}</shape>
{more}</scene>"""
SPOT = """<emitter type="spot" id="stage"><float name="cutoff_angle" value="{}"/><float name="beam_width" value="{}"/>
</emitter>"""


def written(folder, shape="sphere", inside="", more=""):
    path = folder / "scene.xml"
    path.write_text(SCENE.format(shape=shape, inside=inside, more=more))
    return path


@pytest.mark.parametrize("beam", [20, 20.000001, 20.001])
def test_a_spot_that_ends_sharply_has_the_narrowest_fall_off(tmp_path, beam):
    path = written(tmp_path, more=SPOT.format(20, beam))
    with pytest.warns(SceneWarning, match='line 3: <emitter type="spot" id="stage">: beam_width, which is not') as caught:
        scene = rb.load(path)
    assert len(caught) == 1 and caught[0].filename == __file__
    assert float(scene.get_parameter("stage.beam_width")) == pytest.approx(0.999 * 20)
    with pytest.raises(SceneError, match="beam_width, which is not less than cutoff_angle"):
        rb.load(path, strict=True)


def test_a_beam_that_is_wider_than_its_cone_is_refused(tmp_path):
    with pytest.raises(SceneError, match="beam_width must be at least 0 and less than the cutoff_angle"):
        rb.load(written(tmp_path, more=SPOT.format(20, 30)))


@pytest.mark.parametrize("specular", [1.001, 2])
def test_specular_above_one_is_read_as_in_mitsuba(tmp_path, specular):
    bsdf = f'<bsdf type="principled"><float name="specular" value="{specular}"/></bsdf>'
    scene = rb.load(written(tmp_path, inside=bsdf), strict=True)
    assert float(scene.get_parameter("sphere.bsdf.specular")) == pytest.approx(specular)


def test_mesh_files_of_a_scene_tell_and_are_strict(tmp_path):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2\n")
    path = written(tmp_path, "obj", '<string name="filename" value="m.obj"/>')
    with pytest.warns(SceneWarning, match="m.obj, line 5: the face has fewer than 3 corners") as caught:
        rb.load(path)
    assert caught[0].filename == __file__
    with pytest.raises(SceneError, match="m.obj, line 5: the face has fewer than 3 corners"):
        rb.load(path, strict=True)


def test_a_file_in_another_case_is_suggested(tmp_path):
    (tmp_path / "Mesh.obj").write_text("")
    path = written(tmp_path, "obj", '<string name="filename" value="mesh.OBJ"/>')
    with pytest.raises(SceneError, match=rf"'mesh.OBJ' not found; looked in {tmp_path}; did you mean {tmp_path}/Mesh.obj\?"):
        rb.load(path)
