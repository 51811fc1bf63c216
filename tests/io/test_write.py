"""A saved scene is the same scene, here and in Mitsuba."""

import numpy as np
import pytest
import torch

from tests.formats.serialized_files import mesh, serialized
from tests.io.documents import scene_dict, write_scene
from tests.scenes.everything import EVERYTHING as EVERY_PLUGIN
from tests.scenes.everything import build_everything
from torch_radbp.formats.image import save_image
from torch_radbp.formats.volume import write_volume
from torch_radbp.io.load import load, load_dict
from torch_radbp.io.write import save
from torch_radbp.plugin import Plugin, SceneError, attributes
from torch_radbp.shape.mesh import Mesh
from torch_radbp.texture.colour import Colour

EVERYTHING = """
<integrator type="path"><integer name="max_depth" value="5"/><boolean name="hide_emitters" value="true"/></integrator>
<texture type="bitmap" id="wood \\$1"><string name="filename" value="t.png"/><string name="wrap_mode" value="mirror"/>
  <transform name="to_uv"><scale value="2"/></transform></texture>
<bsdf type="diffuse" id="white.001"><rgb name="reflectance" value="0.8, 0.7, 0.1"/></bsdf>
<sensor type="perspective" id="cam"><float name="fov" value="39.3"/><string name="fov_axis" value="smaller"/>
  <float name="principal_point_offset_x" value="0.1"/>
  <transform name="to_world"><lookat origin="0,0,6" target="0,0.1,0" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/><rfilter type="box"/></film>
  <sampler type="independent"><integer name="sample_count" value="7"/></sampler></sensor>
<shape type="rectangle"><transform name="to_world"><scale x="3" y="2"/><rotate y="1" angle="10"/></transform>
  <bsdf type="twosided"><bsdf type="diffuse"><ref name="reflectance" id="wood \\$1"/></bsdf>
  <bsdf type="diffuse"/></bsdf>
</shape>
<shape type="cube" id="box"><transform name="to_world"><scale value="0.4"/><rotate x="1" angle="40"/></transform>
  <boolean name="flip_normals" value="true"/><ref id="white.001"/></shape>
<shape type="sphere" id="ball"><point name="center" x="1" y="0.5" z="0.2"/><float name="radius" value="0.5"/>
  <bsdf type="diffuse"><texture name="reflectance" type="bitmap"><string name="filename" value="t.png"/>
    <string name="filter_type" value="nearest"/></texture></bsdf></shape>
<shape type="cylinder" id="pipe"><point name="p0" value="0.1, 0.2, 0.3"/><point name="p1" value="0.4, 0.9, 0.2"/>
  <float name="radius" value="0.1"/><transform name="to_world"><scale value="1.2"/></transform></shape>
<shape type="cube" id="die"><boolean name="face_normals" value="true"/>
  <transform name="to_world"><scale value="0.2"/></transform></shape>
<shape type="serialized" id="packed"><string name="filename" value="m.dat"/><integer name="shape_index" value="1"/></shape>
<shape type="sdfgrid" id="lump"><string name="filename" value="g.vol"/><string name="normals" value="analytic"/>
  <transform name="to_world"><scale x="1" y="0.5" z="0.7"/></transform></shape>
<shape type="obj"><string name="filename" value="m.obj"/><transform name="to_world"><translate x="-1.5"/></transform>
  <bsdf type="diffuse" id="nested"><spectrum name="reflectance" value="0.3"/></bsdf></shape>
<shape type="ply" id="flat"><string name="filename" value="m.ply"/><boolean name="face_normals" value="true"/>
  <ref id="nested"/></shape>
<shape type="disk"><transform name="to_world"><scale value="0.3"/><translate value="0.2, -0.9, 1"/></transform>
  <emitter type="area"><spectrum name="radiance" value="3"/></emitter></shape>
<emitter type="point" id="lamp"><point name="position" value="1, 2, 3"/>
  <rgb name="intensity" value="10, 8, 5"/></emitter>
<emitter type="spot" id="stage"><transform name="to_world"><lookat origin="2,3,4" target="0,0,0" up="0,1,0"/></transform>
  <rgb name="intensity" value="9, 8, 7"/><float name="cutoff_angle" value="35"/><texture name="texture" type="bitmap">
    <string name="filename" value="t.png"/></texture></emitter>
<emitter type="projector"><transform name="to_world"><lookat origin="-2,1,5" target="0,0,0" up="0,1,0"/></transform>
  <texture name="irradiance" type="bitmap"><string name="filename" value="t.png"/></texture>
  <float name="scale" value="3"/><float name="fov" value="41"/><string name="fov_axis" value="larger"/></emitter>
<emitter type="directional" id="sun"><vector name="direction" x="0.3" y="-1" z="-0.4"/>
  <rgb name="irradiance" value="0.3, 0.2, 0.1"/><float name="sampling_weight" value="0.5"/></emitter>
"""
SURROUNDS = {
    "sunsky": """<emitter type="sunsky"><float name="turbidity" value="4.5"/><rgb name="albedo" value="0.1, 0.2, 0.3"/>
      <float name="hour" value="9.5"/><float name="sun_aperture" value="3"/><float name="sky_scale" value="0.5"/>
      <transform name="to_world"><rotate x="1" angle="-90"/></transform></emitter>""",
    "constant": '<emitter type="constant"><float name="radiance" value="0.2"/></emitter>',
    "envmap": """<emitter type="envmap"><string name="filename" value="sky.exr"/><float name="scale" value="0.5"/>
      <transform name="to_world"><rotate x="1" angle="30"/><rotate y="1" angle="70"/></transform>
      <boolean name="mis_compensation" value="true"/></emitter>""",
}
SEAM = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 .5\nvt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\nf 1/2 3/3 4/1\n"
CORNERS = [[0.1, 0, 1], [1, 0, 1], [0, 1, 1]]
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_index
end_header
-1 -1 0
0 -1 0
0 -0.5 0
3 0 1 2
"""


@pytest.fixture(params=SURROUNDS)
def everything(request, tmp_path):
    """The path of a scene with every plugin, but that there can be one surround only."""
    folder = tmp_path / "original"
    folder.mkdir()
    save_image(folder / "t.png", torch.rand(3, 4, 5, generator=torch.Generator().manual_seed(0)))
    (folder / "m.obj").write_text(SEAM)
    (folder / "m.ply").write_text(PLY)
    (folder / "m.dat").write_bytes(serialized(mesh(CORNERS, [[0, 1, 2]]), mesh(CORNERS, [[0, 1, 2]], normals=CORNERS)))
    write_volume(folder / "g.vol", np.linspace(-1, 2, 60, dtype="f4").reshape(3, 5, 4, 1))
    save_image(folder / "sky.exr", torch.rand(3, 5, 8, generator=torch.Generator().manual_seed(1)))
    return write_scene(folder, EVERYTHING + SURROUNDS[request.param], complete=False)


@pytest.fixture
def target(tmp_path):
    folder = tmp_path / "saved"
    folder.mkdir()
    return folder / "scene.xml"


def written(scene):
    """The parameters of a scene as files hold them: meshes are where their poses put them."""
    parameters = dict(scene.named_parameters())
    for shape in scene.shapes:
        if isinstance(shape, Mesh):
            name, surface = scene.name_of(shape), shape.triangles()
            del parameters[f"{name}.to_world"]
            parameters[f"{name}.vertex_positions"] = surface.vertices
            if f"{name}.vertex_normals" in parameters:
                parameters[f"{name}.vertex_normals"] = surface.normals
    return parameters


def assert_same(scene, other):
    ours, theirs = written(scene), written(other)
    assert set(ours) == set(theirs)
    for name in ours:
        assert torch.equal(ours[name], theirs[name]), name


def test_load_save_load_gives_the_same_parameters(everything, target):
    scene = load(everything)
    save(scene, target)
    saved = load(target)
    assert_same(scene, saved)
    for attribute in ("max_depth", "rr_depth", "hide_emitters"):
        assert getattr(saved.integrator, attribute) == getattr(scene.integrator, attribute)
    assert saved.sensors[0].sampler.sample_count == 7
    assert saved.sensors[0].film.rfilter.type == "box" and saved.sensors[0].film.width == 24
    assert [emitter.sampling_weight for emitter in saved.emitters] == [emitter.sampling_weight for emitter in scene.emitters]
    box = saved.get_submodule("box")
    assert box.flip_normals and box.bsdf is saved.get_submodule("white_001")


@pytest.mark.parametrize("name", EVERY_PLUGIN)
def test_every_plugin_comes_back_with_its_parameters_and_attributes(name, target):
    """`tests.scenes.everything` has every plugin and every parameter. Meshes come back without their poses."""
    scene = build_everything(name, torch.float32)
    save(scene, target)
    saved = load(target)
    ours, theirs = written(scene), written(saved)
    assert set(ours) == set(theirs)
    for parameter, value in ours.items():
        rounded = parameter.endswith(("x_fov", "vertex_normals"))  # a tangent and back, normalised again
        torch.testing.assert_close(theirs[parameter], value, rtol=1e-6 if rounded else 0, atol=1e-7 if rounded else 0)
    assert plain_attributes(scene) == plain_attributes(saved)


def plain_attributes(scene):
    """Numbers, words and switches of all plugins by name.

    But of meshes, which come back as files of their own, and of spectra, which come back as the colours that they have.
    """
    return {f"{name}.{attribute}": getattr(plugin, attribute)
            for name, plugin in scene.named_modules() if isinstance(plugin, Plugin) and not isinstance(plugin, Mesh | Colour)
            for attribute in attributes(type(plugin)) if attribute != "filename"
            and isinstance(getattr(plugin, attribute), (str, bool, int, float))}


def test_saving_twice_writes_the_same_bytes(everything, target):
    save(load(everything), target)
    first = {file.name: file.read_bytes() for file in target.parent.iterdir()}
    save(load(target), target)
    assert {file.name: file.read_bytes() for file in target.parent.iterdir()} == first


def test_mitsuba_renders_the_saved_scene_as_the_original(mi, everything, target):
    save(load(everything), target)
    images = []
    for path in (everything, target):
        scene = mi.load_file(str(path))
        runs = np.stack([np.array(mi.render(scene, spp=16, seed=seed)) for seed in range(8)])
        images.append((runs.mean(0), runs.var(0, ddof=1) / 8))
    (a, var_a), (b, var_b) = images
    z = (a - b) / np.sqrt(var_a + var_b + 1e-8)
    assert np.abs(z).mean() < 1.0  # 0.87 for a t distribution of 14 degrees of freedom; another scene gives several


@pytest.mark.parametrize("radiance", [{"type": "rgb", "value": [3, 2, 1]}, {"type": "bitmap", "data": np.ones((2, 2, 3))}])
def test_a_texture_that_two_shapes_share_is_shared_again(target, radiance):
    lamp = {"type": "rectangle", "emitter": {"type": "area", "radiance": radiance}}
    scene = load_dict(scene_dict(a=lamp, b=lamp, b_emitter_radiance={"type": "diffuse"}))
    scene.a.emitter.radiance = scene.b.emitter.radiance
    save(scene, target)
    saved = load(target)
    assert saved.a.emitter.radiance is saved.b.emitter.radiance
    assert {name for name, _ in saved.named_parameters()} == {name for name, _ in scene.named_parameters()}


def test_changed_parameters_are_what_is_written(everything, target):
    scene = load(everything)
    with torch.no_grad():
        for name, parameter in scene.named_parameters():
            if name.endswith(("value", "data", "x_fov")):
                parameter.mul_(0.9)
            elif name.endswith(("vertex_positions", "position")):
                parameter.add_(torch.arange(parameter.numel()).reshape(parameter.shape) * 0.01)
            elif name.endswith("to_world"):
                parameter[:3, 3] += 0.5
    save(scene, target)
    saved = load(target)
    ours, theirs = written(scene), written(saved)
    assert set(ours) == set(theirs)
    for name in ours:  # the field of view passes through a tangent and back, normals are normalised again
        rounded = name.endswith(("x_fov", "vertex_normals"))
        torch.testing.assert_close(theirs[name], ours[name], rtol=1e-6 if rounded else 0, atol=1e-7 if rounded else 0)
    assert saved.get_submodule("box").type == "ply" and saved.get_submodule("flat").face_normals


def test_parametrized_values_are_evaluated(target):
    class Half(torch.nn.Module):
        def forward(self, value):
            return value / 2

    scene = load_dict(scene_dict(white={"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}}))
    torch.nn.utils.parametrize.register_parametrization(scene.get_submodule("white.reflectance"), "value", Half())
    save(scene, target)
    saved = load(target).get_parameter("white.reflectance.value")
    torch.testing.assert_close(saved.detach(), torch.tensor([0.1, 0.2, 0.3]))


def test_double_precision_survives(target):
    torch.set_default_dtype(torch.float64)
    try:
        reflectance = {"type": "rgb", "value": [1 / 3, 1 / 7, 0.1]}
        scene = load_dict(scene_dict(white={"type": "diffuse", "reflectance": reflectance}))
        save(scene, target)
        assert_same(scene, load(target))
    finally:
        torch.set_default_dtype(torch.float32)


@pytest.mark.parametrize(
    "name, value, message",
    [
        ("white.reflectance.value", torch.nan, r"white\.reflectance: not written, it is NaN or infinite"),
        ("box.vertex_positions", torch.inf, r"box\.vertex_positions: not written"),
    ],
)
def test_values_that_are_not_finite_leave_the_old_files_alone(target, name, value, message):
    scene = load_dict(scene_dict(white={"type": "diffuse"}, box={"type": "cube"}))
    save(scene, target)
    before = target.read_bytes()
    with torch.no_grad():
        scene.get_parameter(name).fill_(value)
    with pytest.raises(SceneError, match=message):
        save(scene, target)
    assert target.read_bytes() == before and [file.name for file in target.parent.iterdir()] == ["scene.xml"]


def test_a_network_cannot_be_written(target):
    scene = load_dict(scene_dict(white={"type": "diffuse"}))
    scene.get_submodule("white").reflectance = torch.nn.Linear(2, 3)
    with pytest.raises(SceneError, match=r"white\.reflectance: a NeuralTexture cannot be written as XML"):
        save(scene, target)


@pytest.mark.parametrize(
    "name, error, message",
    [
        ("scene.json", ValueError, r"written as .xml, .glb or .gltf, got '\.json'"),
        ("no/scene.xml", FileNotFoundError, "does not exist; create it first"),
    ],
)
def test_targets_that_cannot_be_written_are_named(tmp_path, name, error, message):
    with pytest.raises(error, match=message):
        save(load_dict(scene_dict()), tmp_path / name)
