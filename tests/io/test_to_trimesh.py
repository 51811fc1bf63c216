"""Shapes and scenes as meshes and scenes of trimesh: current values, and what trimesh cannot say is said."""

import warnings

import numpy as np
import pytest
import torch
import trimesh

import torch_radbp as rb
from tests.io.trimesh_scenes import LOOK, assert_same, ball, image, loaded, material, picture
from torch_radbp.io.values.transform import rotate, scale, translate

POSE = translate((0.3, -0.2, 0.1)) @ rotate((1, 2, 3), 40) @ scale((0.5, 0.7, 0.6))


def converted(thing):
    """A shape or a scene without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return thing.to_trimesh()


def test_a_mesh_comes_back_as_it_was_given():
    mesh = ball()
    mesh.visual.material = material(baseColorTexture=picture(), metallicRoughnessTexture=picture(2))
    mesh.vertex_attributes["heat"] = np.arange(162.0)
    mesh.face_attributes["flow"] = np.ones((320, 3))
    back = converted(loaded(ball=mesh).ball)
    np.testing.assert_allclose(back.vertices, mesh.vertices, atol=1e-7)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    np.testing.assert_allclose(back.vertex_normals, mesh.vertex_normals, atol=1e-6)
    np.testing.assert_allclose(back.visual.uv, mesh.visual.uv, atol=1e-6)
    assert back.vertex_attributes["heat"][:, 0].tolist() == list(range(162))
    assert back.face_attributes["flow"].shape == (320, 3)
    theirs, ours = mesh.visual.material, back.visual.material
    assert ours.name == "bsdf"  # its place in the shape, as in the scene: ball.bsdf
    # Texels go through linear values and come back; 8 bits, and of the factor what trimesh rounds to 8 bits.
    for name in ("baseColorTexture", "metallicRoughnessTexture"):
        texels = [np.asarray(getattr(each, name), dtype=np.float64)[..., :3] for each in (theirs, ours)]
        factors = [np.asarray(each.baseColorFactor, dtype=np.float64)[:3] / 255 if name[0] == "b" else
                   np.array([0, each.roughnessFactor, each.metallicFactor]) for each in (theirs, ours)]
        if name[0] == "b":
            texels = [np.where(each < 10.3, each / 255 / 12.92, ((each / 255 + 0.055) / 1.055) ** 2.4) for each in texels]
        else:
            texels = [each / 255 for each in texels]
        np.testing.assert_allclose(texels[0] * factors[0], texels[1] * factors[1], atol=1 / 255)


@pytest.mark.parametrize("kind", ["vertex", "face"])
def test_colours_come_back_as_they_were_given(kind):
    mesh = trimesh.creation.icosphere(1)
    rows = len(mesh.vertices if kind == "vertex" else mesh.faces)
    colours = np.random.default_rng(0).integers(0, 256, (rows, 4)).astype(np.uint8)
    colours[:, 3] = 255
    setattr(mesh.visual, f"{kind}_colors", colours)
    back = converted(loaded(ball=mesh).ball)
    assert back.visual.kind == kind
    np.testing.assert_array_equal(getattr(back.visual, f"{kind}_colors"), colours)


def test_a_scene_comes_back_to_the_same_image():
    source = trimesh.Scene(camera=trimesh.scene.Camera(resolution=(24, 24), fov=(40, 40)),
                           camera_transform=trimesh.transformations.translation_matrix([0, 0.2, 4]))
    shapes = {"ball": ball(), "crate": trimesh.creation.box(), "lamp": trimesh.creation.icosphere(1, radius=0.2)}
    for number, (name, mesh) in enumerate(shapes.items()):
        uv = mesh.vertices[:, :2]
        mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material(
            name=f"{name}_look", emissiveFactor=[3, 2, 1] if name == "lamp" else None,
            baseColorTexture=picture(number) if name == "ball" else None))
        source.add_geometry(mesh, node_name=name, transform=translate((number - 1, 0, 0)) @ scale((0.4, 0.5, 0.4)))
    first = rb.scene_from_trimesh(source, light=0.5)
    with pytest.warns(rb.SceneWarning, match="trimesh: sky: a constant emitter is left out: only surfaces shine"):
        found = first.to_trimesh()
    assert {*found.graph.nodes_geometry} == {*shapes} and found.camera.resolution.tolist() == [24, 24]
    assert_same(image(first), image(rb.scene_from_trimesh(found, light=0.5)), atol=4e-3)  # texels are of 8 bits


def test_what_an_optimisation_moved_is_in_the_mesh():
    """Positions, colours and the pose, as they are after a few steps."""
    start = trimesh.creation.icosphere(1)
    start.visual.vertex_colors = np.full((42, 4), 128, dtype=np.uint8)
    with pytest.warns(UserWarning, match="opacity"):
        scene = loaded(ball=start)
    names = ("ball.vertex_positions", "ball.vertex_color", "ball.to_world")
    parameters = [scene.get_parameter(name).requires_grad_() for name in names]
    optimizer = torch.optim.Adam(parameters, lr=0.01)
    for step in range(3):
        optimizer.zero_grad()
        rb.render(scene, spp=8, seed=step).mean().backward()
        for parameter in parameters[2:]:
            parameter.grad[3] = 0  # it stays affine
        optimizer.step()
    back = converted(scene.ball)
    now = scene.ball.triangles().vertices.detach().numpy()
    np.testing.assert_allclose(back.vertices, now, atol=1e-6)
    np.testing.assert_allclose(back.visual.vertex_colors[:, :3] / 255, parameters[1].detach().numpy(), atol=0.5 / 255 + 1e-6)
    moved = np.linalg.norm(back.vertices - start.vertices, axis=1)
    assert moved.max() > 0.01 and (back.visual.vertex_colors != start.visual.vertex_colors).any()
    assert_same(image(scene), image(loaded(ball=back)), atol=4e-3)  # colours are rounded to half of 1 / 255


SHAPES = {"sphere": {"type": "sphere", "to_world": POSE}, "cube": {"type": "cube", "to_world": POSE},
          "mirrored": {"type": "cube", "to_world": POSE @ scale((1, 1, -1))}, "disk": {"type": "disk"},
          "turned": {"type": "sphere", "flip_normals": True},
          "mesh": {"type": "mesh", "vertex_positions": torch.eye(3), "faces": torch.tensor([[0, 1, 2]]), "to_world": POSE}}


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_is_a_mesh_of_its_triangles(name):
    shape = loaded(thing=SHAPES[name]).thing
    with pytest.warns(rb.SceneWarning, match="KHR_materials_specular"):
        mesh = shape.to_trimesh()
    surface = shape.oriented()
    np.testing.assert_allclose(mesh.triangles, surface.vertices[surface.faces].detach().numpy(), atol=1e-6)
    if surface.normals is not None:
        np.testing.assert_allclose(mesh.vertex_normals, surface.normals.detach().numpy(), atol=1e-6)


def test_values_are_those_of_float64_too():
    torch.set_default_dtype(torch.float64)
    try:
        mesh = ball()
        mesh.visual.material = material()
        np.testing.assert_array_equal(converted(loaded(ball=mesh).ball).vertices, mesh.vertices)
    finally:
        torch.set_default_dtype(torch.float32)


def test_instances_are_nodes_that_show_one_mesh():
    group = {"type": "shapegroup", "part": trimesh.Scene(ball())}
    scene = loaded(group=group, **{name: {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": place}
                                   for name, place in (("one", translate((1, 0, 0))), ("two", POSE))})
    with pytest.warns(rb.SceneWarning, match="sky: a constant emitter is left out.* lamp: a point emitter is left out"):
        found = scene.to_trimesh()
    assert [*found.geometry] == ["group_part"] and {*found.graph.nodes_geometry} == {"one_part", "two_part"}
    np.testing.assert_allclose(found.graph["two_part"][0], POSE, atol=1e-6)


def test_what_trimesh_has_no_place_for_is_said():
    bitmap = {"type": "bitmap", "data": torch.rand(4, 4, 3), "wrap_mode": "clamp"}
    scene = loaded(ball={"type": "mesh", "mesh": ball(), "bsdf": {"type": "principled", "base_color": bitmap, "eta": 1.8}},
                   other={"type": "thinlens", "to_world": LOOK["to_world"], "aperture_radius": 0.1, "focus_distance": 4.0})
    with pytest.warns(rb.SceneWarning) as caught:
        scene.to_trimesh()
    said, = (str(each.message) for each in caught)
    for words in ("ball.bsdf: what KHR_materials_ior says is not kept", "baseColorTexture: wrap_mode, filter_type and to_uv",
                  "other: is left out: a trimesh.Scene has one camera", "sky: a constant emitter", "lamp: a point emitter"):
        assert words in said


def test_a_version_that_takes_less_emission_is_said(monkeypatch):
    """trimesh before 4.11.5 refuses factors above 1."""
    kind = trimesh.visual.material.PBRMaterial
    newer = kind.emissiveFactor

    def limited(material, value):
        if value is not None and np.max(value) > 1:
            raise ValueError("all factors must be between 0.0-1.0")
        newer.fset(material, value)

    mesh = ball()
    mesh.visual.material = material(emissiveFactor=[3, 1.5, 0])
    scene = loaded(ball=mesh)
    monkeypatch.setattr(kind, "emissiveFactor", property(newer.fget, limited))
    with pytest.warns(rb.SceneWarning, match="it emits 3 times as much: this version of trimesh takes 1 at most"):
        assert scene.ball.to_trimesh().visual.material.emissiveFactor.tolist() == [1, 0.5, 0]


def test_the_grey_of_a_mesh_without_a_look_becomes_a_material():
    mesh = trimesh.creation.icosphere(1)
    with pytest.warns(rb.SceneWarning, match="KHR_materials_specular"):
        back = loaded(ball=mesh).ball.to_trimesh()
    assert back.visual.material.baseColorFactor.tolist() == [128, 128, 128, 255]
