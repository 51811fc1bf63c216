"""Networks become bitmaps that look the same."""

import pytest
import torch

import torch_radbp as rb
from torch_radbp.formats.image import read_image

LOOK = {"type": "perspective", "fov": 40, "to_world": rb.look_at([1.5, 1.2, 3], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 32, "height": 32}}


class Linear(torch.nn.Module):
    """0.4 plus a linear function of the place."""

    def __init__(self, inputs, outputs=3):
        super().__init__()
        generator = torch.Generator().manual_seed(inputs + outputs)
        self.slope = torch.nn.Parameter(0.1 * torch.randn(inputs, outputs, generator=generator))

    def forward(self, place):
        return 0.4 + place @ self.slope


def scene_of(shape, **more):
    return rb.load_dict({"type": "scene", "camera": LOOK, "sky": {"type": "constant"}, "body": shape, **more})


def albedo(scene):
    return rb.render(scene, spp=64, seed=1, max_depth=2, aovs=["albedo"])[1]["albedo"]


@pytest.mark.parametrize("channels", [1, 3])
def test_a_network_of_coordinates_is_read_at_the_centres_of_texels(channels):
    """Of a linear function bilinear interpolation between them is exact."""
    texture = rb.NeuralTexture(Linear(2, channels))
    found = rb.bake.bitmap(texture, (4, 8))
    assert found.data.shape == (4, 8, channels) and found.wrap_mode == "clamp" and not found.data.requires_grad
    place = torch.tensor([(5 + 0.5) / 8, (1 + 0.5) / 4])
    torch.testing.assert_close(found.data[1, 5], texture.module(place[None])[0])


def test_the_image_of_a_bitmap_is_that_of_the_network():
    scene = scene_of({"type": "rectangle"})
    scene.body.bsdf.reflectance = rb.NeuralTexture(Linear(2))
    before = albedo(scene)
    scene.body.bsdf.reflectance = rb.bake.bitmap(scene.body.bsdf.reflectance, 64)
    assert before.std() > 0.01
    # But for half a texel at the borders, beyond the outermost centres.
    torch.testing.assert_close(albedo(scene), before, rtol=0, atol=3e-3)


def test_a_network_of_positions_follows_the_surface_across_all_seams():
    """On charts of a bent sheet that closes, 128 x 128 texels: a linear function of space, no seam visible."""
    pytest.importorskip("xatlas")
    scene = scene_of({"type": "cylinder", "to_world": torch.diag(torch.tensor([1.0, 0.8, 0.6, 1.0]))})
    scene.body = rb.bake.mesh(scene.body, unwrap=True, resolution=128)
    scene.body.bsdf.reflectance = rb.NeuralTexture(Linear(3), of="position")
    before = albedo(scene)
    scene.body.bsdf.reflectance = rb.bake.bitmap(scene.body.bsdf.reflectance, 128, scene.body)
    assert before.std() > 0.02
    torch.testing.assert_close(albedo(scene), before, rtol=0, atol=1e-3)


def test_a_bitmap_has_the_precision_of_the_network():
    assert rb.bake.bitmap(rb.NeuralTexture(Linear(2).double()), 4).data.dtype == torch.float64


def test_what_is_baked_is_written_and_read_back(tmp_path):
    scene = scene_of({"type": "rectangle"})
    scene.body.bsdf.reflectance = rb.bake.bitmap(rb.NeuralTexture(Linear(2)), 16)
    rb.save(scene, tmp_path / "scene.xml")
    exr, = tmp_path.glob("*.exr")
    torch.testing.assert_close(read_image(exr), scene.body.bsdf.reflectance.data.detach())


def test_triangles_that_share_texels_are_warned_of():
    """The six faces of a cube have one square."""
    scene = scene_of({"type": "cube"})
    network = rb.NeuralTexture(Linear(3), of="position")
    with pytest.warns(rb.SceneWarning, match=r"triangles overlap in surface coordinates, so that \d+ of 256 texels"):
        rb.bake.bitmap(network, 16, scene.body)


@pytest.mark.hostile
@pytest.mark.parametrize("of, resolution, shape, error, message", [
    ("position", 8, None, ValueError, "is baked over the surface coordinates of a shape: give the shape"),
    ("position", 8, {"type": "mesh", "vertex_positions": torch.eye(3), "faces": [[0, 1, 2]]}, ValueError,
     "the mesh has no surface coordinates; rb.bake.mesh makes a mesh"),
    ("position", 8, {"type": "mesh", "vertex_positions": torch.eye(3), "faces": [[0, 1, 2]],
                     "vertex_texcoords": torch.eye(3)[:, :2] * 2}, ValueError, r"must be within \[0, 1\].*got 0 to 2"),
    ("uv", 0, None, ValueError, "resolution must be"), ("uv", (8, 8, 8), None, ValueError, "height and width, got"),
    ("position", 8, "body", TypeError, "the shape must be a surface, such as a mesh, got str"),
])
def test_what_cannot_be_baked_is_said(of, resolution, shape, error, message):
    shape = scene_of(shape).body if isinstance(shape, dict) else shape
    with pytest.raises(error, match=message):
        rb.bake.bitmap(rb.NeuralTexture(Linear(2 if of == "uv" else 3), of=of), resolution, shape)


@pytest.mark.hostile
def test_only_networks_are_baked():
    with pytest.raises(TypeError, match="a network in the place of a texture is baked, rb.NeuralTexture, got RGB"):
        rb.bake.bitmap(scene_of({"type": "sphere"}).body.bsdf.reflectance, 8)
