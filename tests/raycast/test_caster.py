"""The caster as an object: what it accepts, counts and copies, and that it never changes."""

import copy
import gc
import math
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from tests.raycast.casters import CASTERS, WARP
from tests.raycast.meshes import mesh, random_rays, single_ray, soup
from torch_radbp.raycast import FEW_TESTS, Ray, library, make_caster, tree
from torch_radbp.raycast.brute import Brute
from torch_radbp.raycast.direct import DirectCaster
from torch_radbp.raycast.embree import Embree
from torch_radbp.raycast.runs import MOST_TRIANGLES
from torch_radbp.tensors.vec import Vec3

pytestmark = pytest.mark.usefixtures("threads")  # with one and with two

TRIANGLE = torch.tensor([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
FACE = torch.tensor([[0, 1, 2]])
TREES = ("embree", WARP)
DOWN = single_ray((0.0, 0.0, 3.0), (0.0, 0.0, -1.0))


def test_casters_are_chosen_by_name():
    assert isinstance(make_caster("embree", TRIANGLE, FACE), Embree)
    assert isinstance(make_caster("brute", TRIANGLE, FACE), Brute)
    assert isinstance(make_caster("direct", TRIANGLE, FACE), DirectCaster)


def test_meshes_that_batches_of_rays_find_quickly_have_no_tree():
    """Compact things may be many; scattered triangles, large ones, are few; and a thousand are the most."""
    def chosen(vertices, faces):
        caster = make_caster(None, vertices, faces)
        cost = DirectCaster(vertices, faces).cost if len(faces) <= MOST_TRIANGLES else math.inf
        assert isinstance(caster, DirectCaster if cost <= FEW_TESTS else Embree)
        return type(caster)

    box, triangles = mesh("box")
    generator = torch.Generator().manual_seed(1)

    def boxes(count: int):
        places = 20 * torch.rand(count, 1, 3, generator=generator)
        numbers = len(box) * torch.arange(count)[:, None, None]
        return (places + 0.5 * box).reshape(-1, 3), (triangles + numbers).reshape(-1, 3)

    assert chosen(TRIANGLE, FACE) is DirectCaster
    assert chosen(*boxes(MOST_TRIANGLES // len(triangles))) is DirectCaster
    assert chosen(*boxes(MOST_TRIANGLES // len(triangles) + 1)) is Embree
    assert chosen(*soup(100)) is DirectCaster
    assert chosen(*soup(1000)) is Embree


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(ValueError, match="unknown ray caster 'optix'; known are 'embree', 'direct', 'brute', 'warp'"):
        make_caster("optix", TRIANGLE, FACE)


@pytest.mark.parametrize("caster", CASTERS)
def test_rays_are_counted_by_lanes(caster):
    tracer = make_caster(caster, TRIANGLE, FACE)
    assert tracer.rays_cast == 0
    tracer.intersect(random_rays(10))
    tracer.occluded(random_rays(5), torch.ones(5))
    assert tracer.rays_cast == 15


@pytest.mark.parametrize("caster", CASTERS)
def test_vertices_are_copied(caster):
    vertices, faces = TRIANGLE.clone(), FACE.clone()
    tracer = make_caster(caster, vertices, faces)
    vertices += 10
    faces.fill_(0)
    assert tracer.intersect(DOWN).prim.item() == 0


@pytest.mark.parametrize("caster", TREES)
def test_trees_follow_a_moving_mesh_as_brute_force_does(caster):
    """Casters of the same mesh in several places live side by side, and each answers for its own."""
    vertices, faces = mesh("sphere")
    places = [vertices * (1 + 0.3 * torch.sin(3 * vertices.roll(1, dims=1) + step)) for step in range(4)]
    ours, reference = ([make_caster(kind, moved, faces) for moved in places] for kind in (caster, "brute"))
    ray = random_rays(2000)
    answers = [tracer.intersect(ray).prim for tracer in reference]
    for tracer, prim in zip(ours, answers):
        assert 0.2 < (prim >= 0).float().mean() < 0.99
        assert (tracer.intersect(ray).prim == prim).float().mean() > 0.999  # the rest are edges
    assert not torch.equal(answers[0], answers[1])


@pytest.mark.parametrize("caster", TREES)
def test_casters_answer_while_others_are_built_and_freed(caster):
    """In several threads at once."""
    vertices, faces = mesh("fine sphere")
    ray, expected = random_rays(3000), make_caster(caster, vertices, faces).intersect(random_rays(3000))

    def turn(number: int) -> bool:
        tracer = make_caster(caster, vertices, faces)
        return all(torch.equal(a, b) for _ in range(3) for a, b in zip(tracer.intersect(ray)[:4], expected))

    with ThreadPoolExecutor(6) as pool:
        assert all(pool.map(turn, range(24)))


@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("copied", [copy.deepcopy, copy.copy, lambda tracer: pickle.loads(pickle.dumps(tracer))])
def test_a_copy_is_independent(caster, copied):
    tracer = make_caster(caster, TRIANGLE + torch.tensor([0.0, 0.0, 1.0]), FACE)
    other = copied(tracer)
    del tracer
    gc.collect(1)  # what was made lately
    assert other.intersect(DOWN).prim.item() == 0
    assert not other.occluded(DOWN, torch.tensor([1.9])).item() and other.occluded(DOWN, torch.tensor([2.1])).item()


@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (torch.zeros(3, 8), FACE, r"vertices must have shape \(V, 3\), got \(3, 8\)"),
        (TRIANGLE.int(), FACE, "vertices must be float32 or float64, got torch.int32"),
        (TRIANGLE.half(), FACE, "vertices must be float32 or float64, got torch.float16"),
        (torch.zeros(0, 3), FACE, "got no vertices"),
        (TRIANGLE, torch.zeros(0, 3, dtype=torch.int32), "got no faces"),
        (TRIANGLE, FACE[0], r"faces must have shape \(F, 3\), got \(3,\)"),
        (TRIANGLE, FACE.float(), "faces must be integers"),
        (TRIANGLE, FACE + 1, "faces must index 3 vertices, got indices from 1 to 3"),
        (TRIANGLE, FACE - 1, "faces must index 3 vertices, got indices from -1 to 1"),
        (TRIANGLE.index_fill(0, torch.tensor([1]), torch.nan), FACE, "vertices must be finite.*vertex 1"),
        (TRIANGLE.double() * 1e300, FACE, "vertices must be finite in float32"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_refused(caster, vertices, faces, message):
    with pytest.raises(ValueError, match=message):
        make_caster(caster, vertices, faces)


@pytest.mark.parametrize("caster", CASTERS)
def test_rays_that_do_not_fit_together_are_refused(caster):
    tracer = make_caster(caster, TRIANGLE, FACE)
    o, d = random_rays(4)
    with pytest.raises(ValueError, match=r"one shape: o.x has \(4,\), d.z has \(1,\)"):
        tracer.intersect(Ray(o, Vec3(d.x, d.y, d.z[:1])))
    with pytest.raises(ValueError, match="o.x is torch.float32, d.x is torch.float64"):
        tracer.intersect(Ray(o, d.map(torch.Tensor.double)))
    with pytest.raises(ValueError, match=r"tmax has \(3,\)"):
        tracer.occluded(Ray(o, d), torch.ones(3))
    with pytest.raises(ValueError, match="is torch.float16"):
        tracer.intersect(Ray(o.map(torch.Tensor.half), d.map(torch.Tensor.half)))
    assert tracer.rays_cast == 0


def test_embree_says_what_to_install(monkeypatch):
    monkeypatch.setattr(library.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RuntimeError, match="pip install 'embreex>=4.4'"):
        library.library_path()


def test_a_large_tree_is_built_beside_its_maker(monkeypatch):
    vertices, faces = soup(2000)
    ray, expected = random_rays(500, torch.float32), Embree(vertices, faces)
    monkeypatch.setattr(tree, "LARGE", 1)
    begun, building = threading.Event(), tree.Tree.build
    monkeypatch.setattr(tree.Tree, "build", lambda self: (begun.wait(5), building(self)))
    if torch.get_num_threads() == 1:
        begun.set()  # nobody builds it beside
    found = Embree(vertices, faces)
    begun.set()
    hit, same = found.intersect(ray), expected.intersect(ray)
    assert (same.prim >= 0).any() and all(map(torch.equal, hit[:4], same[:4]))


def test_an_error_of_a_large_tree_is_raised_whenever_rays_are_cast(monkeypatch):
    def refuse(device, doing):
        if doing.startswith("building"):
            raise RuntimeError(f"Embree failed {doing}")

    monkeypatch.setattr(tree, "LARGE", 1)
    monkeypatch.setattr(library, "check_for_error", refuse)
    if torch.get_num_threads() == 1:
        with pytest.raises(RuntimeError, match="building a scene of 1 triangles"):
            Embree(TRIANGLE, FACE)
        return
    caster = Embree(TRIANGLE, FACE)
    for _ in range(2):
        with pytest.raises(RuntimeError, match="building a scene of 1 triangles"):
            caster.intersect(DOWN)


def test_an_error_of_embree_is_raised_with_its_name():
    embree, device = library.load_embree(), library.new_device()
    geometry = embree.rtcNewGeometry(device, library.GEOMETRY_TYPE_TRIANGLE)
    three_bytes = 3  # a stride must be a multiple of 4 bytes
    embree.rtcSetSharedGeometryBuffer(
        geometry, library.BUFFER_TYPE_VERTEX, 0, library.FORMAT_FLOAT3, TRIANGLE.data_ptr(), 0, three_bytes, 3
    )
    with pytest.raises(RuntimeError, match="Embree failed while testing: invalid operation .*aligned"):
        library.check_for_error(device, "testing")
    library.check_for_error(device, "testing")  # reading an error clears it
    embree.rtcReleaseGeometry(geometry)
    embree.rtcReleaseDevice(device)


def test_many_casters_come_and_go():
    """Scenes and devices are released with their casters: the process does not grow."""
    resource = pytest.importorskip("resource")
    vertices, faces = mesh("fine sphere")
    for _ in range(20):
        Embree(vertices, faces)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(100):
        Embree(vertices, faces)
    growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert growth < 8 << 10  # KiB; measured 0.1 MiB, and 37 MiB if nothing is released
