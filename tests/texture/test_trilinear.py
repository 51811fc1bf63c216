"""Bitmaps that are read from a pyramid: the levels, which of them is read, what that does to an image, and what it costs."""

import math

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.gradients import relative_error
from tests.scenes import diffuse, load, look_at, rectangle, rgb, sensor, texels
from tests.scenes.parts import lamp, plane
from tests.texture.texel_by_texel import reference
from torch_radbp.call.render_call import start_paths
from torch_radbp.io.values.transform import scale
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.packing.pack import pack
from torch_radbp.tensors.vec import Vec2
from torch_radbp.texture import bitmap as bitmap_file
from torch_radbp.texture.bitmap import Bitmap, pyramid_bank
from torch_radbp.texture.pyramid import half_size, pyramid, sample_pyramid

SKY = {"type": "constant", "radiance": rgb(1, 1, 1)}
LEVEL_STEP = 0.1  # of the values that stand for levels


def image(data, filter_type: str = "trilinear", **attributes) -> dict:
    return {"type": "bitmap", "data": data, "raw": True, "filter_type": filter_type, **attributes}


def squares(count: int, dark: float = 0.1, bright: float = 0.7) -> torch.Tensor:
    """A checkerboard of single texels."""
    number = torch.arange(count)
    odd = ((number[:, None] + number) % 2).double()
    return (dark + (bright - dark) * odd)[..., None].expand(-1, -1, 3).contiguous()


def floor_scene(texture: dict, size: int = 24, half: float = 60.0, dtype: torch.dtype = torch.float32) -> rb.Scene:
    """A floor to the horizon."""
    return load(dtype, sensor=sensor(size, (0, 2, 0), (0, 0, -12), 40), sky=SKY,
                floor=rectangle((0, 0, -half), half, angle=-90, bsdf={"type": "diffuse", "reflectance": texture}))


def rendered(scene: rb.Scene, **settings) -> torch.Tensor:
    return rb.render(scene, **{"seed": 4, "spp": 8, "max_depth": 2, "compile": False} | settings)


@pytest.mark.parametrize("height, width", [(8, 8), (7, 5), (1, 6), (3, 1), (13, 12), (1, 1)])
def test_all_levels_have_the_mean_of_the_image(height, width):
    data = torch.from_numpy(texels(height, width))
    levels = pyramid(data)
    assert [level.shape[:2] for level in levels][-1] == (1, 1) and len(levels) == 1 + int(math.log2(max(height, width)))
    for level in levels:
        assert torch.allclose(level.mean((0, 1)), data.mean((0, 1)), rtol=0, atol=1e-15)


@pytest.mark.parametrize("size", [2, 5, 6, 9])
def test_a_coarser_texel_is_the_mean_of_the_area_that_it_covers(size):
    data, half = torch.from_numpy(texels(size, 1)), size // 2
    wide = size / half
    covered = torch.tensor([[max(0.0, min(k + 1, (i + 1) * wide) - max(k, i * wide)) for k in range(size)]
                            for i in range(half)], dtype=torch.float64)
    expected = torch.einsum("ik,kjc->ijc", covered / wide, data)
    assert torch.allclose(half_size(data, 0), expected, rtol=0, atol=1e-15)
    assert torch.allclose(half_size(data.transpose(0, 1), 1), expected.transpose(0, 1), rtol=0, atol=1e-15)


@pytest.mark.parametrize("mode", ["repeat", "mirror", "clamp"])
def test_a_value_lies_between_those_of_two_levels(mode, monkeypatch):
    """Against bilinear reading, texel by texel, of the levels around log2 of the width in texels."""
    texture = Bitmap(data=torch.from_numpy(texels(9, 11)), filter_type="trilinear", wrap_mode=mode).double()
    generator = np.random.default_rng(3)
    uv, levels = generator.uniform(-1.6, 2.6, (60, 2)), generator.uniform(-1.5, 4.5, 60)
    bank = pyramid_bank([texture], torch.float64, torch.device("cpu"))
    footprint = torch.from_numpy(np.log(2.0**levels / math.sqrt(9 * 11)))
    found = sample_pyramid(bank, torch.zeros(60, dtype=torch.int32), Vec2.of(torch.from_numpy(uv)), footprint)
    images = [level.detach().numpy() for level in pyramid(texture.data)]
    assert len(images) == 4

    def read(level: int, u: float, v: float) -> np.ndarray:
        data = images[level]
        monkeypatch.setattr("tests.texture.texel_by_texel.HEIGHT", data.shape[0])
        monkeypatch.setattr("tests.texture.texel_by_texel.WIDTH", data.shape[1])
        return reference(data, u, v, mode, nearest=False)

    for (u, v), level, value in zip(uv, np.clip(levels, 0, 3), found.stack().detach().numpy()):
        finer, share = int(level), level - int(level)
        expected = (1 - share) * read(finer, u, v) + (share * read(finer + 1, u, v) if share else 0)
        np.testing.assert_allclose(value, expected, rtol=0, atol=1e-12)


@pytest.fixture
def level_as_value(monkeypatch):
    """Every level of every pyramid is its own number times `LEVEL_STEP`, so that an albedo tells which was read."""
    def numbered(data):
        return [torch.full_like(level, LEVEL_STEP * number) for number, level in enumerate(pyramid(data))]
    monkeypatch.setattr(bitmap_file, "pyramid", numbered)


def levels_seen(scene: rb.Scene, **settings) -> torch.Tensor:
    """(H, W) the level that each pixel reads."""
    return rb.Renderer(scene, spp=4, compile=False, **settings).aovs(["albedo"], seed=2)["albedo"][0, 0] / LEVEL_STEP


@pytest.mark.parametrize("distance", [3.0, 11.0, 40.0])
def test_the_level_is_that_of_a_pixels_width(distance, level_as_value):
    """Seen head-on, a pixel in the middle of a perspective view is 2 d tan(fov / 2) / pixels wide, and a texel 2 / 512."""
    scene = load(sensor=sensor(9, (0, 0, distance), (0, 0, 0), 2.0), sky=SKY,
                 sheet=rectangle((0, 0, 0), bsdf={"type": "diffuse", "reflectance": image(squares(512))}))
    expected = math.log2(2 * distance * math.tan(math.radians(1)) / 9 / (2 / 512))
    assert 0 < expected < 9
    assert levels_seen(scene) == pytest.approx(torch.full((9, 9), expected).numpy(), abs=2e-3)


def test_the_level_follows_pixels_transform_and_angle(level_as_value):
    """An orthographic camera: a pixel 2 / 8 wide, twice as many texels by `to_uv`, a surface turned by 60 degrees."""
    texture = image(squares(64), to_uv=scale((4, 1, 1)))
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    pose = look_at((0, 0, 5), (0, 0, 0), (0, 1, 0))
    scene = load(sensor={"type": "orthographic", "film": film, "to_world": pose}, sky=SKY,
                 sheet=rectangle((0, 0, 0), 9.0, (0, 1, 0), 60, bsdf={"type": "diffuse", "reflectance": texture}))
    expected = math.log2(2 / 8 / (18 / 64) * 2 / math.cos(math.radians(60)))
    assert levels_seen(scene) == pytest.approx(torch.full((8, 8), expected).numpy(), abs=1e-6)


def test_a_constant_bitmap_is_a_constant_colour():
    value = torch.tensor([0.3, 0.6, 0.2], dtype=torch.float64)
    found, expected = (rendered(floor_scene(texture, dtype=torch.float64), max_depth=3)
                       for texture in (image(value.expand(5, 7, 3)), rgb(*value.tolist())))
    assert expected.max() > 0 and relative_error(found, expected) < 1e-7  # loading rounds to float32


def test_texels_that_are_far_away_read_their_mean():
    """Squares of which thousands lie in a pixel: without a pyramid every sample is one or the other."""
    board = squares(1024)
    found, noisy = (rendered(load(sensor=sensor(4, (0, 0, 900), (0, 0, 0), 0.1), sky=SKY, sheet=rectangle(
        (0, 0, 0), bsdf={"type": "diffuse", "reflectance": texture})), spp=2, nee=False)
        for texture in (image(board), image(board, "bilinear")))
    assert torch.allclose(found, torch.full_like(found, 0.4), rtol=0, atol=1e-6)
    assert noisy.std() > 0.05


def test_texels_larger_than_pixels_are_read_as_by_the_bilinear_filter():
    data = texels(4, 5)
    found, expected = (rendered(floor_scene(image(data, name), 32, half=8.0)) for name in ("trilinear", "bilinear"))
    near = slice(24, 32)  # rows
    assert expected[..., near, :].std() > 0.01 and torch.equal(found[..., near, :], expected[..., near, :])


def test_a_distant_floor_is_quieter_and_hardly_biased():
    """At equal samples, each pixel from the texture alone. Measured: less than a quarter of the variance; means that differ
    by 0.1 percent."""
    images = {name: torch.cat([rendered(floor_scene(image(texels(256, 256), name)), seed=seed, spp=4, nee=False)
                               for seed in range(6)]) for name in ("trilinear", "bilinear")}
    floor = slice(11, 24)  # rows
    variance = {name: found[..., floor, :].var(0).mean() for name, found in images.items()}
    mean = {name: found[..., floor, :].mean() for name, found in images.items()}
    assert variance["bilinear"] > 0 and variance["trilinear"] < 0.3 * variance["bilinear"]
    assert abs(mean["trilinear"] / mean["bilinear"] - 1) < 0.01


def behind(material: dict) -> rb.Scene:
    """A sheet behind the camera, and a surface in front of it that reflects all light."""
    sheet = image(squares(1024))
    return load(sensor=sensor(9, (0, 0, 0), (0, 0, -1), 2.0), sky=SKY, front=rectangle((0, 0, -3), bsdf=material),
                behind=rectangle((0, 0, 5), 20.0, (0, 1, 0), 180, bsdf={"type": "diffuse", "reflectance": sheet}))


def test_cones_grow_along_the_whole_path_and_by_scattering(level_as_value):
    """Of a mirror the level is that of the whole distance, 3 + 8; diffuse reflection adds 0.45 rad or more to a spread of
    0.004."""
    def levels(material: dict) -> torch.Tensor:
        """Of single paths that see the sheet, and that the sheet sends to the sky."""
        found = rendered(behind(material), nee=False, max_depth=3, spp=1)[:, 0]
        return found[(found > 0) & (found < 0.999)] / LEVEL_STEP

    expected = math.log2(2 * 11 * math.tan(math.radians(1)) / 9 / (40 / 1024))
    mirrored, scattered = levels({"type": "conductor", "material": "none"}), levels(diffuse(1, 1, 1))
    assert len(mirrored) > 60 and mirrored == pytest.approx(torch.full_like(mirrored, expected).numpy(), abs=2e-3)
    assert len(scattered) > 30 and scattered.min() > math.log2(0.45 * 8 / (40 / 1024)) - 0.02


def test_paths_carry_cones_only_where_a_material_reads_a_pyramid():
    def state(filter_type: str, lamps: str = "bilinear"):
        printed = {"type": "diffuse", "reflectance": image(texels(3, 3), filter_type)}
        scene = load(sensor=sensor(2), plane=plane(bsdf=printed),
                     lamp=lamp(emitter={"type": "area", "radiance": image(texels(3, 3), lamps)}))
        call = rb.Renderer(scene).prepare(0, None, 1, None)
        return start_paths(call, call.wavefronts[0], 0)

    assert state("bilinear").cone is None and state("bilinear", "trilinear").cone is None
    assert state("trilinear").cone is not None


def test_lamps_are_read_bilinear():
    """In next-event estimation, which knows no cone, as where they are seen."""
    found, expected = (rendered(load(sensor=sensor(6), plane=plane(bsdf=diffuse(0.8, 0.6, 0.4)), lamp=rectangle(
        (0, 0.5, 1), 0.3, angle=200, emitter={"type": "area", "radiance": image(8 * texels(9, 7), name)})))
        for name in ("trilinear", "bilinear"))
    assert expected.max() > 0 and torch.equal(found, expected)


def test_a_pyramid_is_built_again_only_if_its_texels_have_changed(monkeypatch):
    built = []
    monkeypatch.setattr(bitmap_file, "pyramid", lambda data: built.append(1) or pyramid(data))
    scene, kept = floor_scene(image(texels(5, 6))), PackCache()
    scene.floor.bsdf.reflectance.data.requires_grad_(False)
    for _ in range(3):
        kept = PackCache(kept)
        pack(scene, kept)
        kept.close()
    assert len(built) == 1
    scene.floor.bsdf.reflectance.data.mul_(0.5)
    pack(scene, PackCache(kept))
    assert len(built) == 2


def test_xml_keeps_the_filter(tmp_path):
    scene = floor_scene(image(texels(5, 6)))
    rb.save(scene, tmp_path / "floor.xml")
    again = rb.load(tmp_path / "floor.xml")
    assert again.floor.bsdf.reflectance.filter_type == "trilinear"
    assert torch.equal(rendered(again), rendered(scene))


def test_an_unknown_filter_lists_those_that_there_are():
    with pytest.raises(ValueError, match="filter_type 'mipmap' is not known.*bilinear, nearest, trilinear"):
        Bitmap(data=texels(2, 2), filter_type="mipmap")
