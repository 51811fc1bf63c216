"""What a glTF file says is what the scene has.

Reference: Khronos Group 2021, "glTF 2.0 Specification", sections 3.6 to 3.10, and its extensions.
"""

import math
import re
import warnings

import numpy as np
import pytest
import torch
import trimesh

import torch_radbp as rb
from tests.io.gltf_files import SQUARE, SQUARE_FACES, GltfFile
from tests.io.gltf_loading import lamp, load_quietly, load_with_loss
from torch_radbp.formats.image import srgb_to_linear
from torch_radbp.io.gltf.document import GltfWarning
from torch_radbp.plugin import SceneError


@pytest.fixture
def file():
    return GltfFile()


def material(file, folder, extensions=None, **entries):
    """The scene of a square with a material called gold."""
    more = {"extensions": extensions} if extensions else {}
    file.node(file.square(file.add("materials", name="gold", **entries, **more)), name="sheet")
    return load_quietly(file, folder)


@pytest.mark.parametrize("name", ["asset.glb", "asset.gltf"])
def test_a_mesh_is_what_its_accessors_say(file, tmp_path, name):
    file.node(file.square(), name="sheet")
    scene = load_quietly(file, tmp_path, name)
    sheet = scene.get_submodule("sheet")
    assert sheet.vertex_positions.tolist() == SQUARE and sheet.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert sheet.vertex_normals.tolist() == [[0, 0, 1]] * 4
    assert sheet.vertex_texcoords.tolist() == [[0, 1], [1, 1], [1, 0], [0, 0]]


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32"])
def test_indices_have_any_integer_type(file, tmp_path, dtype):
    file.node(file.square() | {"indices": file.array(SQUARE_FACES, dtype)}, name="sheet")
    assert load_quietly(file, tmp_path).get_submodule("sheet").faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("mode, indices, faces", [
    (4, None, [[0, 1, 2]]), (5, [0, 1, 3, 2], [[0, 1, 3], [1, 2, 3]]), (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
    (5, [0, 1, 3, 2, 1], [[0, 1, 3], [1, 2, 3], [3, 2, 1]]),
])
def test_lists_strips_and_fans_become_triangles(file, tmp_path, mode, indices, faces):
    more = {} if indices is None else {"indices": file.array(indices, "uint8")}
    positions = SQUARE[:3] if indices is None else SQUARE
    file.node({"attributes": {"POSITION": file.array(positions)}, "mode": mode, **more}, name="sheet")
    sheet = load_quietly(file, tmp_path).get_submodule("sheet")
    assert sheet.faces.tolist() == faces and not sheet.has_normals


def test_points_and_lines_are_a_loss(file, tmp_path):
    file.node(file.square(), {**file.square(), "mode": 1}, name="sheet")
    scene = load_with_loss(file, tmp_path, r"meshes\[0\]\.primitives\[1\]: lines are not read")
    assert [scene.name_of(shape) for shape in scene.shapes] == ["sheet_0"]


def test_accessors_may_be_interleaved_normalised_and_sparse(file, tmp_path):
    block = np.zeros(4, dtype=[("p", "<f4", 3), ("uv", "<u2", 2)])
    block["p"], block["uv"] = SQUARE, [[0, 65535], [65535, 65535], [65535, 0], [0, 0]]
    view = file.view(block.tobytes(), byteStride=16)
    rows, corner = file.view(np.array([2], "u1").tobytes()), file.view(np.array([[1, 1, 5]], "<f4").tobytes())
    positions = file.add("accessors", bufferView=view, componentType=5126, count=4, type="VEC3",
                         sparse={"count": 1, "indices": {"bufferView": rows, "componentType": 5121},
                                 "values": {"bufferView": corner}})
    uv = file.add("accessors", bufferView=view, byteOffset=12, componentType=5123, count=4, type="VEC2", normalized=True)
    indices = file.array(SQUARE_FACES, "uint8")
    file.node({"attributes": {"POSITION": positions, "TEXCOORD_0": uv}, "indices": indices}, name="s")
    sheet = load_quietly(file, tmp_path).get_submodule("s")
    assert sheet.vertex_positions.tolist() == [*SQUARE[:2], [1, 1, 5], SQUARE[3]]
    assert sheet.vertex_texcoords.tolist() == [[0, 1], [1, 1], [1, 0], [0, 0]]


def test_nodes_are_placed_by_their_parents(file, tmp_path):
    half = math.sqrt(0.5)
    child = file.node(file.square(), root=False, name="sheet", translation=[1, 0, 0], scale=[2, 1, 1])
    file.node(name="frame", rotation=[0, 0, half, half], translation=[0, 0, 3], children=[child])
    matrix = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 3, 1]  # the same turn about z, column after column
    other = file.node(file.square(), root=False, name="other", translation=[1, 0, 0], scale=[2, 1, 1])
    file.node(matrix=matrix, children=[other])
    scene = load_quietly(file, tmp_path)
    expected = torch.tensor([[-y, 2.0 * x + 1, z + 3] for x, y, z in SQUARE])
    for name in ("sheet", "other"):
        torch.testing.assert_close(scene.get_parameter(f"{name}.vertex_positions").detach(), expected, rtol=0, atol=1e-6)
        assert scene.get_parameter(f"{name}.to_world")[1, 0] == pytest.approx(2, abs=1e-6)


def test_a_mirrored_node_faces_outwards_still(file, tmp_path):
    file.node(file.square(), name="sheet", scale=[-1, 1, 1])
    surface = load_quietly(file, tmp_path).get_submodule("sheet").triangles()
    a, b, c = surface.vertices[surface.faces[0]]
    assert torch.linalg.cross(b - a, c - a)[2] > 0 and surface.normals[0, 2] == 1


def test_a_mesh_of_two_nodes_is_copied_and_its_material_is_shared(file, tmp_path):
    gold = file.add("materials", name="gold")
    first = file.node(file.square(gold), name="left")
    file.node(name="right", mesh=file.document["nodes"][first]["mesh"], translation=[3, 0, 0])
    scene = load_quietly(file, tmp_path)
    left, right = scene.shapes
    assert left.bsdf is right.bsdf and left.vertex_positions is not right.vertex_positions
    names = set(dict(scene.named_parameters()))
    assert {"gold.base_color.value", "left.vertex_positions", "right.vertex_positions"} <= names


def test_names_are_made_unique_and_usable(file, tmp_path):
    file.node(file.square(file.add("materials", name="a.b")), name="a.b")
    file.node(file.square(file.add("materials", name="a.b")), name="train")
    file.node(file.square(file.add("materials")))
    names = [name for name, _ in load_quietly(file, tmp_path).named_children()]
    assert names == ["a_b", "a_b_1", "a_b_2", "train_", "material_2", "mesh_2", "sky", "camera"]


def test_numbers_of_a_material_are_those_of_principled(file, tmp_path):
    gold = material(file, tmp_path, pbrMetallicRoughness={"baseColorFactor": [1, 0.5, 0.25, 0.3], "metallicFactor": 0.75,
                                                          "roughnessFactor": 0.5}).get_submodule("gold")
    assert gold.type == "principled" and gold.base_color.value.tolist() == [1, 0.5, 0.25]
    assert gold.metallic.value == 0.75 and gold.roughness.value == 0.5 and gold.specular == 0.5


def test_what_is_not_given_is_rough_metal(file, tmp_path):
    file.node(file.square(), name="sheet")
    default = load_quietly(file, tmp_path).get_submodule("default")
    assert default.metallic.value == 1 and default.roughness.value == 1 and default.base_color.value.tolist() == [1, 1, 1]


PIXELS = np.arange(2 * 3 * 3).reshape(2, 3, 3) * 14


def test_textures_are_linear_and_multiplied_with_their_factors(file, tmp_path):
    colour, rough = file.texture(PIXELS), file.texture(PIXELS[::-1])
    gold = material(file, tmp_path, pbrMetallicRoughness={
        "baseColorTexture": colour, "baseColorFactor": [1, 0.5, 0.25, 1], "metallicRoughnessTexture": rough,
        "roughnessFactor": 0.5, "metallicFactor": 0.25}).get_submodule("gold")
    levels = torch.from_numpy(PIXELS / 255.0)
    expected = srgb_to_linear(levels) * torch.tensor([1, 0.5, 0.25])
    torch.testing.assert_close(gold.base_color.data.detach().double(), expected, rtol=1e-6, atol=1e-7)
    for name, channel, factor in (("roughness", 1, 0.5), ("metallic", 2, 0.25)):
        found = getattr(gold, name).data.detach().double()
        expected = levels.flip(0)[..., channel, None] * factor
        torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("kind, mode", [("JPEG", None), ("PNG", "grey"), ("PNG", "palette")])
def test_images_of_other_kinds_are_read(file, tmp_path, kind, mode):
    flat = np.full((8, 8) if mode == "grey" else (8, 8, 3), 188)
    texture = file.texture(flat, kind)
    gold = material(file, tmp_path, pbrMetallicRoughness={"baseColorTexture": texture}).get_submodule("gold")
    torch.testing.assert_close(gold.base_color.data.detach(), torch.full((8, 8, 3), 0.5029), rtol=0.02, atol=0)


def test_samplers_decide_how_a_texture_is_read(file, tmp_path):
    info = file.texture(PIXELS, wrapS=33648, wrapT=33648, magFilter=9728, minFilter=9987)
    other = file.texture(PIXELS, wrapS=33071, wrapT=33071)
    gold = material(file, tmp_path, pbrMetallicRoughness={"baseColorTexture": info, "metallicRoughnessTexture": other})
    gold = gold.get_submodule("gold")
    assert (gold.base_color.wrap_mode, gold.base_color.filter_type) == ("mirror", "nearest")
    assert (gold.roughness.wrap_mode, gold.roughness.filter_type) == ("clamp", "bilinear")


def test_two_wrap_modes_are_a_loss(file, tmp_path):
    info = file.texture(PIXELS, wrapS=33648, wrapT=33071)
    file.node(file.square(file.add("materials", pbrMetallicRoughness={"baseColorTexture": info})))
    load_with_loss(file, tmp_path, r"samplers\[0\]: wrapS 'mirror' is used for wrapT, which is 'clamp'")


def test_texture_transforms_show_what_the_extension_says(file, tmp_path):
    """Its own example: the lower left quarter of the image, turned clockwise by 90 degrees. There v = 0 is at the top."""
    info = file.texture(PIXELS) | {"extensions": {"KHR_texture_transform": {
        "offset": [0, 1], "rotation": math.pi / 2, "scale": [0.5, 0.5]}}}
    matrix = material(file, tmp_path, pbrMetallicRoughness={"baseColorTexture": info}).get_parameter("gold.base_color.to_uv")
    corners = torch.tensor([[0.0, 0, 0, 1], [1, 0, 0, 1], [0, 1, 0, 1], [1, 1, 0, 1]])
    found = (corners @ matrix.detach().T)[:, :2]
    torch.testing.assert_close(found, torch.tensor([[0, 1], [0, 0.5], [0.5, 1], [0.5, 0.5]]), rtol=0, atol=1e-6)


def test_a_second_set_of_coordinates_is_read_if_it_is_the_only_one(file, tmp_path):
    info = file.texture(PIXELS)
    gold = file.add("materials", name="gold", pbrMetallicRoughness={"baseColorTexture": info | {"texCoord": 1}})
    file.node(file.square(gold, TEXCOORD_1=file.array(np.full((4, 2), 0.25))), name="sheet")
    assert load_quietly(file, tmp_path).get_parameter("sheet.vertex_texcoords").tolist() == [[0.25, 0.25]] * 4
    file.document["materials"][gold]["emissiveTexture"] = info
    file.document["materials"][gold]["emissiveFactor"] = [1, 1, 1]
    load_with_loss(file, tmp_path, r"emissiveTexture is not read: it uses TEXCOORD_0, other textures TEXCOORD_1")


@pytest.mark.parametrize("number, lacks", [(1, "which it does not have"), (7, "of which only the first 2 are read")])
def test_a_set_of_coordinates_that_is_not_there_is_said_once(file, tmp_path, number, lacks):
    gold = file.add("materials", pbrMetallicRoughness={"baseColorTexture": file.texture(PIXELS) | {"texCoord": number}})
    file.node(file.square(gold), name="sheet")
    scene = load_with_loss(file, tmp_path, rf"meshes\[0\].primitives\[0\]: textures of its material are read at \(0, 0\) "
                                           rf"everywhere: they use TEXCOORD_{number}, {lacks}")
    assert scene.get_parameter("sheet.vertex_texcoords").tolist() == [[0.0, 0.0]] * 4
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rb.render(scene, spp=1)


@pytest.mark.parametrize("mirrored", [False, True])
def test_normal_maps_turn_normals_as_the_specification_says(file, tmp_path, mirrored):
    """Red turns them to where u grows, green to where v falls: there the light of a lamp from that side is brighter."""
    info = file.texture(np.full((1, 1, 3), (128, 230, 200))) | {"scale": 0.5}
    gold = file.add("materials", name="gold", normalTexture=info, pbrMetallicRoughness={"metallicFactor": 0})
    uv = [[0, 0], [1, 0], [1, 1], [0, 1]] if mirrored else [[0, 1], [1, 1], [1, 0], [0, 0]]
    file.node(file.square(gold, uv), name="sheet")
    lamps = {1: "above", -1: "below"}
    images = {}
    for side, name in lamps.items():
        file.document["extensions"] = {}
        sun = file.node(extensions=lamp(file, type="directional"), name="sun",
                        rotation=[-side * math.sin(0.4), 0, 0, math.cos(0.4)])
        images[name] = rb.render(load_quietly(file, tmp_path, resolution=8), spp=16, max_depth=2).mean()
        file.document["nodes"].pop(sun), file.document["scenes"][0]["nodes"].pop()
    brighter, darker = ("below", "above") if mirrored else ("above", "below")
    assert images[brighter] > 1.2 * images[darker] > 0


def test_alpha_becomes_a_mask(file, tmp_path):
    pixels = np.full((2, 2, 4), 128)
    pixels[0, :, 3] = 255
    entries = {"baseColorTexture": file.texture(pixels), "baseColorFactor": [1, 1, 1, 0.5]}
    kinds = {"OPAQUE": None, "BLEND": torch.tensor([0.5, 0.5, 128 / 510, 128 / 510]), "MASK": torch.tensor([1.0, 1, 0, 0])}
    for mode in kinds:
        number = file.add("materials", name=mode, alphaMode=mode, pbrMetallicRoughness=entries,
                          **({"alphaCutoff": 0.4} if mode == "MASK" else {}))
        file.node(file.square(number), name=f"sheet_{mode}")
    scene = load_quietly(file, tmp_path)
    for mode, opacity in kinds.items():
        bsdf = scene.get_submodule(f"sheet_{mode}").bsdf
        if opacity is None:
            assert bsdf is scene.get_submodule(mode)
        else:
            assert bsdf.nested_bsdf is scene.get_submodule(mode)
            found = scene.get_parameter(f"{mode}_mask.opacity.data").detach()[..., 0].flatten()
            torch.testing.assert_close(found, opacity, rtol=0, atol=1e-6)


def test_both_sides_are_seen_where_the_material_says_so(file, tmp_path):
    sides = {True: "twosided", False: "principled"}
    for double, kind in sides.items():
        file.node(file.square(file.add("materials", name=kind, doubleSided=double)), name=f"sheet_{kind}")
    scene = load_quietly(file, tmp_path)
    for kind in sides.values():
        assert scene.get_submodule(f"sheet_{kind}").bsdf.type == kind
    assert scene.get_submodule("sheet_twosided").bsdf.brdf[0] is scene.get_submodule("twosided")


def test_emission_becomes_an_area_light(file, tmp_path):
    info = file.texture(np.full((1, 1, 3), (255, 188, 0)))
    scene = material(file, tmp_path, {"KHR_materials_emissive_strength": {"emissiveStrength": 8}}, emissiveTexture=info,
                     emissiveFactor=[1, 0.5, 1])
    radiance = scene.get_parameter("sheet.emitter.radiance.data").detach()
    torch.testing.assert_close(radiance[0, 0], torch.tensor([8.0, 4 * 0.5029, 0]), rtol=1e-3, atol=0)
    assert [emitter.type for emitter in scene.emitters] == ["area"]  # and no light is added


def test_materials_that_transmit(file, tmp_path):
    extensions = {"KHR_materials_transmission": {"transmissionFactor": 0.75}, "KHR_materials_ior": {"ior": 1.33},
                  "KHR_materials_volume": {"thicknessFactor": 0.1}}
    gold = material(file, tmp_path, extensions, doubleSided=True).get_submodule("gold")
    assert gold.spec_trans.value == 0.75 and gold.eta == pytest.approx(1.33) and gold.specular is None


def test_layers_of_a_material(file, tmp_path):
    extensions = {"KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.2},
                  "KHR_materials_sheen": {"sheenColorFactor": [0.25, 0.5, 0.25]}, "KHR_materials_ior": {"ior": 1.4},
                  "KHR_materials_specular": {"specularFactor": 0.5}}
    file.node(file.square(file.add("materials", name="gold", extensions=extensions)))
    gold = load_with_loss(file, tmp_path, "clearcoat is that of principled.*").get_submodule("gold")
    assert gold.clearcoat.value == 0.5 and gold.clearcoat_gloss.value == pytest.approx((0.1 - 0.04) / 0.099)
    assert gold.sheen.value == 0.5 and gold.sheen_tint.value == 1
    assert gold.specular == pytest.approx(0.5 * (0.4 / 2.4) ** 2 / 0.08)
    message = load_message(file, tmp_path)
    assert "sheen is that of principled" in message and "specularFactor 0.5 weakens" in message


def load_message(file, folder):
    with pytest.raises(SceneError) as caught:
        rb.load(file.save(folder / "asset.glb"), strict=True)
    return str(caught.value)


def test_anisotropy_keeps_the_roughness_along_and_across(file, tmp_path):
    gold = material(file, tmp_path, {"KHR_materials_anisotropy": {"anisotropyStrength": 0.4}},
                    pbrMetallicRoughness={"roughnessFactor": 0.6}).get_submodule("gold")
    across = 0.36
    along = across + (1 - across) * 0.16
    roughness, aspect = float(gold.roughness.value) ** 2, math.sqrt(1 - 0.9 * float(gold.anisotropic.value))
    assert roughness / aspect == pytest.approx(along, rel=1e-5) and roughness * aspect == pytest.approx(across, rel=1e-5)


def test_a_surface_without_reflections_is_diffuse(file, tmp_path):
    gold = material(file, tmp_path, {"KHR_materials_specular": {"specularFactor": 0}},
                    pbrMetallicRoughness={"metallicFactor": 0, "baseColorFactor": [0.5, 0.25, 1, 1]}).get_submodule("gold")
    assert gold.type == "diffuse" and gold.reflectance.value.tolist() == [0.5, 0.25, 1]


def test_colours_of_vertices_are_an_attribute_and_the_base_colour(file, tmp_path):
    gold = file.add("materials", name="gold", pbrMetallicRoughness={"baseColorFactor": [1, 0.5, 1, 1], "metallicFactor": 0})
    colours = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 255]])
    file.node(file.square(gold, COLOR_0=file.array(colours, "uint8", normalized=True)), name="sheet")
    file.node(file.square(gold), name="plain", translation=[0, 0, -1])
    scene = load_quietly(file, tmp_path, resolution=8)
    values = scene.get_parameter("sheet.vertex_color")
    assert values.tolist() == [[1, 0, 0], [0, 0.5, 0], [0, 0, 1], [1, 0.5, 1]]
    assert scene.get_submodule("gold").base_color.name == "vertex_color"
    assert scene.get_submodule("plain").bsdf.base_color.value.tolist() == [1, 0.5, 1]
    values.requires_grad_()
    rb.render(scene, spp=4, max_depth=2).mean().backward()
    assert torch.isfinite(values.grad).all() and (values.grad > 0).any()


def test_lights_stand_where_their_nodes_do(file, tmp_path):
    file.node(file.square())
    file.node(name="bulb", translation=[1, 2, 3], scale=[2, 2, 2],
              extensions=lamp(file, type="point", intensity=10, color=[1, 0.5, 0]))
    half = math.sqrt(0.5)
    file.node(name="sun", rotation=[-half, 0, 0, half], extensions=lamp(file, type="directional", intensity=3))
    cone = {"innerConeAngle": 0.2, "outerConeAngle": 0.6}
    file.node(name="stage", translation=[0, 0, 4], extensions=lamp(file, type="spot", intensity=5, spot=cone))
    scene = load_quietly(file, tmp_path, lumens_per_watt=2)
    bulb, sun, stage = (scene.get_submodule(name) for name in ("bulb", "sun", "stage"))
    assert bulb.position.tolist() == [1, 2, 3] and bulb.intensity.value.tolist() == [5, 2.5, 0]
    torch.testing.assert_close(sun.towards().detach(), torch.tensor([0.0, 1, 0]), rtol=0, atol=1e-6)  # it shines down
    assert sun.irradiance.value.tolist() == [1.5] * 3
    torch.testing.assert_close(stage.to_world.detach()[:3, 2:], torch.tensor([[0.0, 0], [0, 0], [-1, 4]]))
    assert stage.cutoff_angle == pytest.approx(math.degrees(0.6)) and stage.beam_width == pytest.approx(math.degrees(0.2))


def test_cameras_look_along_minus_z_with_y_up(file, tmp_path):
    file.node(file.square())
    lens = {"yfov": 0.8, "aspectRatio": 2.0, "znear": 0.1}
    file.node(name="eye", translation=[0, 0, 5], camera=file.add("cameras", type="perspective", perspective=lens))
    flat = {"xmag": 3, "ymag": 2, "znear": 0, "zfar": 50}
    file.node(name="plan", translation=[0, 0, 5], camera=file.add("cameras", type="orthographic", orthographic=flat))
    scene = load_quietly(file, tmp_path, resolution=60)
    eye, plan = scene.sensors
    assert (eye.film.width, eye.film.height) == (60, 30) and (plan.film.width, plan.film.height) == (60, 40)
    assert eye.x_fov == pytest.approx(math.degrees(2 * math.atan(2 * math.tan(0.4))), rel=1e-6)
    torch.testing.assert_close(eye.to_world.detach()[:3], torch.tensor([[-1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 5]]))
    assert plan.to_world.detach().diagonal().tolist() == [-3, 3, -1, 1] and plan.far_clip == 50
    only = load_quietly(file, tmp_path, camera=False)
    assert [only.name_of(sensor) for sensor in only.sensors] == ["camera"]


def test_a_file_without_light_and_camera_gets_both_and_says_so_once(file, tmp_path):
    file.node(file.square(), translation=[100, 0, 0], scale=[7, 7, 7])
    path = file.save(tmp_path / "asset.glb")
    with pytest.warns(GltfWarning, match="a constant light of radiance 1 .*no camera: 'camera' is added") as caught:
        scene = rb.load(path, resolution=16)
    assert len(caught) == 1 and caught[0].filename == __file__
    image = rb.render(scene, spp=16)[0]
    assert image.min() > 0.1
    corner, middle = image[:, 0, 0], image[:, 8, 8]
    assert corner.mean() == pytest.approx(1, abs=1e-4) and middle.mean() < 0.99  # the square is in the middle, and all of it
    assert [e.type for e in rb.load(path, light=0.5, camera=False).emitters] == ["constant"]


def test_options_may_be_text_and_are_checked(file, tmp_path):
    file.node(file.square())
    path = file.save(tmp_path / "asset.glb")
    scene = load_quietly(file, tmp_path, resolution="32", spp="4", max_depth="3", light="0.25")
    camera = scene.sensors[0]
    assert camera.film.width == 32 and camera.sampler.sample_count == 4 and scene.integrator.max_depth == 3
    for given, message in [
            ({"size": 3}, "no option 'size'; .*known: camera, light"),
            ({"spp": "x"}, "spp must be an integer"), ({"resolution": 0}, "at least 1"),
            ({"camera": 1}, "must be true or false"),
            ({"scene": 4}, r"scene 4 does not exist; the document has scenes 0 to 0")]:
        with pytest.raises(SceneError, match=f"asset.glb: .*{message}"):
            rb.load(path, **given)


PANE = {"KHR_materials_transmission": {"transmissionFactor": 1}}
LOSSES = {
    "occlusion": (lambda f, m: m.update(occlusionTexture=f.texture(PIXELS)), "occlusionTexture is not read"),
    "unlit": (lambda f, m: m.update(extensions={"KHR_materials_unlit": {}}), "unlit"),
    "sheet": (lambda f, m: m.update(extensions=PANE), "solid body"),
    "unknown extension": (lambda f, m: f.document.update(extensionsUsed=["EXT_x"]), "'EXT_x' is not read"),
    "animation": (lambda f, m: f.add("animations", channels=[], samplers=[]), "animations: are not read"),
    "hidden node": (lambda f, m: f.node(name="gone", scale=[0, 0, 0]), "'gone': is left out"),
    "tint": (lambda f, m: m.update(extensions={"KHR_materials_specular": {"specularColorFactor": [1, 0, 0]}}), "stay white"),
    "range": (lambda f, m: f.node(extensions=lamp(f, type="point", range=3)), "range is not read"),
}


@pytest.mark.parametrize("case", LOSSES)
def test_what_is_not_read_is_said_by_name(file, tmp_path, case):
    number = file.add("materials", name="gold")
    file.node(file.square(number), name="sheet")
    spoil, message = LOSSES[case]
    spoil(file, file.document["materials"][number])
    load_with_loss(file, tmp_path, f".*{re.escape(message)}")


def test_what_a_file_requires_and_is_not_known_is_an_error(file, tmp_path):
    file.node(file.square())
    file.document["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    with pytest.raises(SceneError, match="requires the extension 'KHR_draco_mesh_compression', which is not .*Blender"):
        rb.load(file.save(tmp_path / "asset.glb"))


def test_attributes_of_applications_are_attributes_of_the_mesh(file, tmp_path):
    file.node(file.square(_HEAT=file.array([0.1, 0.2, 0.3, 0.4])), name="sheet")
    assert load_quietly(file, tmp_path).get_parameter("sheet.vertex_heat").shape == (4, 1)


def test_what_trimesh_writes_is_read(tmp_path):
    """Another program's file: the same triangles, and the same metal."""
    box = trimesh.creation.box((1, 2, 3))
    metal = trimesh.visual.material.PBRMaterial(name="gold", metallicFactor=0.25, roughnessFactor=0.5, doubleSided=True,
                                                baseColorFactor=[255, 0, 0, 255])
    box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], material=metal)
    placed = trimesh.transformations.translation_matrix([1, 2, 3])
    theirs = trimesh.Scene()
    theirs.add_geometry(box, node_name="crate", transform=placed)
    theirs.export(tmp_path / "asset.glb")
    with pytest.warns(GltfWarning, match="no light"):
        scene = rb.load(tmp_path / "asset.glb")
    ours, gold = scene.shapes[0], scene.get_submodule("gold")
    found = ours.vertex_positions[ours.faces].detach().numpy()
    np.testing.assert_allclose(found, box.triangles + [1, 2, 3], atol=1e-6)
    assert gold.metallic.value == 0.25 and gold.roughness.value == 0.5 and gold.base_color.value.tolist() == [1, 0, 0]
    assert ours.bsdf.type == "twosided"
