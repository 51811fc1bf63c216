"""The scene as a tree of modules: names, sharing, and what is packed for the tracer."""

import pytest
import torch

import torch_radbp as rb
from tests.scenes import CASES, cornell, diffuse, load, rectangle, rgb, sensor, texels, textured
from torch_radbp.bsdf.diffuse import Diffuse
from torch_radbp.emitter.area import AreaKind
from torch_radbp.emitter.constant import Constant, ConstantKind
from torch_radbp.emitter.point import PointKind
from torch_radbp.scene.packing.pack import pack
from torch_radbp.sensor.perspective import Perspective
from torch_radbp.shape.rectangle import Rectangle
from torch_radbp.tensors.vec import rows


def test_a_shared_material_is_registered_once_under_its_own_name():
    scene = cornell()
    names = dict(scene.named_parameters())
    assert "white.reflectance.value" in names and not any(name.startswith("floor.bsdf") for name in names)
    assert scene.get_submodule("floor").bsdf is scene.get_submodule("white") is scene.get_submodule("box").bsdf
    assert len(list(scene.bsdfs())) == 4  # white, red, green, the lamp's


def test_nothing_requires_grad_until_the_user_picks():
    for case in CASES.values():
        assert not any(parameter.requires_grad for parameter in case.scene().parameters())


@pytest.mark.parametrize("name", ["two", "two.dots", "reflectance", "training", "shapes", "forward"])
def test_any_name_can_be_an_object_of_the_scene(name):
    scene = load(sensor=sensor(2), sky={"type": "constant"}, **{name: rectangle((0, 0, 0), bsdf=diffuse(0.1, 0.2, 0.3))})
    assert len(scene.shapes) == 1
    (full,) = (n for n, _ in scene.named_parameters() if n.endswith("reflectance.value"))
    assert scene.get_parameter(full).shape == (3,)
    assert rb.render(scene, spp=1, max_depth=2).sum() > 0


def test_a_scene_is_built_from_plugins_in_python():
    scene = rb.Scene({"camera": Perspective(fov=40), "wall": Rectangle(bsdf=Diffuse(reflectance=0.25)), "sky": Constant()})
    assert {name for name, _ in scene.named_parameters()} >= {"wall.bsdf.reflectance.value", "sky.radiance.value",
                                                              "camera.to_world", "camera.x_fov", "wall.to_world"}
    assert scene.integrator.max_depth == -1 and scene.integrator.rr_depth == 5


def test_objects_of_one_name_are_refused():
    with pytest.raises(rb.SceneError, match="two objects of the scene have the id 'a_b'"):
        rb.Scene({"a.b": Constant(), "a_b": Rectangle()})


def test_triangles_are_packed_in_the_order_of_the_shapes():
    scene = cornell()
    triangles, surfaces = pack(scene).triangles, [shape.oriented() for shape in scene.shapes]
    corners = torch.cat([surface.vertices[surface.faces] for surface in surfaces])
    for k, corner in enumerate(triangles.corners):
        torch.testing.assert_close(rows(triangles.vertices.p, corner).stack(), corners[:, k], rtol=0, atol=0)
    assert len(corners) == 6 * 2 + 12


def test_next_event_estimation_chooses_area_by_area_and_lights_by_weight():
    quarter = {"type": "area", "radiance": rgb(1, 1, 1), "sampling_weight": 1.0}
    rest = {"type": "constant", "radiance": rgb(1, 1, 1), "sampling_weight": 3.0}
    scene = load(sensor=sensor(2), lamp=rectangle((0, 0, 0), (2.0, 3.0, 1.0), emitter=quarter), sky=rest)
    packed = pack(scene)
    torch.testing.assert_close(packed.lights.choice.pmf, torch.tensor([0.125, 0.125, 0.75], dtype=torch.float64))
    # Density over area: a quarter of the choices, spread over 4 x 6.
    density = packed.lights.choice.pmf[:2] * packed.lights.tables[0].inverse_area
    torch.testing.assert_close(density, torch.full((2,), 0.25 / 24, dtype=torch.float64))


def test_colours_poses_and_areas_are_attached_and_choices_are_not():
    glowing = rectangle((0, 0, 5), emitter={"type": "area"})
    scene = load(sensor=sensor(2), glowing=glowing, sky={"type": "constant"}, lamp={"type": "point"})
    for parameter in scene.parameters():
        parameter.requires_grad_()
    packed = pack(scene)
    lights, kinds = packed.lights, packed.layout.lights
    area, sky, points = (lights.tables[kinds.index(kind)] for kind in (AreaKind(), ConstantKind(), PointKind()))
    colours, = packed.textures
    assert all(component.requires_grad for component in (*colours, *packed.radiance.texels,
                                                         *sky.radiance, *points.place, area.inverse_area))
    assert not any(tensor.requires_grad for tensor in (*lights.choice, lights.surround_pmf))


def test_a_texture_used_by_two_materials_is_stored_once():
    bitmap = {"type": "bitmap", "id": "picture", "data": texels(3, 4)}
    scene = load(sensor=sensor(2), sky={"type": "constant"}, picture=bitmap,
                 a=rectangle((0, 0, 0), bsdf={"type": "diffuse", "reflectance": {"type": "ref", "id": "picture"}}),
                 b=rectangle((0, 0, 1), bsdf={"type": "diffuse", "reflectance": {"type": "ref", "id": "picture"}}))
    assert [name for name, _ in scene.named_parameters() if name.endswith("data")] == ["picture.data"]
    images, = pack(scene).textures
    assert len(images.texels.x) == 12


def test_a_grey_colour_has_one_value_and_one_derivative():
    scene = load(sensor=sensor(4), sky={"type": "constant", "radiance": rgb(1, 2, 3)},
                 wall=rectangle((0, 0, 0), 3.0, bsdf={"type": "diffuse", "reflectance": 0.5}))
    grey = scene.get_parameter("wall.bsdf.reflectance.value").requires_grad_()
    assert grey.shape == ()
    image = rb.render(scene, spp=4, max_depth=2, nee=False)
    gradient, = torch.autograd.grad(image.mean(), grey)
    # One bounce into a sky: reflectance times radiance, on every path.
    torch.testing.assert_close(gradient, torch.tensor(2.0, dtype=torch.float64))


def test_the_name_of_a_submodule_can_be_asked_for():
    scene = textured()
    assert scene.name_of(scene.get_submodule("wall.bsdf")) == "wall.bsdf"
    assert scene.name_of(Diffuse()) == "Diffuse"
