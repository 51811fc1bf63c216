"""A scene that is saved as glTF is the same scene, and the file keeps to the specification."""

import json
import math
import warnings

import numpy as np
import pytest
import torch
import trimesh

import torch_radbp as rb
from tests.io.gltf_everything import everything
from tests.io.gltf_files import SQUARE_FACES
from tests.io.gltf_rules import check_rules
from tests.scenes.everything import EVERYTHING as EVERY_PLUGIN
from tests.scenes.everything import build_everything
from torch_radbp.formats.image import linear_to_srgb, srgb_to_linear
from torch_radbp.io.gltf.document import GltfWarning
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.plugin import SceneError

LOOK = {"type": "perspective", "fov": 40, "to_world": rb.look_at([0.4, 0.6, 4], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 24, "height": 16}}
LAMP = {"type": "rectangle", "to_world": translate((0.5, 1.2, 1.5)) @ rotate((1, 0, 0), 110) @ scale((0.4, 0.4, 0.4)),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [40.0, 30.0, 20.0]}}}
FLOOR = {"type": "rectangle", "to_world": translate((0, -0.7, 0)) @ rotate((1, 0, 0), -90) @ scale((2, 2, 2)),
         "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.25, 0.125]}}}
POSE = translate((0.2, 0.1, 0)) @ rotate((0, 1, 0), 25) @ rotate((1, 0, 0), 20) @ scale((0.6, 0.5, 0.4))


def film(width, height, **more):
    return {"type": "hdrfilm", "width": width, "height": height, **more}


def levels(*shape, seed=0):
    """Numbers that 8 bits can hold."""
    return torch.from_numpy(np.random.default_rng(seed).integers(0, 256, shape) / 255.0)


def bitmap(*shape, seed=0, **more):
    return {"type": "bitmap", "data": levels(*shape, seed=seed), **more}


def colour_bitmap(seed=0, **more):
    """Colours that 8 bits of sRGB can hold."""
    return {"type": "bitmap", "data": srgb_to_linear(levels(5, 4, 3, seed=seed)), **more}


def scene_of(**objects):
    return rb.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 4}, "sensor": LOOK, "lamp": LAMP,
                         "floor": FLOOR, **objects})


def box_of(bsdf, **more):
    return scene_of(gold=bsdf, box={"type": "cube", "to_world": POSE, "bsdf": {"type": "ref", "id": "gold"}, **more})


def saved(scene, folder, name="asset.glb", **options):
    """The scene that comes back from a file, which keeps to the rules."""
    path = folder / name
    with warnings.catch_warnings():
        warnings.simplefilter("error", GltfWarning)
        rb.save(scene, path, strict=True)
        check_rules(path)
        return rb.load(path, **{"max_depth": 4, "strict": True, **options})


def principled(**more):
    return {"type": "principled", "base_color": {"type": "rgb", "value": [0.8, 0.4, 0.2]}, "roughness": 0.4, **more}


ROTATED = {"to_uv": translate((0.3, 0.2, 0)) @ rotate((0, 0, 1), -25) @ scale((2, -1.5, 1))}
MATERIALS = {
    "principled": principled(metallic=0.3),
    "principled of glass": principled(spec_trans=0.8, eta=1.4),
    "principled by specular": principled(specular=0.3),
    "principled, brushed": principled(anisotropic=0.5, metallic=1.0),
    "principled, textures": principled(base_color=colour_bitmap(), roughness=bitmap(5, 4, 1, seed=1),
                                       metallic=bitmap(5, 4, 1, seed=2)),
    "principled, roughness": principled(roughness=bitmap(5, 4, 1, seed=1), metallic=0.25),
    "principled, transmission": principled(spec_trans=bitmap(3, 4, 1), eta=1.5),
    "principled, samplers": principled(base_color=colour_bitmap(filter_type="nearest", wrap_mode="mirror", **ROTATED),
                                       roughness=bitmap(4, 4, 1, wrap_mode="clamp")),
    "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.3, 0.9]}},
    "diffuse, checkerboard": {"type": "diffuse", "reflectance": {
        "type": "checkerboard", "color0": [1.0, 1.0, 0.0], "color1": [0.0, 0.0, 1.0], "to_uv": scale((3, 3, 1))}},
    "both sides": {"type": "twosided", "nested": principled()},
    "normal map": {"type": "normalmap", "nested": principled(metallic=1.0),
                   "normalmap": {"type": "bitmap", "data": (100 + levels(4, 4, 3, seed=3) * 155).round() / 255}},
    "mask": {"type": "mask", "opacity": 0.3, "nested": principled()},
    "mask, texture": {"type": "mask", "opacity": bitmap(5, 4, 1, seed=4), "nested": principled(base_color=colour_bitmap())},
    "mask, cut out": {"type": "mask", "nested": {"type": "diffuse"}, "opacity": {
        "type": "bitmap", "data": torch.tensor([[0.0, 1.0], [1.0, 0.0]]), "filter_type": "nearest"}},
    "all around": {"type": "mask", "opacity": 0.7, "nested": {"type": "twosided", "nested": {
        "type": "normalmap", "normalmap": [0.8, 0.6, 1.0], "nested": principled(base_color=colour_bitmap(seed=5))}}},
    "rough metal": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.25},
    "brushed metal": {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.3, "alpha_v": 0.2},
}


def images(scene, other, spp=16):
    return [rb.render(each, spp=spp, seed=1)[0] for each in (scene, other)]


@pytest.mark.parametrize("case", MATERIALS)
def test_a_material_comes_back_with_the_same_image(tmp_path, case):
    """The same random numbers meet the same surfaces, so that images differ by rounding, and at edges by single samples.

    But metals become `principled`, which is sampled in another way: there it is the noise of 2048 samples.
    """
    scene = box_of(MATERIALS[case])
    before, after = images(scene, saved(scene, tmp_path), 2048 if "metal" in case else 16)
    assert before.mean() > 0.05
    assert (before - after).abs().mean() < 0.004 * before.mean()


def test_parameters_come_back_under_their_names(tmp_path):
    scene = box_of(MATERIALS["principled, textures"])
    other = saved(scene, tmp_path)
    for name in ("gold.base_color.data", "gold.roughness.data", "gold.metallic.data", "lamp.emitter.radiance.value",
                 "sensor.to_world", "sensor.x_fov", "box.to_world"):
        torch.testing.assert_close(other.get_parameter(name), scene.get_parameter(name), rtol=1e-5, atol=1e-6)
    assert other.get_submodule("box").bsdf is other.get_submodule("gold")


def test_a_material_that_emits_in_one_place_is_two_in_a_file_and_no_shape_loses_its_name(tmp_path):
    scene = rb.load_dict({"type": "scene", "sensor": LOOK, "gold": principled(), **{
        name: {**LAMP, "bsdf": {"type": "ref", "id": "gold"}} for name in ("gold_1", "gold_2")}})
    other = saved(scene, tmp_path)
    assert [other.name_of(shape) for shape in other.shapes] == ["gold_1", "gold_2"]
    assert [other.name_of(shape.bsdf) for shape in other.shapes] == ["gold", "gold_3"]


def test_values_between_the_levels_of_8_bits_are_rounded_relative_to_the_largest(tmp_path):
    dark = 0.05 * levels(8, 8, 3, seed=6)
    grey = {"type": "bitmap", "data": dark[..., :1]}
    scene = box_of(principled(base_color={"type": "bitmap", "data": dark}, roughness=grey))
    other = saved(scene, tmp_path)
    for name, limit in (("base_color", 0.05 * 0.006), ("roughness", 0.05 / 510 * 1.001)):
        found, expected = (each.get_parameter(f"gold.{name}.data").detach() for each in (other, scene))
        assert 0 < expected.max() and (found - expected).abs().max() <= limit


def test_lights_and_cameras_come_back(tmp_path):
    pose = rb.look_at([1, 2, 3], [0, 0, 0.1], [0, 1, 0])
    scene = scene_of(
        bulb={"type": "point", "position": [1, 2, 3], "intensity": {"type": "rgb", "value": [3.0, 2, 1]}},
        stage={"type": "spot", "to_world": pose, "cutoff_angle": 30, "beam_width": 10, "intensity": 4.0},
        sun={"type": "directional", "direction": [0.1, -1, 0.3], "irradiance": 0.5},
        plan={"type": "orthographic", "near_clip": 0.5, "far_clip": 30, "film": film(20, 10),
              "to_world": rb.look_at([0, 5, 0.1], [0, 0, 0], [0, 0, 1]).numpy() @ scale((3, 3, 1))})
    other = saved(scene, tmp_path)
    for name in ("bulb.position", "bulb.intensity.value", "stage.to_world", "stage.cutoff_angle", "stage.beam_width",
                 "plan.to_world", "sensor.x_fov"):
        torch.testing.assert_close(other.get_parameter(name), scene.get_parameter(name), rtol=1e-5, atol=1e-6)
    assert other.get_submodule("stage").intensity.value.tolist() == [4.0] * 3
    torch.testing.assert_close(other.get_submodule("sun").towards(), scene.get_submodule("sun").towards())
    assert [(s.film.width, s.film.height, round(s.near_clip, 6), round(s.far_clip, 3)) for s in other.sensors] == [
        (24, 16, 0.01, 1e4), (20, 10, 0.5, 30)]
    before, after = (rb.Renderer(each, spp=16)(seed=1, sensors=[0])[0] for each in (scene, other))
    assert (before - after).abs().mean() < 0.004 * before.mean()


def test_trimesh_sees_the_same_triangles(tmp_path):
    positions = torch.rand(9, 3, generator=torch.Generator().manual_seed(2))
    mesh = {"type": "mesh", "vertex_positions": positions, "faces": torch.tensor([[0, 1, 2], [3, 4, 5], [6, 7, 8]])}
    mirrored = POSE @ scale((-1, 1, 1))
    scene = scene_of(mesh={**mesh, "to_world": POSE}, turned={**mesh, "to_world": mirrored, "flip_normals": True},
                     disk={"type": "disk", "to_world": POSE})
    with torch.no_grad():
        scene.get_parameter("mesh.to_world")[0, 3] += 2
    rb.save(scene, tmp_path / "asset.glb")
    check_rules(tmp_path / "asset.glb")
    theirs = trimesh.load(tmp_path / "asset.glb")
    for shape in scene.shapes:
        surface = shape.oriented()
        ours = surface.vertices[surface.faces].detach().numpy()
        transform, geometry = theirs.graph[scene.name_of(shape)]
        found = trimesh.transform_points(theirs.geometry[geometry].vertices, transform)[theirs.geometry[geometry].faces]
        if np.linalg.det(transform) < 0:  # which turns triangles round, by the specification
            found = found[:, [0, 2, 1]]
        assert len(found) == len(ours)
        np.testing.assert_allclose(found, ours, atol=1e-5)


def test_trimesh_sees_the_same_material(tmp_path):
    gold = principled(base_color=colour_bitmap(), roughness=bitmap(5, 4, 1, seed=1), metallic=0.25)
    scene = scene_of(gold=gold, both={"type": "twosided", "nested": {"type": "ref", "id": "gold"}},
                     box={"type": "cube", "bsdf": {"type": "mask", "opacity": 0.5, "nested": {"type": "ref", "id": "both"}}})
    rb.save(scene, tmp_path / "asset.glb", strict=True)
    theirs = trimesh.load(tmp_path / "asset.glb").geometry["box"].visual.material
    assert theirs.name == "gold" and theirs.doubleSided and theirs.alphaMode == "BLEND"
    assert theirs.metallicFactor == 0.25 and theirs.roughnessFactor == 1
    assert theirs.baseColorFactor.tolist() == [255, 255, 255, 128]
    colours = linear_to_srgb(scene.get_parameter("gold.base_color.data").detach()) * 255
    np.testing.assert_array_equal(np.asarray(theirs.baseColorTexture)[..., :3], colours.round().numpy())
    rough = np.asarray(theirs.metallicRoughnessTexture)
    np.testing.assert_array_equal(rough[..., 1], (scene.get_parameter("gold.roughness.data")[..., 0] * 255).round().detach())


def test_a_sheared_pose_is_written_into_the_vertices(tmp_path):
    shear = np.eye(4)
    shear[0, 1] = 0.7
    scene = scene_of(box={"type": "cube", "to_world": POSE @ shear})
    other = saved(scene, tmp_path)
    found, expected = (each.get_submodule("box").triangles().vertices for each in (other, scene))
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("name", ["asset.glb", "asset.gltf"])
def test_saving_twice_writes_the_same_bytes(tmp_path, name):
    scene = box_of(MATERIALS["all around"])
    saved(scene, tmp_path, name)
    first = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    saved(scene, tmp_path, name)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == first
    assert sorted(first) == (["asset.glb"] if name == "asset.glb" else ["asset.bin", "asset.gltf"])


def test_a_buffer_is_named_by_a_uri(tmp_path):
    saved(box_of(principled()), tmp_path, "a b %41.gltf")
    text = (tmp_path / "a b %41.gltf").read_text()
    assert '"a%20b%20%2541.bin"' in text and (tmp_path / "a b %41.bin").exists()


def test_a_file_that_is_loaded_and_saved_says_the_same(tmp_path):
    first = rb.load(everything().save(tmp_path / "asset.glb"), resolution=30, strict=True)
    second = saved(first, tmp_path, "again.glb", max_depth=-1)
    ours, theirs = dict(first.named_parameters()), dict(second.named_parameters())
    assert set(ours) == set(theirs)
    for name, value in ours.items():
        one, other = (each.detach() for each in (value, theirs[name]))
        if name.endswith("normalmap.data"):  # a factor is in its texels now, which have unit length
            one, other = (torch.nn.functional.normalize(2 * each - 1, dim=2) for each in (one, other))
        limit = 1.5 / 255 * max(1.0, float(one.max())) if name.endswith(".data") else 1e-5
        torch.testing.assert_close(other, one, rtol=0, atol=limit, msg=name)
    before, after = images(first, second)
    assert (before - after).abs().mean() < 0.01 * before.mean()


def sky(**more):
    """An environment map that turns all places into another light."""
    return {"type": "envmap", "bitmap": 0.1 + torch.rand(6, 9, 3, generator=torch.Generator().manual_seed(5)), **more}


@pytest.mark.parametrize("name", ["asset.glb", "my asset #1.gltf"])
@pytest.mark.parametrize("more", [{}, {"scale": 2.5, "to_world": rotate((1, 2, 3), 50)}])
def test_an_environment_map_is_written_beside_and_found_there(tmp_path, name, more):
    scene, path = scene_of(**{"sky light": sky(**more)}), tmp_path / name
    with pytest.warns(GltfWarning, match="sky light: glTF has no environment maps: it is written beside as .*sky light.exr"):
        rb.save(scene, path)
    check_rules(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error", GltfWarning)
        other = rb.load(path, max_depth=4)
    light = other.get_submodule("sky light")
    torch.testing.assert_close(light.data, scene.get_submodule("sky light").data * more.get("scale", 1.0))
    before, after = images(scene, other)
    assert before.mean() > 0.1
    assert (before - after).abs().mean() < 0.004 * before.mean()


def test_an_environment_map_whose_file_is_gone_is_missed_and_one_outside_refused(tmp_path):
    with pytest.warns(GltfWarning):
        rb.save(scene_of(sky=sky()), tmp_path / "asset.gltf")
    (tmp_path / "asset_sky.exr").rename(tmp_path.parent / "asset_sky.exr")
    with pytest.warns(GltfWarning, match=r"nodes\[\d\].*: its environment map is not read: there is no .*asset_sky.exr"):
        assert not hasattr(rb.load(tmp_path / "asset.gltf"), "sky")
    assert rb.load(tmp_path / "asset.gltf", light=0.5).sky.type == "constant"
    text = (tmp_path / "asset.gltf").read_text().replace("asset_sky.exr", "../asset_sky.exr")
    (tmp_path / "asset.gltf").write_text(text)
    with pytest.raises(SceneError, match="leads out of the folder of the document"):
        rb.load(tmp_path / "asset.gltf")
    assert rb.load(tmp_path / "asset.gltf", allow_outside=True).sky.type == "envmap"


@pytest.mark.hostile
@pytest.mark.parametrize("extras", ['"note"', "[1]", '{"environment": 3}', '{"environment": {"uri": null}}'])
def test_extras_of_others_are_left_alone(tmp_path, extras):
    with pytest.warns(GltfWarning):
        rb.save(scene_of(sky=sky()), tmp_path / "asset.gltf")
    document = json.loads((tmp_path / "asset.gltf").read_text())
    next(node for node in document["nodes"] if node["name"] == "sky")["extras"] = json.loads(extras)
    (tmp_path / "asset.gltf").write_text(json.dumps(document))
    assert not hasattr(rb.load(tmp_path / "asset.gltf"), "sky")


def calibrated(**more):
    return {"type": "calibrated", "fx": 33.0, "film": film(24, 16), "to_world": LOOK["to_world"], **more}


def test_a_calibrated_camera_that_is_a_pinhole_comes_back_as_a_perspective_of_the_same_image(tmp_path):
    scene = rb.load_dict({"type": "scene", "sensor": calibrated(k1=0.0), "lamp": LAMP, "floor": FLOOR})
    other = saved(scene, tmp_path)
    assert [sensor.type for sensor in other.sensors] == ["perspective"]
    before, after = images(scene, other)
    assert before.mean() > 0.05
    assert (before - after).abs().mean() < 0.004 * before.mean()


LOSSES = {
    "surround": (lambda: scene_of(sky={"type": "constant"}), "sky: a constant emitter has no counterpart in glTF"),
    "ball": (lambda: scene_of(ball={"type": "sphere"}), r"ball: a sphere is written as \d+ triangles"),
    "metal": (lambda: box_of({"type": "roughconductor", "material": "Au"}), "gold: its reflectance .*its beckmann"),
    "lens": (lambda: rb.load_dict({"type": "scene", "lamp": LAMP, "sensor": calibrated(k1=0.1, fy=30.0)}),
             "sensor: its k1, fx other than fy is not written: cameras of glTF are pinholes"),
    "principal point": (lambda: rb.load_dict({"type": "scene", "lamp": LAMP, "sensor": calibrated(cx=13.0)}),
                        "sensor: its principal point is written as the middle"),
    "fisheye": (lambda: rb.load_dict({"type": "scene", "lamp": LAMP, "sensor": calibrated(distortion="fisheye")}),
                "sensor: a calibrated sensor has no counterpart in glTF"),
    "sky": (lambda: scene_of(sky=sky()), "sky: glTF has no environment maps: it is written beside as asset_sky.exr"),
    "blend": (lambda: box_of({"type": "blendbsdf", "weight": 0.5, "a": principled(), "b": {"type": "diffuse"}}),
              "gold: of a blendbsdf the first material is written alone"),
    "tint": (lambda: box_of(principled(spec_tint=0.5)), "gold: spec_tint is not written"),
    "coat": (lambda: box_of(principled(clearcoat=0.5)), "gold: clearcoat is four times as strong"),
    "back": (lambda: box_of({"type": "twosided", "a": principled(), "b": {"type": "diffuse"}}), "its back is not written"),
    "sizes": (lambda: box_of(principled(roughness=bitmap(4, 4, 1), metallic=bitmap(8, 8, 1))), "from 4 x 4 to 8 x 8"),
    "two ways": (lambda: box_of(principled(roughness=bitmap(4, 4, 1), metallic=bitmap(4, 4, 1, wrap_mode="clamp"))),
                 "metallic is written as its mean"),
    "beam": (lambda: box_of(principled(), emitter={"type": "directionalarea"}), "box.emitter: a directionalarea emitter"),
    "plastic": (lambda: box_of({"type": "plastic"}), "of a plastic is not written"),
    "crop": (lambda: rb.load_dict({"type": "scene", "lamp": LAMP, "sensor": {
        "type": "perspective", "film": {"type": "hdrfilm", "crop_width": 10}}}), "its crop window is not written"),
    "fog": (lambda: rb.load_dict({"type": "scene", "lamp": LAMP, "sensor": {
        "type": "perspective", "medium": {"type": "homogeneous"}}}), "sensor.medium: a homogeneous medium is not written"),
}


@pytest.mark.parametrize("case", LOSSES)
def test_what_gltf_cannot_say_is_said_by_name(tmp_path, case):
    build, message = LOSSES[case]
    scene, path = build(), tmp_path / "asset.glb"
    with pytest.raises(SceneError, match=f"asset.glb: .*{message}"):
        rb.save(scene, path, strict=True)
    assert not list(tmp_path.iterdir())
    with pytest.warns(GltfWarning, match=f"asset.glb: .*{message}") as caught:
        rb.save(scene, path)
    assert len(caught) == 1 and caught[0].filename == __file__
    check_rules(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GltfWarning)
        rb.load(path)


@pytest.mark.parametrize("name", EVERY_PLUGIN)
def test_every_plugin_is_written_or_named(tmp_path, name):
    """`tests.scenes.everything` has every plugin; what is left of them keeps to the rules and can be loaded."""
    scene, path = build_everything(name, torch.float32), tmp_path / "asset.glb"
    with pytest.warns(GltfWarning) as caught:
        rb.save(scene, path)
    said = str(caught[0].message)
    document = check_rules(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GltfWarning)
        other = rb.load(path)
    assert len(other.shapes) >= len(scene.shapes)  # an instance is as many as its group has
    nodes = [node["name"] for node in document["nodes"]]
    for child, plugin in scene.named_children():
        if plugin.category in ("shape", "emitter", "sensor"):
            assert child in nodes or f"{child}_0" in nodes or child in said or " more" in said


def test_a_network_cannot_be_written(tmp_path):
    scene = box_of({"type": "diffuse", "reflectance": torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Sigmoid())})
    with pytest.raises(SceneError, match=r"gold\.reflectance: a NeuralTexture cannot be written as glTF; put a bitmap"):
        rb.save(scene, tmp_path / "asset.glb")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name, value", [("box.vertex_positions", torch.inf), ("gold.base_color.value", torch.nan)])
def test_values_that_are_not_finite_leave_the_old_file_alone(tmp_path, name, value):
    scene, path = box_of(principled()), tmp_path / "asset.glb"
    rb.save(scene, path)
    before = path.read_bytes()
    with torch.no_grad():
        scene.get_parameter(name).fill_(value)
    with pytest.raises(SceneError, match=rf"{name.removesuffix('.value')}.*: not written, it has values that are NaN"):
        rb.save(scene, path)
    assert path.read_bytes() == before and [file.name for file in tmp_path.iterdir()] == ["asset.glb"]


def test_a_loaded_file_is_written_as_xml_of_the_same_image(tmp_path):
    scene = rb.load(everything().save(tmp_path / "asset.glb"), resolution=30)
    rb.save(scene, tmp_path / "scene.xml")
    before, after = images(scene, rb.load(tmp_path / "scene.xml"))
    assert (before - after).abs().mean() < 1e-3 * before.mean()


def test_large_meshes_have_indices_of_four_bytes(tmp_path):
    corners = 3 * 22000
    angle = torch.linspace(0, math.pi, corners)
    mesh = {"type": "mesh", "vertex_positions": torch.stack([angle.cos(), angle.sin(), angle], 1),
            "faces": torch.arange(corners).reshape(-1, 3)}
    other = saved(scene_of(mesh=mesh), tmp_path)
    assert torch.equal(other.get_submodule("mesh").faces, torch.arange(corners).reshape(-1, 3))
    small = {**mesh, "vertex_positions": torch.rand(4, 3), "faces": torch.tensor(SQUARE_FACES).reshape(2, 3)}
    small = saved(scene_of(mesh=small), tmp_path)
    assert small.get_submodule("mesh").faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_colours_of_faces_are_written_as_means_around_vertices(tmp_path):
    """A corner of one triangle has its colour, one of two their mean; glTF has colours of vertices only."""
    sheet = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    sheet.visual.face_colors = [[204, 51, 0, 255], [0, 102, 153, 255]]
    scene = scene_of(sheet=sheet)
    with pytest.warns(GltfWarning, match="sheet.face_color: is written as means around vertices: glTF has none of faces"):
        rb.save(scene, tmp_path / "asset.glb")
    found = rb.load(tmp_path / "asset.glb").sheet
    first, second = (torch.tensor(colour) for colour in ([0.8, 0.2, 0.0], [0.0, 0.4, 0.6]))
    torch.testing.assert_close(found.vertex_color, torch.stack([(first + second) / 2, first, (first + second) / 2, second]))
