"""What users call: names, shapes, the image beside, chunks, compiled code, and what is refused."""

import warnings

import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, sensor, texels
from tests.scenes.aovs import NETWORK_FREE, landscape, two_walls
from torch_radbp.aov import QUANTITIES, channel_names
from torch_radbp.integrator.aov import QUANTITIES as LISTED

pytestmark = pytest.mark.filterwarnings("error:.*runs eagerly:RuntimeWarning")


def test_quantities_stand_beside_the_image_of_the_same_samples():
    scene = two_walls()
    image, found = rb.render(scene, spp=4, seed=5, max_depth=2, aovs=["xyz", "depth", "depth"])
    assert torch.equal(image, rb.render(scene, spp=4, seed=5, max_depth=2))
    assert list(found) == ["xyz", "depth"] and found["depth"].shape == (1, 1, 6, 6)
    luminance = 0.212671 * image[:, 0] + 0.715160 * image[:, 1] + 0.072169 * image[:, 2]
    torch.testing.assert_close(found["xyz"][:, 1], luminance, rtol=1e-12, atol=1e-14)
    assert image.max() > 0


@pytest.mark.parametrize("differentiated", [False, True])
@pytest.mark.parametrize("compiled", [False, True])
def test_quantities_beside_an_image_cast_no_ray_of_their_own(differentiated, compiled):
    """Image and quantities have the bits that each has alone; what has a derivative has that by rays of its own."""
    scene = two_walls().float()
    scene.get_parameter("lamp.emitter.radiance.value").requires_grad_(differentiated)
    renderer = rb.Renderer(scene, spp=4, max_depth=3, compile=compiled)
    alone = renderer(seed=5)
    names = ["xyz", "prim_index"] if differentiated else ["xyz", "depth", "hit", "alpha", "sh_normal", "m2_depth"]
    before = renderer.last_caster.rays_cast
    image, found = renderer(seed=5, aovs=names)
    assert renderer.last_caster.rays_cast - before == before > 0
    assert torch.equal(image, alone) and image.requires_grad == differentiated
    for name, expected in renderer.aovs(names, seed=5).items():
        assert torch.equal(found[name], expected) and expected.abs().max() > 0 and not expected.requires_grad
    if differentiated:
        image.sum().backward()
        assert float(scene.get_parameter("lamp.emitter.radiance.value").grad.abs().sum()) > 0


def test_every_quantity_of_the_integrator_is_one_of_the_renderer():
    assert set(LISTED) < set(QUANTITIES)
    assert channel_names("nn", "m2_sh_normal") == ["nn.X", "nn.Y", "nn.Z"] and channel_names("d", "depth") == ["d.T"]


def test_every_quantity_has_its_channels_and_a_mean_square_that_is_no_less_than_its_square():
    scene = two_walls()
    names = [*QUANTITIES, *(f"m2_{name}" for name in QUANTITIES)]
    found = rb.Renderer(scene, spp=16, max_depth=3, hide_emitters=True).aovs(names)
    for name, letters in QUANTITIES.items():
        mean, square = found[name], found[f"m2_{name}"]
        assert mean.shape == square.shape == (1, len(letters), 6, 6) and torch.isfinite(square).all()
        assert mean.abs().max() > 0, name
        assert (square >= mean.square() - 1e-12).all() and (square > mean.square() + 1e-9).any(), name


def test_a_sphere_of_sky_has_no_quantities():
    found = rb.Renderer(two_walls(), spp=4).aovs([*NETWORK_FREE, "hit", "alpha"])
    for name in (*NETWORK_FREE, "hit"):
        assert (found[name][..., 0, 0] == 0).all()
    assert (found["alpha"] == 1).all()


def test_emitters_that_the_image_hides_are_seen_by_quantities():
    scene = two_walls()
    shown, hidden = (rb.Renderer(scene, spp=4, hide_emitters=hide).aovs(["depth", "hit"]) for hide in (False, True))
    assert torch.equal(shown["depth"], hidden["depth"])
    assert (hidden["hit"] < shown["hit"]).any()


@pytest.mark.parametrize("material", [
    diffuse(0.2, 0.4, 0.6), {"type": "roughplastic"}, {"type": "principled", "metallic": 0.3, "roughness": 0.4},
    {"type": "blendbsdf", "weight": {"type": "bitmap", "raw": True, "data": texels(2, 2)},
     "a": diffuse(0.1, 0.2, 0.3), "b": {"type": "roughconductor"}},
    {"type": "normalmap", "normalmap": {"type": "bitmap", "raw": True, "data": texels(3, 3)}, "b": diffuse(0.5, 0.4, 0.3)},
    {"type": "twosided", "a": {"type": "diffuse", "reflectance": {"type": "checkerboard"}}}])
def test_compiled_quantities_are_the_eager_ones(material):
    names, scene = (*NETWORK_FREE, "prim_index", "shape_index"), landscape(material, size=6)
    eager, compiled = (rb.Renderer(scene, spp=8, compile=compile).aovs(names) for compile in (False, True))
    for name in names:
        assert eager[name].abs().max() > 0
        torch.testing.assert_close(compiled[name], eager[name], rtol=1e-12, atol=1e-13)


@pytest.mark.usefixtures("threads")
def test_images_do_not_depend_on_chunks_or_threads():
    scene, names = two_walls(), [*NETWORK_FREE, "alpha", "xyz"]
    expected = rb.Renderer(scene, spp=6, max_depth=3).aovs(names, seed=2)
    for chunk in (1, 5, 36):
        found = rb.Renderer(scene, spp=6, max_depth=3, chunk=chunk).aovs(names, seed=2)
        for name in names:
            torch.testing.assert_close(found[name], expected[name], rtol=1e-13, atol=1e-14)


def test_changes_of_the_scene_are_seen_by_the_next_call():
    scene = landscape()
    renderer = rb.Renderer(scene, spp=2)
    before, image = renderer.aovs(["depth", "albedo"]), renderer(seed=0)
    with torch.no_grad():
        scene.get_parameter("hills.vertex_positions")[:, 2] -= 1
        scene.get_parameter("hills.bsdf.reflectance.data").mul_(0.5)
    after = renderer.aovs(["depth", "albedo"])
    assert (after["depth"] > before["depth"] + 0.9).all()
    assert (after["albedo"] < before["albedo"]).all() and not torch.equal(renderer(seed=0), image)


def test_the_integrator_names_the_outputs():
    scene = landscape(integrator={"type": "aov", "aovs": "dd.y:depth,nn:sh_normal", "img": {"type": "direct"}})
    renderer = rb.Renderer(scene, spp=2)
    found, expected = renderer.aovs(), renderer.aovs(["depth", "sh_normal"])
    assert list(found) == ["dd.y", "nn"]
    assert torch.equal(found["dd.y"], expected["depth"]) and torch.equal(found["nn"], expected["sh_normal"])


@pytest.mark.parametrize("names, error, message", [
    (["dept"], ValueError, "did you mean 'depth'"), (["m2_dept"], ValueError, "not known"),
    ([], ValueError, "at least one"), ("depth", TypeError, "a sequence of names"), ([3], TypeError, "a sequence of names"),
    (None, ValueError, "lists no outputs")])
def test_names_that_are_none_are_refused(names, error, message):
    with pytest.raises(error, match=message):
        rb.Renderer(two_walls(), spp=1).aovs(names)


def test_several_sensors_are_one_batch():
    scene = load(a=sensor(4), b=sensor(4, (0, 0, 5)), wall=rectangle((0, 0, 0), 3), sky={"type": "constant"})
    depth = rb.Renderer(scene, spp=2).aovs(["depth"])["depth"]
    assert depth.shape == (2, 1, 4, 4) and (depth[1] > depth[0] + 1).all()
    assert torch.equal(rb.Renderer(scene, spp=2).aovs(["depth"], sensors="b")["depth"], depth[1:])


def test_jvp_has_quantities_too():
    scene = landscape(size=3)
    tangents = {"sensor.to_world": torch.eye(4)}
    image, found = rb.jvp(scene, tangents, spp=2, max_depth=1, aovs=["depth", "prim_index"])
    assert torch.equal(image, rb.jvp(scene, tangents, spp=2, max_depth=1))
    assert found["depth"].abs().max() > 0 and (found["prim_index"] == 0).all()


def alpha_warnings(names: list[str], **settings) -> list[str]:
    """What two images of quantities of a scene under a sky say about a mask."""
    renderer = rb.Renderer(two_walls(), spp=1, **settings)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for seed in range(2):
            renderer.aovs(names, seed=seed)
    return [str(warning.message) for warning in caught if "'alpha'" in str(warning.message)]


def test_alpha_under_a_sky_is_said_to_be_no_mask_once():
    message, = alpha_warnings(["alpha"])
    assert "'hit'" in message and "hide_emitters=True" in message
    assert alpha_warnings(["hit", "depth"]) == alpha_warnings(["alpha"], hide_emitters=True) == []
