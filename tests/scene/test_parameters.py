"""Current parameters are checked at every rendering, by name, however they came to be what they are."""

import re

import pytest
import torch
from torch import nn
from torch.func import functional_call
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.scenes import diffuse, rectangle, rgb, sensor, texels
from torch_radbp.plugin import Texture
from torch_radbp.scene.modules.parameters import held_values

pytestmark = pytest.mark.hostile


def gallery() -> rb.Scene:
    """A scene with a parameter of every kind, float32."""
    bitmap = {"type": "bitmap", "data": texels(3, 2)}
    mesh = {"type": "mesh", "vertex_positions": torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.2]]),
            "faces": torch.tensor([[0, 1, 2], [2, 1, 3]]), "vertex_normals": torch.tensor([[0.0, 0, 1]] * 4),
            "vertex_texcoords": torch.rand(4, 2)}
    return rb.load_dict({
        "type": "scene", "camera": sensor(2),
        "wall": rectangle((0, 0, -1), bsdf={"type": "diffuse", "reflectance": bitmap}),
        "mesh": mesh | {"bsdf": {"type": "roughdielectric", "alpha": 0.2}},
        "ball": {"type": "sphere", "radius": 0.2, "bsdf": {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.2}},
        "pane": rectangle((0, 0, -2), bsdf={"type": "dielectric"}),
        "box": {"type": "cube", "to_world": torch.diag(torch.tensor([0.1, 0.1, 0.1, 1.0])), "bsdf": diffuse(0.2, 0.3, 0.4)},
        "lamp": rectangle((0, 0, 4), angle=180, emitter={"type": "area", "radiance": rgb(3, 2, 1)}),
        "sky": {"type": "envmap", "bitmap": texels(3, 4)}, "point": {"type": "point", "position": [0.0, 3, 0]},
        "spot": {"type": "spot", "texture": {"type": "bitmap", "data": texels(2, 2)}}, "beamer": {"type": "projector"},
        "sun": {"type": "directional", "direction": [0.0, -1, 0.1]}})


def matrix(**entries: float) -> torch.Tensor:
    """The identity with some entries changed, "r3c0" for row 3 and column 0."""
    result = torch.eye(4)
    for place, value in entries.items():
        result[int(place[1]), int(place[3])] = value
    return result


def flat(axis: int, length: float = 0.0) -> torch.Tensor:
    """The identity with an axis of another length."""
    result = torch.eye(4)
    result[axis, axis] = length
    return result


OBLIQUE = torch.eye(4)
OBLIQUE[:3, :3] = torch.tensor([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]])  # of rank 2, but for rounding

WRONG = {
    # Shapes.
    "channels first": ("wall.bsdf.reflectance.data", torch.rand(3, 16, 16), "must have shape (H, W, 3), got (3, 16, 16)"),
    "two channels": ("wall.bsdf.reflectance.data", torch.rand(16, 16, 2), "must have shape (H, W, 3), got (16, 16, 2)"),
    "one channel": ("wall.bsdf.reflectance.data", torch.rand(16, 16, 1), "must have shape (H, W, 3), got (16, 16, 1)"),
    "grey": ("wall.bsdf.reflectance.data", torch.rand(16, 16), "must have shape (H, W, 3), got (16, 16)"),
    "batch of bitmaps": ("wall.bsdf.reflectance.data", torch.rand(1, 4, 4, 3), "must have shape (H, W, 3), got (1, 4, "),
    "no texels": ("wall.bsdf.reflectance.data", torch.rand(0, 4, 3), "must have shape (H, W, 3), got (0, 4, 3)"),
    "envmap channels first": ("sky.data", torch.rand(3, 8, 4), "must have shape (H, W, 3), got (3, 8, 4)"),
    "colour of four": ("box.bsdf.reflectance.value", torch.rand(4), "must have shape () or (3,), got (4,)"),
    "colour of one": ("box.bsdf.reflectance.value", torch.rand(1), "must have shape () or (3,), got (1,)"),
    "colour as image": ("box.bsdf.reflectance.value", torch.rand(1, 1, 3), "must have shape () or (3,), got (1, 1, 3)"),
    "too many vertices": ("mesh.vertex_positions", torch.rand(5, 3), "must have shape (4, 3), got (5, 3)"),
    "too few vertices": ("mesh.vertex_positions", torch.rand(3, 3), "must have shape (4, 3), got (3, 3)"),
    "vertices across": ("mesh.vertex_positions", torch.rand(3, 4), "must have shape (4, 3), got (3, 4)"),
    "flat vertices": ("mesh.vertex_positions", torch.rand(12), "must have shape (4, 3), got (12,)"),
    "too few normals": ("mesh.vertex_normals", torch.rand(3, 3), "must have shape (4, 3), got (3, 3)"),
    "normals of two": ("mesh.vertex_normals", torch.rand(4, 2), "must have shape (4, 3), got (4, 2)"),
    "coordinates of three": ("mesh.vertex_texcoords", torch.rand(4, 3), "must have shape (4, 2), got (4, 3)"),
    "too many coordinates": ("mesh.vertex_texcoords", torch.rand(6, 2), "must have shape (4, 2), got (6, 2)"),
    "cube cut short": ("box.vertex_positions", torch.rand(8, 3), "must have shape (24, 3), got (8, 3)"),
    "pose of three rows": ("wall.to_world", torch.eye(4)[:3], "must have shape (4, 4), got (3, 4)"),
    "pose of a plane": ("ball.to_world", torch.eye(3), "must have shape (4, 4), got (3, 3)"),
    "pose as list": ("mesh.to_world", torch.rand(16), "must have shape (4, 4), got (16,)"),
    "batch of poses": ("camera.to_world", torch.eye(4)[None], "must have shape (4, 4), got (1, 4, 4)"),
    "pose of a lamp": ("lamp.to_world", torch.eye(4)[:3], "must have shape (4, 4), got (3, 4)"),
    "field of view of two": ("camera.x_fov", torch.tensor([40.0, 30.0]), "must have shape (), got (2,)"),
    "field of view in a list": ("camera.x_fov", torch.tensor([40.0]), "must have shape (), got (1,)"),
    "index in colour": ("pane.bsdf.eta", torch.tensor([1.5, 1.5, 1.5]), "must have shape (), got (3,)"),
    "plane position": ("point.position", torch.rand(2), "must have shape (3,), got (2,)"),
    "homogeneous position": ("point.position", torch.rand(4), "must have shape (3,), got (4,)"),
    "scale in colour": ("sky.scale", torch.rand(3), "must have shape (), got (3,)"),
    "angles": ("spot.cutoff_angle", torch.tensor([20.0]), "must have shape (), got (1,)"),
    # Ranges.
    "field of view of 0": ("camera.x_fov", torch.tensor(0.0), "must be between 0 and 180 degrees, got 0"),
    "field of view of 180": ("camera.x_fov", torch.tensor(180.0), "must be between 0 and 180 degrees, got 180"),
    "negative field of view": ("camera.x_fov", torch.tensor(-40.0), "must be between 0 and 180 degrees, got -40"),
    "field of view in tenths": ("camera.x_fov", torch.tensor(450.0), "must be between 0 and 180 degrees, got 450"),
    "negative texels": ("wall.bsdf.reflectance.data", torch.full((3, 2, 3), -0.5), "must be at least 0, got -0.5"),
    "one negative texel": ("wall.bsdf.reflectance.data", torch.linspace(-0.1, 0.9, 18).reshape(3, 2, 3),
                           "must be at least 0, got -0.1; keep it inside, with scene.clamp_() after each step, rb.optim"),
    "overflowing texels": ("wall.bsdf.reflectance.data", torch.full((3, 2, 3), 1e9),
                           "must be at most 1e+06 in magnitude, got 1e+09: float32 overflows beyond that"),
    "negative reflectance": ("box.bsdf.reflectance.value", torch.tensor([0.5, -0.3, 0.5]), "must be at least 0, got -0.3"),
    "radiance whose square overflows": ("lamp.emitter.radiance.value", torch.tensor([1.0, 1.0, 1e19]),
                                        "must be at most 1e+18 in magnitude, got 1e+19: float32 overflows beyond that"),
    "negative radiance": ("lamp.emitter.radiance.value", torch.tensor([1.0, 1.0, -1.0]), "must be at least 0, got -1"),
    "negative sky": ("sky.data", -torch.ones(3, 4, 3), "must be at least 0, got -1"),
    "negative factor": ("sky.scale", torch.tensor(-2.0), "must be at least 0, got -2"),
    "negative intensity": ("point.intensity.value", torch.tensor(-1.0), "must be at least 0, got -1"),
    "negative slide": ("spot.texture.data", -torch.ones(2, 2, 3), "must be at least 0, got -1"),
    "negative film": ("beamer.irradiance.value", torch.tensor(-0.1), "must be at least 0, got -0.1"),
    "negative beamer": ("beamer.scale", torch.tensor(-0.1), "must be at least 0, got -0.1"),
    "negative sun": ("sun.irradiance.value", torch.tensor([-1.0, 1, 1]), "must be at least 0, got -1"),
    "negative index": ("pane.bsdf.eta", torch.tensor(-1.5), "must be greater than 0, got -1.5"),
    "no index": ("pane.bsdf.eta", torch.tensor(0.0), "must be greater than 0, got 0"),
    "negative index of rough glass": ("mesh.bsdf.eta", torch.tensor(-1.5), "must be greater than 0, got -1.5"),
    "negative index of metal": ("ball.bsdf.eta.value", torch.tensor(-0.5), "must be at least 0, got -0.5"),
    "negative extinction": ("ball.bsdf.k.value", torch.tensor([1.0, 2.0, -3.0]), "must be at least 0, got -3"),
    "negative roughness": ("mesh.bsdf.alpha.value", torch.tensor(-0.2), "must be at least 0, got -0.2"),
    "negative brushed roughness": ("ball.bsdf.alpha_v.value", torch.tensor(-0.2), "must be at least 0, got -0.2"),
    "negative mirror": ("pane.bsdf.specular_reflectance.value", torch.tensor(-2.0), "must be at least 0, got -2"),
    "negative pane": ("pane.bsdf.specular_transmittance.value", torch.tensor(-1.0), "must be at least 0, got -1"),
    "wide spot": ("spot.cutoff_angle", torch.tensor(91.0), "must be between 0 and 90 degrees, got 91"),
    "closed spot": ("spot.cutoff_angle", torch.tensor(0.0), "must be between 0 and 90 degrees, got 0"),
    "negative beam": ("spot.beam_width", torch.tensor(-5.0), "must be at least 0 degrees, got -5"),
    # Poses.
    "projective pose": ("wall.to_world", matrix(r3c0=0.5), "must be affine: its last row must be 0 0 0 1, got [0.5, 0.0, "),
    "pose of weight 2": ("mesh.to_world", matrix(r3c3=2.0), "must be affine: its last row must be 0 0 0 1, got [0.0, 0.0, "),
    "transposed pose": ("camera.to_world", matrix(r3c0=1.0, r3c1=2.0), "must be affine: its last row must be 0 0 0 1"),
    "pose of zeros": ("ball.to_world", torch.zeros(4, 4), "must be affine"),
    "pose of halves": ("mesh.to_world", torch.full((4, 4), 0.5), "must be affine"),
    "pose of zeros but the last row": ("ball.to_world", flat(0) @ flat(1) @ flat(2), "must be invertible, got a matrix"),
    "flat wall": ("wall.to_world", flat(0), "must be invertible, got a matrix with determinant 0"),
    "flat mesh": ("mesh.to_world", flat(2), "must be invertible, got a matrix with determinant 0"),
    "flat camera": ("camera.to_world", flat(2), "must be invertible, got a matrix with determinant 0"),
    "flat sky": ("sky.to_world", flat(1), "must be invertible, got a matrix with determinant 0"),
    "flat beamer": ("beamer.to_world", flat(1), "must be invertible, got a matrix with determinant 0"),
    "flat sun": ("sun.to_world", flat(2), "must be invertible, got a matrix with determinant 0"),
    "thin camera": ("camera.to_world", flat(2, 1e-13), "must have axes of length at least 1e-11, got one of 1e-13"),
    "thin sun": ("sun.to_world", flat(2, 1e-28), "must have axes of length at least 1e-11, got one of 1e-28"),
    "obliquely flat box": ("box.to_world", OBLIQUE, "must be invertible, got a matrix with determinant"),
    # Not numbers.
    "NaN in a pose": ("box.to_world", matrix(r0c0=torch.nan), "has 1 of 16 values that are NaN or infinite; a smaller"),
    "NaN in vertices": ("mesh.vertex_positions", torch.full((4, 3), torch.nan), "has 12 of 12 values that are NaN or"),
    "infinite light": ("lamp.emitter.radiance.value", torch.tensor([1.0, torch.inf, 1]), "has 1 of 3 values that are"),
    "infinitely dark": ("sky.data", torch.full((3, 4, 3), -torch.inf), "has 36 of 36 values that are NaN or infinite"),
    "NaN in roughness": ("mesh.bsdf.alpha.value", torch.tensor(torch.nan), "has 1 of 1 values that are NaN or infinite"),
}
MIXED = {
    "double in single": ("box.bsdf.reflectance.value", torch.rand(3).double(), "is torch.float64 on cpu, but "
                         "'camera.to_world' is torch.float32 on cpu; a scene has one dtype and one device"),
    "double vertices": ("mesh.vertex_positions", torch.rand(4, 3).double(), "is torch.float64 on cpu, but"),
    "half": ("box.bsdf.reflectance.value", torch.rand(3).half(), "is torch.float16; a scene is rendered in torch.float32"),
    "bfloat16": ("camera.x_fov", torch.tensor(40.0).bfloat16(), "is torch.bfloat16; a scene is rendered in"),
    "integers": ("pane.bsdf.eta", torch.tensor(2), "is torch.int64; a scene is rendered in torch.float32 or torch.float64"),
    "complex": ("pane.bsdf.eta", torch.tensor(1.5 + 2j), "is torch.complex64; a scene is rendered in"),
    "truth": ("sky.scale", torch.tensor(True), "is torch.bool; a scene is rendered in"),
    "another device": ("sky.scale", torch.ones((), device="meta"), "is torch.float32 on meta, but 'camera.to_world' is"),
}


def render(scene: rb.Scene) -> torch.Tensor:
    return rb.render(scene, spp=1, max_depth=2)


def test_the_gallery_renders():
    assert render(gallery()).isfinite().all()


@pytest.fixture(scope="module")
def renderer() -> rb.Renderer:
    return rb.Renderer(gallery(), spp=1, max_depth=2)


@pytest.mark.parametrize("name, value, message", WRONG.values(), ids=WRONG)
def test_a_wrong_value_of_functional_call_is_named(name, value, message, renderer):
    with pytest.raises(ValueError, match=re.escape(f"parameter {name!r}") + ".*" + re.escape(message)):
        functional_call(renderer, {f"scene.{name}": value}, kwargs={"seed": 0})
    assert renderer().isfinite().all()


@pytest.mark.parametrize("name, value, message", WRONG.values(), ids=WRONG)
def test_a_wrong_value_of_data_is_named_also_after_a_rendering(name, value, message, renderer):
    renderer()
    parameter = renderer.scene.get_parameter(name)
    before, parameter.data = parameter.data, value
    with pytest.raises(ValueError, match=re.escape(f"parameter {name!r}") + ".*" + re.escape(message)):
        renderer()
    parameter.data = before


@pytest.mark.parametrize("name, value, message", MIXED.values(), ids=MIXED)
def test_a_wrong_type_is_named(name, value, message):
    renderer = rb.Renderer(gallery(), spp=1, max_depth=2)
    with pytest.raises(TypeError, match=re.escape(f"parameter {name!r}") + ".*" + re.escape(message)):
        functional_call(renderer, {f"scene.{name}": value}, kwargs={"seed": 0})


class Gives(nn.Module):
    """A parametrisation whose result does not depend on what it is given."""

    def __init__(self, value: torch.Tensor):
        super().__init__()
        self.value = value

    def forward(self, _: torch.Tensor) -> torch.Tensor:
        return self.value


@pytest.mark.parametrize("case", ["channels first", "too many vertices", "field of view of 180", "one negative texel",
                                  "negative index", "pose of three rows", "flat beamer", "NaN in roughness"])
def test_a_wrong_value_of_a_parametrisation_is_named(case):
    name, value, message = WRONG[case]
    scene = gallery()
    place, _, attribute = name.rpartition(".")
    parametrize.register_parametrization(scene.get_submodule(place), attribute, Gives(value), unsafe=True)
    with pytest.raises(ValueError, match=re.escape(f"parameter {name!r}") + ".*" + re.escape(message)):
        render(scene)


@pytest.mark.parametrize("name", ["camera", "sun", "spot", "beamer"])
def test_the_length_of_the_axis_along_which_one_looks_does_not_matter(name):
    """Of axes that are any shorter it did: directions along them were not of unit length."""
    images = []
    for length in (1.0, 1e-6, 1.1e-11):
        scene = gallery()
        pose = scene.get_parameter(f"{name}.to_world")
        pose.copy_(pose @ flat(2, length))
        images.append(render(scene))
    assert images[0].std() > 0.01
    for image in images[1:]:
        torch.testing.assert_close(image, images[0], rtol=1e-3, atol=1e-6)


def test_a_parametrisation_may_start_from_anything_finite():
    scene = gallery()
    parametrize.register_parametrization(scene.box.bsdf.reflectance, "value", nn.Sigmoid())
    scene.box.bsdf.reflectance.parametrizations.value.original.data.fill_(-7.0)
    assert render(scene).isfinite().all()
    scene.box.bsdf.reflectance.parametrizations.value.original.data.fill_(-torch.inf)
    with pytest.raises(ValueError, match="'box.bsdf.reflectance.parametrizations.value.original' has 3 of 3 values"):
        render(scene)


def test_what_is_written_in_place_through_data_after_a_rendering_is_seen():
    scene = gallery()
    renderer = rb.Renderer(scene, spp=1, max_depth=2)
    renderer()
    scene.get_parameter("wall.bsdf.reflectance.data").data[1, 1] = -1.0
    with pytest.raises(ValueError, match=re.escape("'wall.bsdf.reflectance.data' must be at least 0, got -1")):
        renderer()


def test_a_texture_used_twice_has_to_serve_both():
    sheet = {"type": "bitmap", "id": "sheet", "data": texels(2, 2)}
    ref = {"type": "ref", "id": "sheet"}
    scene = rb.load_dict({"type": "scene", "camera": sensor(2), "sheet": sheet, "sky": {"type": "constant"},
                          "lamp": rectangle((0, 0, 0), emitter={"type": "area", "radiance": ref}),
                          "wall": rectangle((0, 0, -1), bsdf={"type": "diffuse", "reflectance": ref})})
    assert len(held_values(scene)["sheet.data"].domains) == 3
    scene.get_parameter("sheet.data").data.fill_(-3.0)
    with pytest.raises(ValueError, match=re.escape("parameter 'sheet.data' must be at least 0, got -3")):
        render(scene)


class Checkers(Texture):
    """A texture that names no parameters."""

    wrap_mode, filter_type = "repeat", "nearest"

    def __init__(self, light: float):
        super().__init__()
        self.freeze("light", torch.tensor(light))

    def texels(self) -> torch.Tensor:
        return torch.tensor([[0.0, 1.0], [1.0, 0.0]])[..., None].expand(2, 2, 3) * self.light


def test_what_a_texture_of_ones_own_gives_is_checked():
    scene = rb.load_dict({"type": "scene", "camera": sensor(2), "sky": {"type": "constant"},
                          "wall": rectangle((0, 0, -1), bsdf={"type": "diffuse", "reflectance": Checkers(0.5)})})
    assert render(scene).isfinite().all()
    scene.wall.bsdf.reflectance.light.data.fill_(-2.0)
    with pytest.raises(ValueError, match=re.escape("parameter 'wall.bsdf.reflectance' must be at least 0, got -2")):
        render(scene)


def test_faces_are_checked():
    scene = gallery()
    scene.mesh.faces[0, 0] = 9
    with pytest.raises(ValueError, match=re.escape("parameter 'mesh.faces' must be in [0, 3], got 9")):
        render(scene)


FACES = {"halves": torch.tensor([[0, 1, 2.5]]), "NaN": torch.tensor([[0, 1, torch.nan]]), "truth": torch.ones(1, 3).bool(),
         "complex": torch.tensor([[0, 1, 2 + 1j]])}


@pytest.mark.parametrize("faces", FACES.values(), ids=FACES)
def test_faces_that_are_no_whole_numbers_are_refused(faces):
    mesh = {"type": "mesh", "vertex_positions": torch.eye(3), "faces": faces}
    with pytest.raises(rb.SceneError, match="faces must be"):
        rb.load_dict({"type": "scene", "camera": sensor(2), "sky": {"type": "constant"}, "mesh": mesh})


@pytest.mark.parametrize("shape", [{"type": "sphere"}, {"type": "rectangle"}, {"type": "cube"}, {"type": "disk"}],
                         ids=lambda shape: shape["type"])
@pytest.mark.parametrize("size", [1e25, 1e15])
def test_a_shape_too_large_for_float32_is_named(shape, size):
    pose = torch.diag(torch.tensor([size, size, size, 1]))
    message = (r"the shape 'giant' has vertices up to 1e.* would vanish: areas overflow|"
               r"giant \(type 'cube'\): vertex_positions must be in \[-1e\+12, 1e\+12\], got -1e")
    with pytest.raises(ValueError, match=message):
        render(rb.load_dict({"type": "scene", "camera": sensor(2), "sky": {"type": "constant"},
                             "giant": shape | {"to_world": pose}}))


@pytest.mark.parametrize("size", [1e-4, 1e5, 1e10])
def test_shapes_that_float32_can_carry_are_seen(size):
    view = torch.diag(torch.tensor([-1.0, 1, -1, 1]))
    view[2, 3] = 3 * size
    camera = {"type": "perspective", "fov": 20, "near_clip": size / 100, "far_clip": size * 100, "to_world": view,
              "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}}
    giant = {"type": "sphere", "radius": size, "emitter": {"type": "area", "radiance": 3.0}}
    image = rb.render(rb.load_dict({"type": "scene", "camera": camera, "giant": giant}), spp=4, max_depth=1)
    torch.testing.assert_close(image, torch.full((1, 3, 1, 1), 3.0))


def test_a_mesh_that_its_pose_makes_too_large_is_named():
    scene = gallery()
    scene.mesh.vertex_positions.data.mul_(1e9)
    scene.mesh.to_world.data[:3, :3] *= 1e9
    with pytest.raises(ValueError, match="the shape 'mesh' has vertices up to 1e.18 from the origin"):
        render(scene)


CONVERSIONS = {"half": lambda scene: scene.half(), "bfloat16": lambda scene: scene.bfloat16()}


@pytest.mark.parametrize("name", CONVERSIONS)
def test_a_scene_is_not_converted_to_half_precision(name):
    scene = gallery()
    with pytest.raises(TypeError, match="a scene is rendered in torch.float32 or torch.float64, not in torch"):
        CONVERSIONS[name](scene)
    assert scene.dtype == torch.float32


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("convert", [lambda scene, dtype: scene.to(dtype),
                                     lambda scene, dtype: rb.Renderer(scene).to(dtype)], ids=["scene", "renderer"])
def test_a_scene_in_half_precision_is_not_rendered(convert, dtype):
    scene = gallery()
    convert(scene, dtype)
    with pytest.raises(TypeError, match=f"parameter 'camera.to_world' is {dtype}; a scene is rendered in torch.float32 or"):
        render(scene)
