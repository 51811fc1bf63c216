"""Instances show the shapes of a group: as if those stood there, with shared parameters."""

import itertools
import warnings

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import unwarned_renderer
from tests.scenes import diffuse, load, rectangle, rgb, sensor, texels
from tests.scenes.quadrilateral import coloured_file
from tests.shape.surfaces import TEXTURED, meets, of_point
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.io.write import save
from torch_radbp.plugin.domain import Domain
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.packing.pack import pack
from torch_radbp.shape.instance import Instance
from torch_radbp.shape.shapegroup import ShapeGroup

OWN = translate((0.1, 0, 0.2)) @ scale((-0.9, 0.9, 0.9))  # of the shape in its group
POSES = {"mirrored": scale((-1, 1, 1)),
         "squeezed": translate((0.1, -0.2, 0.3)) @ rotate((1, 0.3, 0.2), 40) @ scale((0.8, 1.3, 0.6))}
RAYS = [((0.35, 0.25, 5), (0.03, 0.01, -1)), ((5, 0.3, 0.4), (-1, 0.02, -0.03))]
# Of shape, pose and ray: distance, shading normal, uv by Mitsuba 3.9.1 (`scalar_rgb`, `Scene.ray_intersect`).
RECORDED = {
    ("sphere", "mirrored", 0): (4.17224, [-0.63907, -0.32414, -0.69751], [0.07471, 0.25429]),
    ("sphere", "mirrored", 1): (4.29002, [-0.89998, -0.42867, -0.07922], [0.07075, 0.47476]),
    ("flipped sphere", "mirrored", 0): (4.17224, [0.63907, 0.32414, 0.69751], [0.07471, 0.25429]),
    ("sphere", "squeezed", 0): (3.87802, [-0.50492, 0.03016, -0.86264], [0.3198, 0.30635]),
    ("sphere", "squeezed", 1): (4.55786, [-0.21136, -0.74881, 0.62818], [0.40201, 0.78585]),
    ("flipped sphere", "squeezed", 1): (4.55786, [0.21136, 0.74881, -0.62818], [0.40201, 0.78585]),
    ("rectangle", "mirrored", 0): (4.8, [0.0, 0.0, 1.0], [0.83, 0.66556]),
    ("rectangle", "squeezed", 0): (4.27698, [0.22281, -0.59226, 0.77433], [0.2784, 0.76729]),
    ("disk", "mirrored", 0): (4.8, [0.0, 0.0, 1.0], [0.7384, 0.07401]),
    ("disk", "squeezed", 0): (4.27698, [0.22281, -0.59226, 0.77433], [0.69441, 0.36017]),
    ("cube", "mirrored", 0): (3.9, [0.0, 0.0, 1.0], [0.66056, 0.815]),
    ("cube", "mirrored", 1): (4.2, [1.0, 0.0, 0.0], [0.71333, 0.45889]),
    ("cube", "squeezed", 0): (3.57891, [0.22281, -0.59226, 0.77433], [0.94957, 0.3613]),
    ("cube", "squeezed", 1): (4.1914, [0.97308, 0.18305, -0.14], [0.67117, 0.19646]),
}
FACETS = 1e-3  # of tessellated spheres and disks, stretched
GROUP = {"type": "ref", "id": "group"}
SHEET = {"type": "mesh", "vertex_positions": [[-1.0, -1, 0.1], [1, -1.1, 0.3], [1.1, 1, -0.2], [-0.9, 1, 0.5], [0, 0, 0.4]],
         "faces": [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], "vertex_texcoords": texels(1, 5)[0, :, :2].tolist(),
         "vertex_normals": [[-0.3, -0.2, 1], [0.2, 0, 1], [0.1, 0.3, 1], [0, 0.1, 1], [0.1, 0, 1]]}


@pytest.mark.parametrize("name, pose, ray", RECORDED, ids=str)
def test_points_normals_and_coordinates_are_those_of_mitsuba(name, pose, ray):
    inside = {"type": name.split()[-1], "to_world": OWN, "flip_normals": "flipped" in name, "bsdf": TEXTURED}
    shown = {"type": "instance", "to_world": POSES[pose], "g": GROUP}
    t, normal, uv = of_point(meets(*RAYS[ray], {"group": {"type": "shapegroup", "inside": inside}, "shown": shown}))
    expected_t, expected_normal, expected_uv = RECORDED[name, pose, ray]
    assert abs(t - expected_t) < FACETS
    torch.testing.assert_close(normal, torch.tensor(expected_normal, dtype=normal.dtype), rtol=0, atol=FACETS)
    torch.testing.assert_close(uv, torch.tensor(expected_uv, dtype=uv.dtype), rtol=0, atol=FACETS)


PLACES = [translate((-0.7, -0.2, 0)) @ rotate((1, 2, 0.5), 40) @ scale((0.6, 0.5, 0.7)),
          translate((0.8, 0.3, -0.4)) @ rotate((0.3, -1, 0.2), 35) @ scale((-0.5, 0.7, 0.6))]
SURROUNDINGS = {
    "camera": sensor(8, (0.2, 0.6, 3.5), (0, 0, 0), 45), "sky": {"type": "envmap", "bitmap": texels(4, 5, 3)},
    "lamp": rectangle((0.4, 2.2, 0.5), 0.5, angle=90, emitter={"type": "area", "radiance": rgb(6, 7, 8)}),
    "floor": rectangle((0, -0.9, 0), 4.0, angle=-90, bsdf=diffuse(0.5, 0.6, 0.7)),
    "both": {"type": "twosided", "one": TEXTURED}, "red": diffuse(0.8, 0.3, 0.2),
}
INSIDE = {"sheet": SHEET | {"bsdf": {"type": "ref", "id": "both"}},
          "box": {"type": "cube", "to_world": translate((0.1, 0.9, 0.3)) @ scale((0.3, 0.2, 0.3)),
                  "bsdf": {"type": "ref", "id": "red"}},
          "ball": {"type": "sphere", "to_world": translate((0.2, -0.3, 0.9)) @ scale((0.3, 0.3, 0.3)),
                   "bsdf": {"type": "roughconductor", "alpha": 0.3}}}


def scene_of_instances(inside: tuple[str, ...] = tuple(INSIDE)) -> rb.Scene:
    shown = {f"instance_{number}": {"type": "instance", "to_world": place, "group": GROUP}
             for number, place in enumerate(PLACES)}
    return load(**SURROUNDINGS, group={"type": "shapegroup", **{name: INSIDE[name] for name in inside}}, **shown)


def scene_of_copies(inside: tuple[str, ...] = tuple(INSIDE)) -> rb.Scene:
    """Each of the group's shapes at each place.

    A mirrored sphere turns inside out, and so do the faces of a mirrored mesh; those of an instance do not.
    """
    copies = {f"{name}_{number}": dict(INSIDE[name]) for name in inside for number in range(len(PLACES))}
    if "ball" in inside:
        copies["ball_1"]["flip_normals"] = True
    scene, shown = load(**SURROUNDINGS, **copies), scene_of_instances()
    for name, number in itertools.product(inside, range(len(PLACES))):  # not before: loading rounds to float32
        copy, pose = getattr(scene, f"{name}_{number}"), getattr(shown, f"instance_{number}").to_world
        copy.to_world.data.copy_(pose @ getattr(shown.group, name).to_world)
        if number == 1 and name != "ball":
            copy.faces.copy_(copy.faces[:, [0, 2, 1]])
    return scene


def settings(**others):
    return {"spp": 8, "max_depth": 4, "rr_depth": 100} | others


PLAIN = ("sheet", "box")  # a ball by itself is cast as one, and may be hit at the next facet


@pytest.mark.parametrize("caster", ["embree", "brute", "direct"])
def test_the_image_is_that_of_copies(caster):
    image, expected = (rb.render(scene(PLAIN), **settings(caster=caster)) for scene in (scene_of_instances, scene_of_copies))
    assert expected.min() >= 0 and expected.max() > 0.5
    torch.testing.assert_close(image, expected, rtol=0, atol=1e-10)


BOUNDS = {PLAIN: 2e-6,  # some roundings of numbers around 1; measured 3.6e-7
          # A ball of an instance is cast as triangles, and may be hit at the next facet; measured 9.3e-6.
          tuple(INSIDE): 3e-5}


@pytest.mark.parametrize("caster, spp, inside", [
    ("embree", 8, PLAIN), ("embree", 8, tuple(INSIDE)), ("brute", 2, PLAIN),
    deep("brute", 2, tuple(INSIDE))])  # which tests all triangles of balls
def test_the_image_is_that_of_copies_in_float32(caster, spp, inside):
    """In every pixel: no path is on the other side of an edge."""
    bound = BOUNDS[inside]
    image, expected = (rb.render(scene(inside).float(), **settings(caster=caster, spp=spp))
                       for scene in (scene_of_instances, scene_of_copies))
    assert expected.max() > 0.5
    torch.testing.assert_close(image, expected, rtol=0, atol=bound)


def gradients(scene: rb.Scene, names: list[str], sampling: str) -> list[torch.Tensor]:
    """Of a projection of the image."""
    parameters = [scene.get_parameter(name).requires_grad_() for name in names]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.SilhouetteWarning)
        image = unwarned_renderer(scene, sampling=sampling, terms=["interior"], **settings(compile=False))(seed=3)
    cotangent = torch.randn(image.shape, generator=torch.Generator().manual_seed(1), dtype=image.dtype)
    return torch.autograd.grad(image, parameters, cotangent)


@pytest.mark.parametrize("sampling", ["detached", "hybrid", "attached"])
def test_gradients_are_those_of_copies(sampling):
    """Of vertices and normals, which add up over the instances, and of materials."""
    names = ["vertex_positions", "vertex_normals"]
    positions, normals, colour = gradients(scene_of_instances(PLAIN), [
        *(f"group.sheet.{name}" for name in names), "red.reflectance.value"], sampling)
    *of_copies, expected = gradients(scene_of_copies(PLAIN), [
        *(f"sheet_{number}.{name}" for name in names for number in (0, 1)), "red.reflectance.value"], sampling)
    for found, wanted in ((positions, of_copies[0] + of_copies[1]), (normals, of_copies[2] + of_copies[3]),
                          (colour, expected)):
        assert torch.isfinite(wanted).all() and wanted.abs().max() > 1e-2
        torch.testing.assert_close(found, wanted, rtol=0, atol=1e-10 * float(wanted.abs().max()))


@pytest.mark.parametrize("sampling", ["hybrid", "attached"])
def test_gradients_of_shared_parameters_are_sums_and_each_place_has_its_own(sampling):
    """Against the same scene with every shape under its product of poses, as autograd sees it."""
    place = PLACES[0]
    inside = {"type": "sphere", "to_world": translate((0.2, -0.3, 0.4)) @ scale((0.3, 0.5, 0.3)), "bsdf": TEXTURED}
    own, second = torch.as_tensor(inside["to_world"]), torch.as_tensor(translate((1.1, 0.2, 0.3)))
    shown = load(**SURROUNDINGS, group={"type": "shapegroup", "ball": inside},
                 a={"type": "instance", "to_world": place, "group": GROUP},
                 b={"type": "instance", "to_world": second, "group": GROUP})
    of_ball, of_a, of_b = gradients(shown, ["group.ball.to_world", "a.to_world", "b.to_world"], sampling)
    copies = load(**SURROUNDINGS, a=inside | {"to_world": torch.as_tensor(place) @ own},
                  b=inside | {"to_world": second @ own})
    at_a, at_b = gradients(copies, ["a.to_world", "b.to_world"], sampling)
    first = shown.get_parameter("a.to_world").detach()
    expected = first.T @ at_a + second.T @ at_b
    for found, wanted in ((of_a, at_a @ own.T), (of_b, at_b @ own.T), (of_ball, expected)):
        assert wanted[:3].abs().max() > 1e-2
        torch.testing.assert_close(found[:3], wanted[:3], rtol=1e-4, atol=1e-4 * float(wanted[:3].abs().max()))


def test_names_are_those_of_mitsuba(mi):
    ours = {name for name, _ in scene_of_instances().named_parameters() if name.startswith(("group", "instance"))}
    theirs = mi.traverse(mi.load_dict({
        "type": "scene", "group": {"type": "shapegroup", "box": {"type": "cube"}, "ball": {"type": "sphere"}},
        "instance_0": {"type": "instance", "group": GROUP}, "instance_1": {"type": "instance", "group": GROUP}}))
    wanted = {name for name in theirs.keys() if name.endswith(("to_world", "vertex_positions", "vertex_normals"))}
    assert len(wanted) == 5 and wanted <= ours


def test_what_has_not_changed_is_neither_packed_nor_built_again():
    scene = scene_of_instances()
    renderer = rb.Renderer(scene, caster="embree", **settings(spp=1))
    with torch.no_grad():
        renderer(seed=0)
        before, kept = renderer.last_caster, renderer.cache
        tables = pack(scene, PackCache(kept)).triangles
        again = pack(scene, PackCache(kept)).triangles
        assert again.vertices is tables.vertices and again.instances is tables.instances
        renderer(seed=0)
        assert renderer.last_caster is before
        scene.instance_1.to_world[0, 3] += 0.5
        renderer(seed=0)
    after, moved = renderer.last_caster, pack(scene, PackCache(renderer.cache)).triangles
    assert after is not before and after.groups[0].tree is before.groups[0].tree
    assert moved.vertices is tables.vertices and moved.n is tables.n
    shift = moved.instances.origin.x - tables.instances.origin.x
    torch.testing.assert_close(shift, torch.tensor([0, 0, 0.5], dtype=shift.dtype))


def test_a_group_that_changes_is_built_again():
    scene = scene_of_instances()
    renderer = rb.Renderer(scene, caster="embree", **settings(spp=1))
    with torch.no_grad():
        first = renderer(seed=0)
        before = renderer.last_caster
        scene.group.sheet.vertex_positions += torch.tensor([0, 0, 0.2])
        second = renderer(seed=0)
    assert renderer.last_caster.groups[0].tree is not before.groups[0].tree and not torch.equal(first, second)


def test_hundreds_of_instances():
    """Their triangles exist once."""
    places = [translate((x, y, -0.2 * x)) @ rotate((0, 0, 1), 7 * x + 11 * y) @ scale((0.3, 0.3, 0.3))
              for x in range(-20, 20, 2) for y in range(-12, 12, 2)]
    shown = {f"i{number}": {"type": "instance", "to_world": place, "group": GROUP} for number, place in enumerate(places)}
    both = {"type": "twosided", "one": diffuse(0.7, 0.4, 0.2)}
    scene = load(torch.float32, camera=sensor(16, (0, 0, 50), (0, 0, 0), 45), sky=SURROUNDINGS["sky"],
                 group={"type": "shapegroup", "sheet": SHEET | {"bsdf": both}}, **shown)
    assert len(scene.shapes) == 1 and len(pack(scene).triangles.material) == 4
    poses = [instance.to_world.requires_grad_() for instance in scene.groups[id(scene.group)]]
    positions = scene.get_parameter("group.sheet.vertex_positions").requires_grad_()
    with pytest.warns(rb.SilhouetteWarning, match="`group.sheet.vertex_positions` and `i0.to_world` and .* and 233 others"):
        image = rb.Renderer(scene, terms=["interior"], **settings(spp=64))(seed=0)
    *of_poses, of_positions = torch.autograd.grad(image.sum(), [*poses, positions])
    assert torch.isfinite(torch.stack(of_poses)).all() and torch.isfinite(of_positions).all()
    assert (torch.stack(of_poses).abs().amax((1, 2)) > 0).sum() > 0.9 * len(poses) and of_positions.abs().max() > 0


def test_attributes_are_shown_by_every_instance():
    coloured = {"type": "ply", "filename": coloured_file(), "to_world": translate((0, 0, 0.2)), "bsdf": {
        "type": "twosided", "one": {"type": "roughplastic", "diffuse_reflectance": {
            "type": "mesh_attribute", "name": "vertex_color"}, "specular_reflectance": {
            "type": "mesh_attribute", "name": "face_shine"}}}}
    places = [translate((0.9 * number - 0.9, 0, 0)) @ scale((0.25, 0.25, 0.25)) for number in range(3)]
    shown = load(**SURROUNDINGS, group={"type": "shapegroup", "sheet": coloured},
                 **{f"i{number}": {"type": "instance", "to_world": place, "g": GROUP}
                    for number, place in enumerate(places)})
    copies = load(**SURROUNDINGS, **{f"c{number}": coloured | {"to_world": place @ coloured["to_world"]}
                                     for number, place in enumerate(places)})
    image = rb.render(shown, **settings())
    torch.testing.assert_close(rb.render(copies, **settings()), image, rtol=0, atol=1e-5)
    colours = shown.get_parameter("group.sheet.vertex_color").requires_grad_()
    gradient, = torch.autograd.grad(rb.render(shown, **settings()).sum(), colours)
    at_copies = [copies.get_parameter(f"c{number}.vertex_color").requires_grad_() for number in range(3)]
    expected = sum(torch.autograd.grad(rb.render(copies, **settings()).sum(), at_copies))
    assert expected.abs().min() > 0
    torch.testing.assert_close(gradient, expected, rtol=1e-4, atol=0)


def test_forward_mode_is_the_transpose():
    scene = scene_of_instances()
    names = ["instance_1.to_world", "group.sheet.vertex_positions"]
    generator = torch.Generator().manual_seed(4)
    tangents = {name: torch.randn(scene.get_parameter(name).shape, generator=generator, dtype=torch.float64)
                for name in names}
    tangents["instance_1.to_world"][3] = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.SilhouetteWarning)
        derivative = rb.jvp(scene, tangents, seed=3, **settings(compile=False, spp=1, max_depth=3))
        parameters = [scene.get_parameter(name).requires_grad_() for name in names]
        image = unwarned_renderer(scene, **settings(compile=False, spp=1, max_depth=3))(seed=3)
    cotangent = torch.randn(image.shape, generator=generator, dtype=torch.float64)
    gradients = torch.autograd.grad(image, parameters, cotangent)
    backward = sum((gradient * tangents[name]).sum() for gradient, name in zip(gradients, names))
    assert abs(float(backward)) > 1e-3
    torch.testing.assert_close((derivative * cotangent).sum(), backward, rtol=1e-9, atol=0)


def test_saved_and_loaded_it_is_the_same(tmp_path, mi):
    scene = scene_of_instances()
    save(scene, tmp_path / "scene.xml")
    other = rb.load(tmp_path / "scene.xml").double()
    ours, theirs = (dict(each.named_parameters()) for each in (scene, other))
    assert set(ours) == set(theirs)
    torch.testing.assert_close(rb.render(other, **settings()), rb.render(scene, **settings()), rtol=0, atol=1e-3)
    peer = np.array(mi.render(mi.load_file(str(tmp_path / "scene.xml")), spp=64)).mean((0, 1))
    np.testing.assert_allclose(peer, rb.render(scene, **settings(spp=64))[0].mean((1, 2)).numpy(), rtol=0.03)


def test_gltf_has_copies(tmp_path):
    """At the same places, on the same side: seen from the camera they look the same."""
    scene = load(**{name: value for name, value in SURROUNDINGS.items() if name in ("camera", "floor", "red")},
                 lamp={"type": "point", "position": [0.4, 2.2, 1.5], "intensity": rgb(9, 9, 9)},
                 group={"type": "shapegroup", "box": INSIDE["box"]},
                 **{f"i{number}": {"type": "instance", "to_world": place, "group": GROUP}
                    for number, place in enumerate(PLACES)})
    with pytest.warns(UserWarning, match="i0.box, i1.box: is written as a copy"):
        rb.save(scene, tmp_path / "scene.glb")
    other = rb.load(tmp_path / "scene.glb")
    assert {"i0_box", "i1_box"} <= {scene.name_of(shape) for scene in [other] for shape in other.shapes}
    images = [rb.render(each.double(), **settings(max_depth=2, spp=64)) for each in (scene, other)]
    assert images[0].max() > 0.05
    torch.testing.assert_close(images[1].mean((2, 3)), images[0].mean((2, 3)), rtol=0.05, atol=0)


INSTANCE = {"type": "instance", "g": {"type": "ref", "id": "group"}}


@pytest.mark.parametrize("objects, message", [
    ({"group": {"type": "sphere"}, "i": INSTANCE}, "an instance shows a shapegroup, got a shape of type sphere"),
    ({"group": {"type": "shapegroup"}, "i": {"type": "instance"}}, "instance needs 'shapegroup', which is missing"),
    ({"group": {"type": "shapegroup"}, "i": INSTANCE | {"bsdf": diffuse(1, 1, 1)}}, "a bsdf, which cannot"),
    ({"group": {"type": "shapegroup"}, "i": INSTANCE | {"h": {"type": "shapegroup"}}}, "instance takes one shapegroup"),
    ({"group": {"type": "shapegroup", "to_world": np.eye(4)}}, "shapegroup has no attribute 'to_world'"),
    ({"group": {"type": "shapegroup", "paint": diffuse(1, 1, 1)}}, "a bsdf, which cannot stand here; supported: shape"),
    ({"group": {"type": "shapegroup", "inner": {"type": "shapegroup"}}}, "'inner' is of type shapegroup, which a"),
    ({"group": {"type": "shapegroup"}, "outer": {"type": "shapegroup", "inner": INSTANCE}}, "'inner' is of type instance"),
    ({"group": {"type": "shapegroup", "glow": {"type": "sphere", "emitter": {"type": "area"}}}},
     "the shape 'glow' carries an emitter, which cannot be instanced"),
])
def test_what_is_refused(objects, message):
    with pytest.raises(rb.SceneError, match=message):
        load(camera=sensor(2), sky={"type": "constant"}, **objects)


def test_a_group_that_no_instance_shows_is_not_seen():
    hidden = {"group": {"type": "shapegroup", "ball": {"type": "sphere"}}}
    with pytest.raises(ValueError, match="the scene has no shape to render"):
        rb.Renderer(load(camera=sensor(2), sky={"type": "constant"}, **hidden))
    floor = rectangle((0, -1, 0), 2, angle=-90)
    images = [rb.render(load(camera=sensor(4), sky={"type": "constant"}, floor=floor, **more), spp=4)
              for more in ({}, hidden)]
    assert torch.equal(*images)


def test_poses_are_checked_once_each_and_again_only_where_they_have_changed(monkeypatch):
    """When they are loaded, and by the first rendering."""
    checked, plain = [], Domain.check_pose
    monkeypatch.setattr(Domain, "check_pose", staticmethod(lambda name, pose: checked.append(name) or plain(name, pose)))
    group = ShapeGroup()
    for _ in range(3):
        Instance(shapegroup=group, to_world=torch.as_tensor(PLACES[0]))
    assert checked == ["to_world"] * 3
    scene = scene_of_instances(PLAIN)
    renderer = rb.Renderer(scene, **settings(spp=1))
    with torch.no_grad():
        checked.clear()
        renderer(seed=0)
        assert sum("instance_" in name for name in checked) == 2
        checked.clear()
        renderer(seed=1)
        assert not checked
        scene.instance_1.to_world[0, 3] += 0.1
        renderer(seed=2)
    assert checked == ["parameter 'instance_1.to_world': to_world"]
