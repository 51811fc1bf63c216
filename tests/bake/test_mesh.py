"""Shapes become meshes with surface coordinates, and look the same."""

import numpy as np
import pytest
import torch
import trimesh

import torch_radbp as rb
from torch_radbp.bake.texels import texels_of
from torch_radbp.io.values.transform import rotate, scale, translate

LOOK = {"type": "perspective", "fov": 40, "to_world": rb.look_at([1.5, 1.2, 3], [0.3, 0.3, 0.3], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 24, "height": 24}}
POSE = translate((0.2, 0.1, 0)) @ rotate((0, 1, 0), 25) @ scale((0.6, 0.5, -0.4))


def distances(size=13):
    """A ball in the unit cube."""
    axis = torch.linspace(-0.5, 0.5, size)
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    return ((x**2 + y**2 + z**2).sqrt() - 0.3)[..., None]


def scene_of(**objects):
    return rb.load_dict({"type": "scene", "camera": LOOK, "sky": {"type": "constant"}, **objects})


def images(scene):
    return rb.render(scene, spp=16, seed=1, max_depth=3)


@pytest.mark.parametrize("normals", ["smooth", "analytic"])
def test_an_sdfgrid_becomes_a_mesh_of_its_triangles_with_charts_apart(normals):
    pytest.importorskip("xatlas")
    scene = scene_of(body={"type": "sdfgrid", "grid": distances(), "normals": normals, "bsdf": {
        "type": "roughplastic", "diffuse_reflectance": {"type": "rgb", "value": [0.7, 0.2, 0.1]}}})
    grid, before = scene.body, images(scene)
    found = rb.bake.mesh(grid, resolution=128)
    surface = grid.oriented()
    assert torch.equal(found.vertex_positions[found.faces], surface.vertices[surface.faces])
    torch.testing.assert_close(found.vertex_normals[found.faces], surface.normals[surface.faces])
    uv = found.vertex_texcoords
    assert 0 <= uv.min() and uv.max() <= 1 and (uv.amax(0) - uv.amin(0)).min() > 0.8
    assert texels_of(uv, found.faces, 128, 128).shared == 0
    assert found.bsdf is grid.bsdf and found.emitter is None
    scene.body = found
    torch.testing.assert_close(images(scene), before, rtol=0, atol=1e-6)


def test_coordinates_that_are_there_stay_unless_new_ones_are_asked_for():
    scene = scene_of(lamp={"type": "cube", "to_world": POSE,
                           "emitter": {"type": "area", "radiance": 2.0}})
    before, surface = images(scene), scene.lamp.oriented()
    kept = rb.bake.mesh(scene.lamp)
    assert torch.equal(kept.vertex_texcoords, surface.uv) and kept.emitter is scene.lamp.emitter
    pytest.importorskip("xatlas")
    found = rb.bake.mesh(scene.lamp, unwrap=True, resolution=64)
    assert texels_of(kept.vertex_texcoords, kept.faces, 64, 64).shared > 1000
    assert texels_of(found.vertex_texcoords, found.faces, 64, 64).shared == 0
    scene.lamp = found
    assert before.max() > 1.5
    torch.testing.assert_close(images(scene), before, rtol=0, atol=1e-5)


def test_a_mesh_of_trimesh_is_baked_and_given_back():
    """Its material stays, and a network of positions is read where its surface coordinates put the texels."""
    pytest.importorskip("xatlas")
    ball = trimesh.creation.icosphere(1)
    ball.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(metallicFactor=0.25))
    found = rb.bake.mesh(ball, resolution=64)
    assert found.vertex_texcoords.shape == (len(found.vertex_positions), 2) and found.bsdf.metallic.value == 0.25
    back = found.to_trimesh()
    assert back.visual.uv.shape == (len(back.vertices), 2) and back.volume == pytest.approx(ball.volume, rel=1e-6)
    network = rb.NeuralTexture(torch.nn.Linear(3, 3), of="position")
    assert torch.equal(rb.bake.bitmap(network, 32, back).data, rb.bake.bitmap(network, 32, found).data)


def group_of(*materials):
    return {"type": "shapegroup", "box": {"type": "cube", "to_world": scale((0.3, 0.3, 0.3)), "bsdf": materials[0]}, "tip": {
        "type": "mesh", "vertex_positions": torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        "faces": [[0, 1, 2], [0, 3, 1], [1, 3, 2]], "bsdf": materials[-1]}}


RED = {"type": "ref", "id": "red"}
MATERIALS = {"red": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.2, 0.1]}},
             "blue": {"type": "diffuse"}}


def test_an_instance_of_a_group_becomes_one_mesh():
    """A box that has normals and a flat tip that has none, under a pose that mirrors."""
    pytest.importorskip("xatlas")
    scene = scene_of(**MATERIALS, group=group_of(RED),
                     body={"type": "instance", "shapegroup": {"type": "ref", "id": "group"}, "to_world": POSE})
    before = images(scene)
    found = rb.bake.mesh(scene.body)
    assert len(found.faces) == len(scene.group.box.faces) + 3 and found.bsdf is scene.red
    assert texels_of(found.vertex_texcoords, found.faces, 512, 512).shared == 0
    scene.body = found
    assert before.std() > 0.1
    torch.testing.assert_close(images(scene), before, rtol=0, atol=1e-5)


def test_a_group_becomes_a_mesh_in_its_own_frame():
    pytest.importorskip("xatlas")
    scene = scene_of(**MATERIALS, group=group_of(RED),
                     body={"type": "instance", "shapegroup": {"type": "ref", "id": "group"}, "to_world": POSE})
    found = rb.bake.mesh(scene.group).vertex_positions
    torch.testing.assert_close(found.amax(0), torch.ones(3))


@pytest.mark.hostile
def test_a_group_of_several_materials_is_no_mesh():
    scene = scene_of(**MATERIALS, group=group_of(RED, {"type": "ref", "id": "blue"}),
                     body={"type": "instance", "shapegroup": {"type": "ref", "id": "group"}})
    with pytest.raises(ValueError, match=r"a mesh has one material, and the shapes of the group, box, tip, have several"):
        rb.bake.mesh(scene.body)
    with pytest.raises(TypeError, match="a shape becomes a mesh, got Scene"):
        rb.bake.mesh(scene)


def test_attributes_follow_their_vertices_and_faces():
    pytest.importorskip("xatlas")
    scene = scene_of(body={"type": "cube"})
    cube = rb.bake.mesh(scene.body)
    cube.add_attribute("vertex_place", cube.vertex_positions.detach().clone())
    cube.add_attribute("face_number", torch.arange(12.0)[:, None])
    found = rb.bake.mesh(cube, unwrap=True)
    torch.testing.assert_close(found.vertex_place, found.vertex_positions)
    middle = found.vertex_positions[found.faces].mean(1)
    torch.testing.assert_close(middle, cube.vertex_positions[cube.faces].mean(1)[found.face_number[:, 0].long()])


def test_what_is_baked_comes_back_from_gltf_with_its_picture(tmp_path):
    """Its texels at the surface coordinates of vertices, by trimesh, whose v points up."""
    pytest.importorskip("xatlas")
    scene = scene_of(body={"type": "cube", "to_world": scale((0.4, 0.3, 0.2))})
    scene.body = rb.bake.mesh(scene.body, unwrap=True, resolution=256)
    places = torch.nn.Linear(3, 3)  # as colours
    places.load_state_dict({"weight": torch.eye(3), "bias": torch.full((3,), 0.5)})
    scene.body.bsdf.reflectance = rb.bake.bitmap(rb.NeuralTexture(places, of="position"), 256, scene.body)
    with pytest.warns(rb.GltfWarning):
        rb.save(scene, tmp_path / "found.glb")
    read = trimesh.load(tmp_path / "found.glb", force="mesh", process=False)
    material = read.visual.material
    column, row = (np.clip(part * 256, 0, 255).astype(int) for part in (read.visual.uv[:, 0], 1 - read.visual.uv[:, 1]))
    coded = np.asarray(material.baseColorTexture)[row, column, :3] / 255
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4) * material.baseColorFactor[:3] / 255
    assert np.abs(linear - 0.5 - read.vertices).max() < 0.02  # 8 bits of sRGB, and half a texel
