"""Quantities beside those of Mitsuba's `aov` and `moment` integrators, of the same scene files."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, sensor, texels
from tests.scenes.aovs import hills

SPP, SEEDS = 64, 6
SMOOTH = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.5, 0.3]}}
PLASTIC = {**SMOOTH, "type": "roughplastic", "alpha": 0.2}
TURNED = {"type": "normalmap", "normalmap": {"type": "bitmap", "raw": True, "data": np.full((2, 2, 3), (0.7, 0.6, 0.9))}}
COLOURED = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels(4, 5)}}
# name -> (material, angle at which it is seen)
MATERIALS = {
    "diffuse": (diffuse(0.2, 0.4, 0.6), 20), "behind": (diffuse(0.2, 0.4, 0.6), 200), "bitmap": (COLOURED, -30),
    "roughplastic": (PLASTIC, 25), "plastic": (SMOOTH, 25),
    "roughconductor": ({"type": "roughconductor", "alpha": 0.4}, 15), "dielectric": ({"type": "dielectric"}, 10),
    "principled": ({"type": "principled", "base_color": {"type": "rgb", "value": [0.7, 0.2, 0.1]}, "metallic": 0.4}, 10),
    "principledthin": ({"type": "principledthin", "base_color": {"type": "rgb", "value": [0.7, 0.2, 0.1]}}, 10),
    "mask": ({"type": "mask", "opacity": 0.3, "b": diffuse(0.2, 0.4, 0.6)}, 20),
    "blend": ({"type": "blendbsdf", "weight": 0.3, "a": diffuse(0.2, 0.4, 0.6), "b": PLASTIC}, 20),
    "turned": (TURNED | {"b": diffuse(0.2, 0.4, 0.6)}, 20), "turned, behind": (TURNED | {"b": PLASTIC}, 190),
    "two sides, behind": ({"type": "twosided", "a": diffuse(0.2, 0.4, 0.6), "b": PLASTIC}, 205),
    "turned, two sides": ({"type": "twosided", "a": TURNED | {"b": diffuse(0.2, 0.4, 0.6)}}, 20),
    "turned, two sides, behind": ({"type": "twosided", "a": TURNED | {"b": diffuse(0.2, 0.4, 0.6)}}, 200),
}
FIRST = ("depth", "position", "uv", "geo_normal", "sh_normal", "dp_du", "dp_dv", "albedo")
LISTED = ",".join(f"{name}:{name}" for name in FIRST)


def beside(mi, tmp_path, scene, channels, spp=SPP):
    """Mitsuba's image of a scene file: mean and standard error of each channel of each pixel, (C, H, W)."""
    rb.save(scene, tmp_path / "scene.xml")
    theirs = mi.load_file(str(tmp_path / "scene.xml"))
    runs = np.stack([np.array(mi.render(theirs, spp=spp, seed=seed)) for seed in range(SEEDS)])
    assert runs.shape[-1] == channels
    runs = torch.from_numpy(runs).movedim(-1, 1).double()
    return runs.mean(0), runs.std(0) / SEEDS**0.5


def ours(scene, names, **settings):
    """The same of ours, from as many seeds."""
    renderer = rb.Renderer(scene, spp=SPP, **settings)
    runs = [renderer.aovs(names, seed=seed) for seed in range(SEEDS)]
    runs = torch.stack([torch.cat([found[name][0] for name in found], 0) for found in runs]).double()
    return runs.mean(0), runs.std(0) / SEEDS**0.5


def assert_agree(found, expected, worst=6.5):
    """Each pixel within `worst` standard errors; float32 and fewer than 20 runs make the tails heavy."""
    (mean, error), (wanted, their_error) = found, expected
    assert torch.isfinite(wanted).all() and wanted.abs().max() > 0
    z = (mean - wanted).abs() / (error**2 + their_error**2 + (2e-4 * (0.1 + wanted.abs())) ** 2).sqrt()
    assert z.max() < worst, f"channel {int(z.flatten(1).max(1).values.argmax())}: {z.max():.1f} standard errors"
    assert z.square().mean() < 2.5  # of 1.25 expected for 10 degrees of freedom


def described(material, angle, integrator=None):
    """A rectangle of a material, turned, beside a mesh with normals and coordinates."""
    return load(torch.float32, integrator=integrator or {"type": "aov", "aovs": LISTED}, sensor=sensor(6, fov=38),
                sheet=rectangle((0.1, 0, 0.3), 0.8, (0, 1, 0), angle, bsdf=material),
                hills={**hills(), "bsdf": COLOURED, "to_world": np.diag([0.2, 0.2, 0.2, 1.0])},
                lamp={"type": "point", "position": [0, 1, 3]})


@pytest.mark.parametrize("name", MATERIALS)
def test_quantities_agree_with_those_of_mitsuba(mi, tmp_path, name):
    scene = described(*MATERIALS[name])
    names = tuple(scene.integrator.outputs())
    assert names == FIRST
    assert_agree(ours(scene, names), beside(mi, tmp_path, scene, 21))


def test_curved_shapes_agree_with_those_of_mitsuba(mi, tmp_path):
    """Sphere and disk are tessellated here, finely: they differ by the angles of the facets, a hundredth or two."""
    names = ("depth", "position", "uv", "geo_normal", "sh_normal", "dp_du", "dp_dv")
    scene = load(torch.float32, integrator={"type": "aov", "aovs": ",".join(f"{name}:{name}" for name in names)},
                 sensor=sensor(6, (0.3, 0.4, 3.5), fov=30), sky={"type": "constant"},
                 ball={"type": "sphere", "center": [-0.5, 0.1, 0], "radius": 0.5},
                 plate={"type": "disk", "to_world": np.diag([0.5, 0.6, 1.0, 1.0]) + 0.6 * np.eye(4, k=3)})
    (mean, error), (wanted, their_error) = ours(scene, names), beside(mi, tmp_path, scene, 18)
    difference = (mean - wanted).abs() / (1 + wanted.abs()) - 6 * (error + their_error)
    assert wanted.abs().max() > 1 and difference.max() < 0.02


def test_triangles_of_meshes_have_the_numbers_of_mitsuba(mi, tmp_path):
    """On other shapes they are 0, as Mitsuba's are in its compiled variants; in scalar_rgb they are undefined."""
    scene = load(torch.float32, integrator={"type": "aov", "aovs": "number:prim_index"},
                 sensor=sensor(6, (0.2, 0.3, 5), fov=60), hills=hills(), sky={"type": "constant"})
    assert_agree(ours(scene, None), beside(mi, tmp_path, scene, 1))
    assert ours(scene, None)[0].max() > 4


def test_shapes_are_numbered_in_the_order_of_the_scene():
    """Mitsuba numbers them from 1, too, but in an order of its own."""
    group = {"type": "shapegroup", "id": "group", "a": rectangle((0, 0, 0), 0.2), "b": rectangle((0, 0.5, 0), 0.2)}
    scene = load(sensor=sensor(9, fov=40), first=rectangle((-0.8, 0, 0), 0.3), group=group,
                 one={"type": "instance", "shapegroup": {"type": "ref", "id": "group"}},
                 two={"type": "instance", "shapegroup": {"type": "ref", "id": "group"},
                      "to_world": np.eye(4) + 0.6 * np.eye(4, k=3)}, sky={"type": "constant"})
    found = rb.Renderer(scene, spp=1, hide_emitters=True).aovs(["shape_index", "prim_index"])
    numbers = found["shape_index"][0, 0]
    assert set(numbers.unique().tolist()) == {0.0, 1.0, 2.0, 3.0}
    assert numbers[4, 1] == 1 and numbers[4, 4] == 2 and numbers[4, 6] == 3 and numbers[8, 8] == 0
    assert (found["prim_index"] == 0).all()


def test_moments_agree_with_those_of_mitsuba(mi, tmp_path):
    scene = described(*MATERIALS["roughplastic"], {"type": "moment", "i": {"type": "path", "max_depth": 3}})
    mean, error = beside(mi, tmp_path, scene, 9)
    assert list(scene.integrator.outputs()) == ["i", "m2_i"]
    assert_agree(ours(scene, None), (mean[3:], error[3:]))


@pytest.mark.parametrize("kind", ["path", "direct", "volpath"])
@pytest.mark.parametrize("sky", [False, True])
@pytest.mark.parametrize("hidden", [False, True])
def test_alpha_agrees_with_that_of_mitsuba(mi, tmp_path, kind, sky, hidden):
    lamp = {"type": "constant"} if sky else {"type": "point", "position": [0, 1, 3]}
    glass, half = {"type": "thindielectric"}, {"type": "mask", "opacity": 0.4, "b": diffuse(0.5, 0.5, 0.5)}
    film = {"type": "hdrfilm", "width": 6, "height": 6, "pixel_format": "rgba", "rfilter": {"type": "box"}}
    scene = load(torch.float32, integrator={"type": kind, "hide_emitters": hidden}, lamp=lamp,
                 sensor=sensor(6, fov=38, film=film),
                 pane=rectangle((-0.5, 0, 0.2), 0.5, bsdf=glass), leaf=rectangle((0.5, 0.1, 0.1), 0.5, bsdf=half),
                 back=rectangle((0.3, 0.3, -0.5), 0.4, bsdf=half),
                 light=rectangle((0, 0.8, 0.5), 0.3, emitter={"type": "area"}))
    mean, error = beside(mi, tmp_path, scene, 4)
    name = scene.integrator.alpha()
    assert_agree(ours(scene, [name]), (mean[3:], error[3:]))
