"""The environment map: where directions are drawn, what is seen in which direction, closed forms.

Chi-square tests of samples against the density that is claimed for them (Subr and Arvo 2007).
"""

import math

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.emitter.lanes import detached, uniform
from tests.scenes import load, sensor, texels
from tests.scenes.lights import FLOOR, scene_of, sky_image, turned
from torch_radbp.check.chi_square import SIGNIFICANCE, p_value
from torch_radbp.emitter.envmap import EnvmapKind, EnvmapTable, density, sample_direction
from torch_radbp.emitter.latitude_longitude import latitude_longitude
from torch_radbp.sampling.grid import grid_distribution
from torch_radbp.tensors.vec import Vec3

COUNT = 200_000
SPLIT = 2  # parts of a cell of the map, along each axis, that the samples are counted in


def envmap(image, dtype=torch.float64, **attributes) -> EnvmapTable:
    return table(load(dtype, sensor=sensor(2), **FLOOR, sky={"type": "envmap", "bitmap": image, **attributes}))


def table(scene: rb.Scene) -> EnvmapTable:
    """The table of a scene's only kind of light."""
    found, = detached(scene).lights.tables
    return found


def linear(attributes) -> torch.Tensor:
    return torch.as_tensor(attributes.get("to_world", np.eye(4)))[:3, :3]


def parts(image, attributes) -> tuple[Vec3, torch.Tensor]:
    """World directions in the middle of the parts of a map's cells, and the solid angle of the parts in the world.

    Along a cell, the density over local solid angle is constant, so that a midpoint stands for the whole part.
    """
    rows, columns = max(image.shape[0] - 1, 1), image.shape[1]
    z = np.cos(np.pi * np.arange(rows + 1) / rows)
    weights = (np.arange(SPLIT) + 0.5) / SPLIT
    cosine = (z[:-1, None] + (z[1:] - z[:-1])[:, None] * weights).ravel()
    phi = 2 * np.pi / columns * (np.arange(columns * SPLIT) / SPLIT + 0.5 / SPLIT + 0.5)
    solid_angle = np.repeat((z[:-1] - z[1:]) / SPLIT, SPLIT) * 2 * np.pi / (columns * SPLIT)
    cosine, phi = (torch.from_numpy(a).reshape(-1) for a in np.meshgrid(cosine, phi, indexing="ij"))
    sine = torch.sqrt(1 - cosine**2)
    local = torch.stack([sine * torch.sin(phi), cosine, -sine * torch.cos(phi)], 1)
    world = local @ linear(attributes).T
    length = world.norm(dim=1)
    stretch = torch.linalg.det(linear(attributes)).abs() / length**3
    return Vec3.of(world / length[:, None]), torch.from_numpy(np.repeat(solid_angle, columns * SPLIT)) * stretch


def counted(d: Vec3, image, attributes) -> np.ndarray:
    """How many directions lie in each of `parts`."""
    rows, columns = max(image.shape[0] - 1, 1), image.shape[1]
    local = d.stack().double() @ torch.linalg.inv(linear(attributes)).T
    x, y, z = (local / local.norm(dim=1, keepdim=True)).unbind(1)
    theta, u = torch.acos(y.clamp(-1, 1)), torch.atan2(x, -z) / (2 * math.pi)
    row = (theta / math.pi * rows).long().clamp_max(rows - 1)
    edge = torch.cos(math.pi * torch.arange(rows + 1, dtype=torch.float64) / rows)
    part = ((edge[row] - y) / (edge[row] - edge[row + 1]) * SPLIT).long().clamp(0, SPLIT - 1)
    column = (((u * columns - 0.5) % columns) * SPLIT).long().clamp_max(columns * SPLIT - 1)
    return np.bincount(((row * SPLIT + part) * columns * SPLIT + column).numpy(), minlength=rows * columns * SPLIT**2)


SHEAR = np.array([[1.3, 0.4, 0, 0], [0, 0.7, -0.2, 0], [0.3, 0, 1, 0], [0, 0, 0, 1]])
MAPS = {
    "sun and black block": (sky_image(), {}),
    "turned": (sky_image(), {"to_world": turned(20, 50, -10)}),
    "turned, mirrored and scaled": (sky_image(), {"to_world": turned(20, 50, -10) @ np.diag([-2.0, 2, 2, 1])}),
    "not rigid": (sky_image(), {"to_world": turned(20, 50, -10) @ SHEAR}),
    "compensated": (sky_image(), {"mis_compensation": True}),
    "all the same": (np.full((5, 4, 3), 0.7), {}),
    "all the same, compensated": (np.full((5, 4, 3), 0.7), {"mis_compensation": True}),
    "all black": (np.zeros((5, 4, 3)), {}),
    "black by its scale": (sky_image(), {"scale": 0.0}),
    "two rows": (texels(2, 3), {}),
    "one row": (texels(1, 5), {}),
    "one column": (texels(5, 1), {}),
    "one texel": (texels(1, 1), {}),
    "a bright pole": (np.pad(np.zeros((6, 8, 3)), ((0, 1), (0, 0), (0, 0)), constant_values=3.0), {}),
    "a bright seam": (np.pad(np.zeros((6, 8, 3)), ((0, 0), (0, 1), (0, 0)), constant_values=3.0), {}),
}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("image, attributes", MAPS.values(), ids=MAPS)
def test_directions_follow_their_density(image, attributes, dtype):
    scene = envmap(image, dtype, **attributes)
    d, pdf = sample_direction(scene, *uniform(COUNT, 7, torch.float64, 2))
    assert torch.isfinite(d.stack()).all() and torch.isfinite(pdf).all() and (pdf > 0).all()
    torch.testing.assert_close(d.stack().norm(dim=1), torch.ones(COUNT, dtype=dtype), rtol=0, atol=2e-6)
    directions, solid_angle = parts(image, attributes)
    expected = density(envmap(image, **attributes), directions) * solid_angle
    # Scenes round to float32 when they are loaded.
    torch.testing.assert_close(expected.sum(), torch.tensor(1.0, dtype=torch.float64), rtol=0, atol=1e-6)
    observed = counted(d, image, attributes)
    # Rounding moves a few directions across the edge of a black cell.
    assert observed[expected.numpy() == 0].sum() <= 1e-4 * COUNT
    observed[expected.numpy() == 0] = 0
    assert p_value(observed, COUNT * expected.numpy()) > SIGNIFICANCE


@pytest.mark.parametrize("dtype, tolerance", [(torch.float32, 1e-2), (torch.float64, 1e-9)], ids=str)
@pytest.mark.parametrize("image, attributes", MAPS.values(), ids=MAPS)
def test_the_density_of_a_sample_is_the_density_of_its_direction(image, attributes, dtype, tolerance):
    """As multiple importance sampling needs it; but for directions that rounding carries into the next cell."""
    scene = envmap(image, dtype, **attributes)
    d, pdf = sample_direction(scene, *uniform(2000, 8, torch.float64, 2))
    differs = (density(scene, d) / pdf - 1).abs() > tolerance
    assert differs.sum() <= (4 if dtype == torch.float32 else 0)


def test_the_test_notices_a_wrong_density():
    image = sky_image()
    d, _ = sample_direction(envmap(image), *uniform(COUNT, 7, torch.float64, 2))
    directions, solid_angle = parts(image, {})
    other = density(envmap(image + 0.02), directions) * solid_angle
    assert p_value(counted(d, image, {}), COUNT * other.numpy()) < SIGNIFICANCE


def test_a_large_map_is_drawn_from_in_every_cell():
    """2^20 cells: each row and each column of each half gets what it should."""
    weights = torch.rand(512, 2048, generator=torch.Generator().manual_seed(1), dtype=torch.float64) ** 4
    weights[100:200, 300:1000] = 0
    pick = grid_distribution(weights)
    u, v = uniform(400_000, 3, torch.float64, 2)
    cell = pick.sample(u, v)
    assert (weights[cell.row, cell.column] > 0).all()
    share = weights / weights.sum()
    for index, axis in ((cell.row, 1), (cell.column, 0)):
        expected = share.sum(axis).numpy() * len(u)
        assert p_value(np.bincount(index.numpy(), minlength=len(expected)), expected) > SIGNIFICANCE
    blocks = share.reshape(32, 16, 64, 32).sum((1, 3)).numpy() * len(u)
    observed = np.bincount(((cell.row // 16) * 64 + cell.column // 32).numpy(), minlength=32 * 64)
    assert p_value(observed, blocks) > SIGNIFICANCE
    for fraction in (cell.down, cell.across):
        assert 0 <= fraction.min() and fraction.max() <= 1
        assert p_value(np.histogram(fraction.numpy(), 50, (0, 1))[0], np.full(50, len(u) / 50)) > SIGNIFICANCE
    torch.testing.assert_close(pick.cells.diff() / pick.cells[-1], share.reshape(-1))
    assert torch.equal(pick.rows, pick.cells[::2048])


def test_every_number_below_one_draws_a_cell_that_can_be_drawn():
    last = 1 - 2.0**-32
    for weights in ([[0.0, 1, 0], [0, 0, 0]], [[0, 0, 0], [0, 0, 2]], [[1e-9, 0, 1], [1, 0, 1e-9]], [[3.0]]):
        weights = torch.tensor(weights)
        u, v = torch.cartesian_prod(*[torch.tensor([0.0, 2.0**-32, 0.5, last], dtype=torch.float64)] * 2).unbind(1)
        cell = grid_distribution(weights).sample(u, v)
        assert (weights[cell.row, cell.column] > 0).all()


# -- What is seen --------------------------------------------------------------------------------------------------------


def seen(image, direction, **attributes):
    """Radiance along one direction."""
    d = torch.nn.functional.normalize(torch.tensor(direction, dtype=torch.float64), dim=0)
    return EnvmapKind().radiance(envmap(image, **attributes), Vec3(*d[:, None])).stack()[0]


def test_the_centre_of_a_texel_has_its_value_and_the_seam_is_closed():
    image = texels(7, 8)
    for row in range(1, 6):
        for column in range(8):
            theta, phi = math.pi * row / 6, 2 * math.pi * (column + 0.5) / 8
            d = (math.sin(theta) * math.sin(phi), math.cos(theta), -math.sin(theta) * math.cos(phi))
            torch.testing.assert_close(seen(image, d), torch.from_numpy(image[row, column]))
    # On the seam, which is at -z, lies the mean of the first and the last column; and both sides of it agree.
    torch.testing.assert_close(seen(image, (0, 0, -1)), torch.from_numpy(image[3, [0, -1]].mean(0)))
    left, right = (seen(image, (side * 1e-9, 0.3, -1)) for side in (-1, 1))
    torch.testing.assert_close(left, right, rtol=0, atol=1e-8)


def test_a_pole_shows_a_texel_of_its_row():
    image = np.repeat(texels(5, 1), 6, axis=1)
    torch.testing.assert_close(seen(image, (0, 1, 0)), torch.from_numpy(image[0, 0]), rtol=0, atol=1e-5)
    torch.testing.assert_close(seen(image, (0, -1, 0)), torch.from_numpy(image[-1, 0]), rtol=0, atol=1e-5)


def test_a_constant_image_is_a_constant_light():
    """Seen directly and by reflection, from every technique: the image of an envmap of one value is that of `constant`."""
    images = []
    for sky in ({"type": "constant", "radiance": {"type": "rgb", "value": [0.3] * 3}},
                {"type": "envmap", "bitmap": np.full((4, 8, 3), 0.15), "scale": 2.0}):
        scene = load(sensor=sensor(4, (0, 0.5, 3.5)), **FLOOR, sky=sky)
        images.append(rb.render(scene, spp=4, max_depth=3, nee=False))
    torch.testing.assert_close(images[0], images[1], rtol=1e-6, atol=0)


def test_coordinates_are_in_the_unit_square_all_around():
    x, y, z = (2 * c - 1 for c in uniform(10_000, 5, torch.float32))
    d = torch.nn.functional.normalize(torch.stack([x, y, z], 1), dim=1)
    uv = latitude_longitude(Vec3.of(d))
    for c in uv:
        assert c.min() >= 0 and c.max() <= 1
    # The direction that belongs to the coordinates is the one that we came from.
    theta, phi = math.pi * uv.y, 2 * math.pi * uv.x
    back = torch.stack([theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos()], 1)
    torch.testing.assert_close(back, d, rtol=0, atol=2e-6)


def test_the_density_follows_the_parameters():
    """The tables are made anew from the values that the parameters have when the scene is packed."""
    scene = scene_of("envmap")
    with torch.no_grad():
        scene.get_parameter("lamp.data").zero_()
        scene.get_parameter("lamp.data")[2, 3] = 1.0
    d, _ = sample_direction(table(scene), *uniform(1000, 7, torch.float64, 2))
    local = d.stack() @ torch.as_tensor(turned(20, 50, -10))[:3, :3]
    theta, u = torch.acos(local[:, 1]), (torch.atan2(local[:, 0], -local[:, 2]) / (2 * math.pi)) % 1
    assert ((theta - 2 * math.pi / 5).abs() < math.pi / 5 + 1e-9).all()
    assert ((u * 9 - 3.5).abs() < 1 + 1e-9).all()


def test_a_direction_that_is_no_number_reads_inside_of_the_image():
    scene = envmap(sky_image())
    d = Vec3.full(torch.zeros(4, dtype=torch.float64), float("nan"))
    assert EnvmapKind().radiance(scene, d).x.isnan().all()
    assert EnvmapKind().weighing(scene, d).shape == density(scene, d).shape == (4,)
