"""Meshes and scenes of trimesh as shapes: the image is that of the same mesh from a file."""

import warnings

import numpy as np
import pytest
import torch
import trimesh

import torch_radbp as rb
from tests.io.trimesh_scenes import assert_same, ball, image, loaded, material, picture
from torch_radbp.io.values.transform import scale, translate
from torch_radbp.plugin import SceneError

PAINT = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": torch.rand(4, 6, 3, generator=torch.manual_seed(1))}}


@pytest.mark.parametrize("kind, with_normals, flips", [("obj", "include_normals", {}),
                                                       ("ply", "vertex_normal", {"flip_tex_coords": True})])
def test_the_image_is_that_of_the_file(kind, with_normals, flips, tmp_path):
    """In a PLY file v points where Mitsuba has it, which trimesh does not know of, and writes it upwards."""
    ball().export(tmp_path / f"ball.{kind}", **{with_normals: True})
    by_file = loaded(ball={"type": kind, "filename": str(tmp_path / f"ball.{kind}"), "bsdf": PAINT, **flips})
    by_trimesh = loaded(ball={"type": "mesh", "mesh": trimesh.load(tmp_path / f"ball.{kind}"), "bsdf": PAINT})
    assert_same(image(by_file), image(by_trimesh))
    assert by_file.ball.has_normals and by_trimesh.ball.has_normals


MATERIALS = {"numbers": material(), "picture": material(baseColorTexture=picture()),
             "roughness": material(metallicRoughnessTexture=picture(2)), "normals": material(normalTexture=picture(3, 2)),
             "opacity": material(baseColorFactor=[255, 0, 0, 128], alphaMode="BLEND"),
             "both sides": material(doubleSided=True),
             "light": material(emissiveFactor=[0.5, 0.25, 1.0], emissiveTexture=picture(4))}


@pytest.mark.parametrize("name", MATERIALS)
def test_a_material_is_what_it_is_in_gltf(name, tmp_path):
    mesh = ball()
    mesh.visual.material = MATERIALS[name]
    scene = trimesh.Scene(mesh, camera=trimesh.scene.Camera(resolution=(24, 24), fov=(40, 40)),
                          camera_transform=trimesh.transformations.translation_matrix([0, 0.2, 4]))
    scene.export(tmp_path / "ball.glb")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        by_file = rb.load(tmp_path / "ball.glb", light=1.0, resolution=24)
        by_trimesh = rb.scene_from_trimesh(scene, light=1.0)
    values = {key: value for key, value in by_file.named_parameters() if key.startswith("gold")}
    for key, value in values.items():
        torch.testing.assert_close(by_trimesh.get_parameter(key), value, rtol=0, atol=1e-6, msg=key)
    assert len(values) > 5
    torch.testing.assert_close(by_file.sensors[0].to_world, by_trimesh.get_submodule("camera").to_world)
    assert_same(image(by_file), image(by_trimesh))


@pytest.mark.parametrize("kind", ["vertex", "face"])
def test_colours_are_linear_base_colours(kind, tmp_path):
    mesh = trimesh.creation.icosphere(1)
    colours = np.random.default_rng(0).integers(0, 256, (len(getattr(mesh, "vertices" if kind == "vertex" else "faces")), 3))
    setattr(mesh.visual, f"{kind}_colors", colours.astype(np.uint8))
    scene = loaded(ball=mesh)
    assert scene.ball.bsdf.base_color.name == f"{kind}_color"
    np.testing.assert_allclose(scene.get_parameter(f"ball.{kind}_color").numpy(), colours / 255, atol=1e-7)
    assert image(scene).mean() > 0.05
    if kind == "vertex":  # of which glTF has colours
        mesh.export(tmp_path / "ball.glb")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rb.GltfWarning)
            by_file = rb.load(tmp_path / "ball.glb")
        torch.testing.assert_close(by_file.shapes[0].vertex_color, scene.ball.vertex_color)
        assert by_file.shapes[0].bsdf.metallic.value == scene.ball.bsdf.metallic.value


def test_a_scene_of_three_nodes_and_two_materials(tmp_path):
    """Shapes stand where the nodes put them, one of them mirrored, and share what they share."""
    gold, red = material(), material(name="red", baseColorFactor=[255, 0, 0, 255], metallicFactor=0.0)
    box, ball = trimesh.creation.box((0.6, 0.8, 1.0)), trimesh.creation.icosphere(1, radius=0.4)
    box.visual, ball.visual = (trimesh.visual.TextureVisuals(material=each) for each in (gold, red))
    pin = trimesh.creation.cone(0.3, 1.0)
    pin.visual = trimesh.visual.TextureVisuals(material=gold)
    places = {"crate": (box, translate((-1, 0, 0))), "ball": (ball, scale((1, 2, 1))),
              "pin": (pin, translate((1, 0, 0)) @ scale((1, 1, -1)))}
    source = trimesh.Scene()
    for name, (mesh, place) in places.items():
        source.add_geometry(mesh, node_name=name, geom_name=f"{name}_mesh", transform=place)
    source.export(tmp_path / "scene.glb")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        by_trimesh, by_file = rb.scene_from_trimesh(source), rb.load(tmp_path / "scene.glb")
    in_dict = loaded(part=source)
    for scene, names in ((by_trimesh, places), (in_dict, [f"part_{name}" for name in places])):
        shapes = [scene.get_submodule(name) for name in names]
        assert shapes[0].bsdf is shapes[2].bsdf is not shapes[1].bsdf and len(list(scene.bsdfs())) == 2
        for shape, (mesh, place) in zip(shapes, places.values()):
            np.testing.assert_array_equal(shape.to_world.numpy(), place.astype(np.float32))
            world = mesh.copy().apply_transform(place)
            np.testing.assert_allclose(shape.vertex_positions.numpy(), world.vertices, atol=1e-6)
            found = shape.triangles()
            outwards = trimesh.Trimesh(found.vertices.numpy(), found.faces.numpy(), process=False)
            assert outwards.volume > 0 and outwards.volume == pytest.approx(world.volume, rel=1e-5)
    assert by_trimesh.gold.metallic.value == 0.4 and by_trimesh.red.base_color.value.tolist() == [1, 0, 0]
    assert {name for name, _ in by_trimesh.named_children()} == {*places, "gold", "red", "sky", "camera"}
    assert_same(image(by_trimesh), image(by_file))


def test_a_scene_in_a_group_is_shown_by_instances():
    source = trimesh.Scene({"a": trimesh.creation.box(), "b": trimesh.creation.icosphere(1)})
    scene = loaded(group={"type": "shapegroup", "part": source},
                   one={"type": "instance", "group": {"type": "ref", "id": "group"}})
    assert {*scene.group.shapes} == {"part_a", "part_b"} and len(scene.shapes) == 2
    assert image(scene).mean() > 0.1


def test_attributes_are_kept_and_what_is_none_is_said():
    mesh = trimesh.creation.icosphere(1)
    mesh.vertex_attributes["_heat"] = np.arange(42)
    mesh.face_attributes["flow"] = np.ones((80, 3))
    mesh.vertex_attributes["weights"] = np.ones((42, 4))
    with pytest.warns(UserWarning, match="the vertex attribute 'weights' of trimesh: is left out"):
        scene = loaded(ball=mesh)
    assert scene.ball.attribute_names == ("vertex_heat", "face_flow")
    assert scene.ball.vertex_heat[:, 0].tolist() == list(range(42))


def test_normals_are_those_that_the_mesh_holds():
    """As for trimesh's own writer of glTF; without any the mesh is flat, or smooth by `recompute_normals`."""
    flat, smooth = loaded(ball=ball(smooth=False)), loaded(ball=ball())
    assert not flat.ball.has_normals and smooth.ball.has_normals
    rounded = loaded(ball={"type": "mesh", "mesh": ball(), "recompute_normals": True})
    assert rounded.ball.recompute_normals and not rounded.ball.has_normals


def test_a_mesh_without_a_look_is_grey_as_other_shapes_are():
    scene = loaded(ball=trimesh.creation.icosphere(1), other={"type": "mesh", "mesh": trimesh.creation.box()})
    assert scene.ball.bsdf.type == scene.other.bsdf.type == "diffuse"


def test_phong_materials_are_no_metals():
    mesh = ball()
    mesh.visual.material = trimesh.visual.material.SimpleMaterial(image=picture(), diffuse=[255, 255, 255, 255])
    scene = loaded(ball=mesh)
    assert scene.ball.bsdf.metallic.value == 0 and scene.ball.bsdf.base_color.type == "bitmap"


def test_the_camera_of_a_scene_is_the_camera():
    source = trimesh.Scene(trimesh.creation.box())
    source.set_camera(angles=(0.3, 0.2, 0.1), distance=4, fov=(50, 40), resolution=(30, 24))
    scene = rb.scene_from_trimesh(source, light=1.0)
    camera = scene.get_submodule("camera")
    assert (camera.film.width, camera.film.height) == (30, 24)
    place = np.asarray(source.camera_transform)
    np.testing.assert_allclose(camera.to_world[:3, 3].numpy(), place[:3, 3], atol=1e-6)
    np.testing.assert_allclose(camera.to_world[:3, 2].numpy(), -place[:3, 2], atol=1e-6)  # it looks along -z there
    with pytest.warns(rb.SceneWarning, match="a constant light of radiance 1 is added"):
        other = rb.scene_from_trimesh(source, camera=False, resolution=20)
    assert other.sensors[0].film.width == 20 and other.sensors[0].x_fov != camera.x_fov


@pytest.mark.hostile
def test_what_is_no_mesh_is_refused():
    with pytest.raises(TypeError, match="made of a trimesh.Scene or a trimesh.Trimesh, got 'ball.stl'"):
        rb.scene_from_trimesh("ball.stl")
    with pytest.raises(SceneError, match="the trimesh.Scene has no triangles"):
        rb.scene_from_trimesh(trimesh.Scene())
    with pytest.raises(SceneError, match="the option spp must be at least 1"):
        rb.scene_from_trimesh(trimesh.creation.box(), spp=0)
    broken = trimesh.creation.box()
    broken.vertices[0] = np.nan
    with pytest.raises(SceneError, match="crate: .*must be finite"):
        rb.scene_from_trimesh(trimesh.Scene({"crate": broken}))
    with pytest.raises(SceneError, match="cloud: the trimesh.Scene has no triangles, only cloud, a PointCloud"):
        loaded(cloud=trimesh.Scene({"cloud": trimesh.PointCloud(np.zeros((3, 3)))}))
    several = ball()
    several.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.MultiMaterial([material(), material()]))
    with pytest.raises(SceneError, match="a shape has one material, got a MultiMaterial"):
        loaded(ball=several)


def test_a_look_that_cannot_be_read_is_said():
    mesh = trimesh.creation.box()
    mesh.visual = trimesh.visual.TextureVisuals(material=material(baseColorTexture=picture()))
    with pytest.warns(rb.SceneWarning, match=r"read at \(0, 0\) everywhere: the mesh has no uv"):
        loaded(ball=mesh)
    with pytest.raises(SceneError, match="the mesh has no uv"):
        rb.scene_from_trimesh(mesh, strict=True)
    with pytest.raises(SceneError, match="cloud: a PointCloud of trimesh is left out"):
        rb.scene_from_trimesh(trimesh.Scene({"cloud": trimesh.PointCloud(np.zeros((3, 3))), "box": ball()}), strict=True)
    weighed = trimesh.creation.box()
    weighed.vertex_attributes["weights"] = np.ones((8, 4))
    with pytest.raises(SceneError, match="attribute 'weights' of trimesh: is left out"):
        loaded(True, ball=weighed)
