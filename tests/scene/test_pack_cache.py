"""What a renderer takes over from the last call: all that has not changed, and nothing that has."""

import copy
import gc
import pickle
import weakref

import pytest
import torch
from torch import nn
from torch.func import functional_call
from torch.nn.utils import parametrize
from torch.utils._pytree import tree_flatten

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import unwarned_renderer
from tests.scenes import rectangle
from tests.scenes.one_of_each import Half, scene_of
from torch_radbp.emitter import envmap
from torch_radbp.plugin import Texture
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.packing import geometry, light_table
from torch_radbp.scene.packing.pack import PLACED, pack
from torch_radbp.shape.mesh import Mesh
from torch_radbp.shape.surface import Triangles

SETTINGS = {"spp": 4, "max_depth": 3}


def image_and_gradients(renderer: rb.Renderer, names: tuple[str, ...] = ()) -> list[torch.Tensor]:
    """The image, and the derivatives of its sum by some parameters."""
    wanted = [renderer.scene.get_parameter(name).requires_grad_() for name in names]
    image = renderer(seed=3)
    gradients = torch.autograd.grad(image.square().sum(), wanted) if names else ()
    for parameter in wanted:
        parameter.requires_grad_(False)
    return [image.detach(), *gradients]


def assert_nothing_is_stale(renderer: rb.Renderer, *names: str, **settings) -> None:
    """A call gives what a renderer gives that has never been called before, to the last bit."""
    fresh = unwarned_renderer(renderer.scene, **SETTINGS | settings)
    for found, expected in zip(image_and_gradients(renderer, names), image_and_gradients(fresh, names)):
        assert torch.equal(found, expected)


def write(name: str, change):
    """A change of a parameter under `torch.no_grad`."""
    def apply(scene: rb.Scene) -> None:
        with torch.no_grad():
            change(scene.get_parameter(name))
    return apply


def step(name: str, optimiser: type[torch.optim.Optimizer], **settings):
    """A step of an optimiser."""
    def apply(scene: rb.Scene) -> None:
        parameter = scene.get_parameter(name)
        parameter.grad = 1e-2 * torch.ones_like(parameter)
        optimiser([parameter.requires_grad_()], lr=0.1, **settings).step()
        parameter.requires_grad_(False).grad = None
    return apply


def load_state(scene: rb.Scene) -> None:
    scene.load_state_dict({name: value * (0.9 if "vertex_positions" in name else 1.0)
                           for name, value in scene.state_dict().items()})


def swap(tensor: torch.Tensor) -> None:
    """Exchanges two rows, which keeps all sums."""
    tensor[[3, 7]] = tensor[[7, 3]]


CHANGES = {
    "in place": write("hills.vertex_positions", lambda p: p.mul_(0.9)),
    "two vertices exchanged": write("hills.vertex_positions", swap),
    "one bit": write("hills.vertex_positions", lambda p: p.view(torch.int64)[5, 2].add_(1 << 45)),
    "through data": write("hills.vertex_positions", lambda p: p.data[3].add_(0.1)),
    "data replaced": write("hills.vertex_positions", lambda p: setattr(p, "data", 0.9 * p.data)),
    "through numpy": write("hills.vertex_positions", lambda p: p.detach().numpy().__setitem__((3, 2), 0.4)),
    "texels through numpy": write("hills.bsdf.reflectance.data", lambda p: p.detach().numpy().__setitem__((1, 2), 0.9)),
    "sky through data": write("sky.data", lambda p: p.data[1, 2].mul_(20)),
    "scale of the sky": write("sky.scale", lambda p: p.data.mul_(2)),
    "pose of the sky": write("sky.to_world", lambda p: p.copy_(p[[1, 2, 0, 3]])),
    "spot": write("spot.to_world", lambda p: p.data[0, 3].add_(0.2)),
    "image of the spot": write("spot.texture.data", lambda p: p.data.mul_(0.5)),
    "roughness": write("ball.bsdf.alpha.value", lambda p: p.data.mul_(0.5)),
    "pose of the ball": write("ball.to_world", lambda p: p.data[:3, :3].mul_(-1.5)),
    "pose of the lamp": write("lamp.to_world", lambda p: p.data[:3, :2].mul_(2)),
    "camera": write("camera.to_world", lambda p: p.data[0, 3].add_(0.1)),
    "view": write("camera.x_fov", lambda p: p.data.mul_(0.7)),
    "step of SGD": step("hills.vertex_positions", torch.optim.SGD),
    "step of Adam, fused": step("hills.vertex_positions", torch.optim.Adam, fused=True),
    "load_state_dict": load_state,
    "parametrize": lambda scene: parametrize.register_parametrization(scene.hills, "vertex_positions", Half()),
    "faces": lambda scene: scene.hills.faces.data[0].copy_(scene.hills.faces[9]),
    "normals turned": lambda scene: setattr(scene.lamp, "flip_normals", True),
    "smooth": lambda scene: setattr(scene.hills, "recompute_normals", True),
    "weight of a light": lambda scene: setattr(scene.spot, "sampling_weight", 5.0),
    "far plane": lambda scene: setattr(scene.camera, "far_clip", 2.0),
    "shape removed": lambda scene: scene._modules.pop("ball"),
    "texture exchanged": lambda scene: setattr(scene.hills.bsdf, "reflectance", scene.ball.bsdf.specular_reflectance),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_what_has_changed_is_seen(change):
    scene = scene_of()
    renderer = rb.Renderer(scene, **SETTINGS)
    before = renderer(seed=3)
    assert torch.equal(renderer(seed=3), before)
    change(scene)
    found = renderer(seed=3)
    assert not torch.equal(found, before) and torch.equal(found, rb.Renderer(scene, **SETTINGS)(seed=3))
    assert_nothing_is_stale(renderer, "lamp.emitter.radiance.value", "sky.scale")


TABLES = {"mesh": ["hills.vertex_positions"], "camera and ball": ["camera.to_world", "ball.to_world"],
          "materials and spot": ["hills.bsdf.reflectance.data", "ball.bsdf.alpha.value", "spot.intensity.value"],
          "sky and lamp": ["sky.data", "sky.to_world", "lamp.to_world"]}


@pytest.mark.parametrize("names", [*TABLES.values(), *(deep([name]) for names in TABLES.values() for name in names
                                                       if len(names) > 1)], ids="-".join)
@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
def test_gradients_are_the_same_with_tables_taken_over(names):
    renderer = unwarned_renderer(scene_of(), **SETTINGS)
    renderer()
    for _ in range(2):
        assert_nothing_is_stale(renderer, *names)
        for name in names:
            write(name, lambda p: (p[:3] if len(p.shape) else p).mul_(0.99))(renderer.scene)
        renderer.scene.get_parameter("hills.vertex_positions").data.mul_(0.98)


def test_values_handed_over_hold_for_one_call():
    scene = scene_of()
    renderer = rb.Renderer(scene, **SETTINGS)
    before = renderer(seed=3)
    for factor in (0.9, 0.8, 0.9):
        moved = {"scene.hills.vertex_positions": factor * scene.hills.vertex_positions, "scene.sky.data": 2 * scene.sky.data}
        image = functional_call(renderer, moved, kwargs={"seed": 3})
        assert torch.equal(image, functional_call(rb.Renderer(scene, **SETTINGS), moved, kwargs={"seed": 3}))
        assert torch.equal(renderer(seed=3), before)


@pytest.mark.parametrize("settings", [{"compile": False, "terms": ["interior"]}, deep({})], ids=str)
@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
def test_tangents_and_gradients_may_alternate(settings):
    scene = scene_of(torch.float32)
    renderer = unwarned_renderer(scene, **SETTINGS, **settings)
    name = "hills.vertex_positions"
    tangent = torch.ones_like(scene.get_parameter(name))

    def derivative(renderer: rb.Renderer) -> torch.Tensor:
        return torch.func.jvp(lambda x: functional_call(renderer, {f"scene.{name}": x}, kwargs={"seed": 3}),
                              (scene.get_parameter(name).detach(),), (tangent,))[1]

    expected = derivative(unwarned_renderer(scene, **SETTINGS, **settings))
    assert torch.equal(derivative(renderer), expected)
    assert_nothing_is_stale(renderer, name, **settings)
    assert torch.equal(derivative(renderer), expected)


def test_a_change_of_a_colour_makes_no_table_of_anything_else(monkeypatch):
    made = []
    for module, name in ((Mesh, "triangles"), (geometry, "normals_and_clearances"), (light_table, "alias_table"),
                         (envmap, "grid_distribution")):
        function = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *arguments, f=function, name=name: made.append(name) or f(*arguments))
    scene = scene_of()
    renderer = rb.Renderer(scene, **SETTINGS)
    renderer()
    assert set(made) == {"triangles", "normals_and_clearances", "alias_table", "grid_distribution"}
    made.clear()
    colour = scene.get_parameter("lamp.emitter.radiance.value").requires_grad_()
    for _ in range(2):
        renderer().sum().backward()
        with torch.no_grad():
            colour.mul_(0.9)
    assert made == []


def taken_over(new, old) -> bool:
    """True if a record consists of the tensors of another one."""
    return all(a is b for a, b in zip(tree_flatten(new)[0], tree_flatten(old)[0], strict=True))


def test_tables_are_the_same_objects_until_something_changes():
    scene, kept = scene_of(), PackCache()
    first = pack(scene, kept)
    second = pack(scene, kept := PackCache(kept.close()))
    for table in ("triangles", "lights", "textures", "radiance"):
        assert taken_over(getattr(second, table), getattr(first, table)), table
    scene.get_parameter("hills.bsdf.reflectance.data").data[0, 0] = 0.5
    third = pack(scene, kept := PackCache(kept.close()))
    assert taken_over((third.triangles, third.lights, third.radiance), (first.triangles, first.lights, first.radiance))
    assert not taken_over(third.textures, first.textures)
    scene.get_parameter("hills.vertex_positions").data[0, 0] += 0.5
    fourth = pack(scene, PackCache(kept.close()))
    assert not taken_over(fourth.triangles.vertices.p, first.triangles.vertices.p)
    assert taken_over((fourth.triangles.corners, fourth.textures), (first.triangles.corners, third.textures))


def test_of_attached_geometry_what_is_detached_is_made_again_only_if_it_moves():
    scene, kept = scene_of(), PackCache()
    positions = scene.get_parameter("hills.vertex_positions").requires_grad_()
    first = pack(scene, kept)
    second = pack(scene, kept := PackCache(kept.close()))
    assert second.triangles.vertices.p is not first.triangles.vertices.p and second.triangles.vertices.p.x.requires_grad
    assert second.triangles.n is first.triangles.n and second.triangles.corners is first.triangles.corners
    assert not second.triangles.n.x.requires_grad
    with torch.no_grad():
        positions.mul_(0.9)
    third = pack(scene, PackCache(kept.close())).triangles
    assert third.n is not first.triangles.n and third.corners is first.triangles.corners


def test_a_graph_keeps_the_tables_that_its_image_shows():
    scene = scene_of()
    names = ("hills.bsdf.reflectance.data", "lamp.emitter.radiance.value")
    expected = image_and_gradients(rb.Renderer(scene, **SETTINGS), names)
    renderer = rb.Renderer(scene, **SETTINGS)
    wanted = [scene.get_parameter(name).requires_grad_() for name in names]
    image = renderer(seed=3)
    with torch.no_grad():
        for name in (*names, "hills.vertex_positions", "sky.data"):
            scene.get_parameter(name).mul_(0.8)
    renderer(seed=3)
    found = torch.autograd.grad(image.square().sum(), wanted)
    assert all(torch.equal(a, b) for a, b in zip(found, expected[1:]))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda renderer: pickle.loads(pickle.dumps(renderer))],
                         ids=["deepcopy", "pickle"])
def test_a_copy_starts_anew_and_is_independent(copied):
    renderer = rb.Renderer(scene_of(), **SETTINGS)
    before = renderer(seed=3)
    other = copied(renderer)
    assert not other.cache.results and not other.cache.copies
    assert torch.equal(other(seed=3), before)
    other.scene.get_parameter("hills.vertex_positions").data.mul_(0.9)
    assert_nothing_is_stale(other)
    assert torch.equal(renderer(seed=3), before)


def test_tables_made_in_inference_mode_serve_gradients():
    renderer = rb.Renderer(scene_of(), **SETTINGS)
    with torch.inference_mode():
        renderer()
    assert_nothing_is_stale(renderer, "lamp.emitter.radiance.value", "hills.bsdf.reflectance.data")


def size_of(cache: PackCache) -> int:
    """How many things a cache holds, those of parts included."""
    own = len(cache.results) + len(cache.copies) + len(cache.twins) + len(cache.inventories) + len(cache.parts)
    return own + sum(size_of(part.cache) for part in cache.parts.values())


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
def test_what_is_no_longer_there_is_let_go():
    scene = scene_of()
    renderer = rb.Renderer(scene, **SETTINGS)
    renderer()
    gone = [weakref.ref(value) for value in renderer.cache.copies.values() if len(value.shape) and len(value) > 3000]
    gone += [weakref.ref(result.value.vertices) for result in renderer.cache.parts[PLACED].cache.results.values()
             if isinstance(result.value, Triangles) and len(result.value.vertices) > 3000]
    assert len(gone) > 4  # the ball's
    del scene._modules["ball"]
    renderer()
    gc.collect()
    assert all(reference() is None for reference in gone)
    sizes = []
    for _ in range(4):
        write("hills.vertex_positions", lambda p: p.mul_(0.9))(scene)
        renderer()
        sizes.append(size_of(renderer.cache))
    assert sizes[0] > 20 and sizes[1:] == sizes[:1] * 3


class Striped(Texture):
    """A texture that depends on what cannot be compared."""

    wrap_mode, filter_type = "repeat", "nearest"

    def __init__(self):
        super().__init__()
        self.stripes = [0.2, 0.7]

    def texels(self) -> torch.Tensor:
        return torch.tensor(self.stripes, dtype=torch.float64)[:, None, None].expand(-1, 1, 3)


def test_what_cannot_be_compared_is_made_anew():
    scene = scene_of(wall=rectangle((0, 0, -1), 4, bsdf={"type": "diffuse", "reflectance": Striped()}))
    renderer = rb.Renderer(scene, **SETTINGS)
    before = renderer(seed=3)
    scene.wall.bsdf.reflectance.stripes[0] = 0.9
    assert not torch.equal(renderer(seed=3), before)
    assert_nothing_is_stale(renderer)


def names_of(root: nn.Module) -> list[str]:
    return [f"{prefix}.{name}" for prefix, module in root.named_modules() for name in module._parameters]


def test_what_follows_from_attributes_is_made_again_only_when_one_is_another_object():
    scene, kept = scene_of(), PackCache()

    def taken_over_after(change=lambda: None) -> bool:
        nonlocal kept
        before = kept.structure(names_of, scene)
        kept = PackCache(kept.close())
        change()
        return kept.structure(names_of, scene) is before

    ball = scene.ball
    assert taken_over_after() and taken_over_after(lambda: ball.to_world.data.mul_(0.9))
    assert not taken_over_after(lambda: setattr(scene.lamp, "flip_normals", True))
    assert not taken_over_after(scene.lamp.to_world.requires_grad_)
    assert taken_over_after(lambda: setattr(scene.camera, "far_clip", 3.0))  # a root of its own
    assert not taken_over_after(lambda: scene._modules.pop("ball"))
    assert "ball.to_world" not in kept.structure(names_of, scene)
    assert not taken_over_after(lambda: setattr(scene, "ball", ball)) and taken_over_after()
    scene.hills.bsdf.reflectance = Striped()  # holds a list
    assert not taken_over_after() and not taken_over_after()


def test_twins_are_the_same_objects_until_something_in_them_changes():
    scene, kept = scene_of(), PackCache()
    camera = scene.camera

    def taken_over_after(change=lambda: None) -> bool:
        nonlocal kept
        before = kept.twin("camera", camera)
        kept = PackCache(kept.close())
        change()
        return kept.twin("camera", camera) is before

    assert taken_over_after() and taken_over_after()
    assert taken_over_after(lambda: setattr(camera, "x_fov", nn.Parameter(camera.x_fov.clone(), requires_grad=False)))
    for change in (lambda: camera.x_fov.data.mul_(0.5), lambda: setattr(camera, "far_clip", 7.0),
                   lambda: setattr(camera.film, "width", 99), lambda: setattr(camera.film.rfilter, "radius", 0.7),
                   lambda: setattr(camera, "film", copy.deepcopy(scene_of().camera.film)), camera.x_fov.requires_grad_):
        assert not taken_over_after(change)
    assert not taken_over_after()  # it is differentiated
    camera.x_fov.requires_grad_(False)
    assert taken_over_after()


def test_a_result_is_taken_over_only_for_arguments_that_stand_still():
    made = []

    def make(*arguments) -> torch.Tensor:
        made.append(arguments)
        return torch.ones(2)

    live, kept = torch.zeros(2), PackCache()
    for arguments in ((1,), (True,), (1.0,), (0.0,), (-0.0,), ("a", (1, 2)), (torch.float32,)):
        assert kept(make, *arguments) is kept(make, *arguments)
    assert len(made) == 7
    for arguments in ((live,), ([1],), (1, (live,)), (object(),)):
        assert kept(make, *arguments) is not kept(make, *arguments)
    frozen = kept.frozen("place", live)
    first = kept(make, frozen)
    following = PackCache(kept.close())
    assert following.frozen("place", live.clone()) is frozen and following(make, frozen) is first
    live.data[1] = 1.0
    changed = PackCache(following.close())
    assert changed.frozen("place", live) is not frozen and changed(make, changed.frozen("place", live)) is not first
