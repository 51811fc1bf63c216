"""What only the ray caster of GPUs has to hold, on Warp's CPU device; the rest is asked of all casters alike."""

import importlib
import subprocess
import sys

import pytest
import torch

import torch_radbp as rb
from tests.raycast.meshes import mesh, random_rays
from torch_radbp.raycast import Ray, make_caster
from torch_radbp.scene.packing.pack import pack
from torch_radbp.tensors.vec import Vec3

warp = pytest.importorskip("warp")
module_of_caster = importlib.import_module("torch_radbp.raycast.warp")
warp_few = importlib.import_module("torch_radbp.raycast.warp_few")


def turned_box(offset: float) -> tuple[torch.Tensor, torch.Tensor]:
    """A box of parallelograms, turned, with three triangles in it, one of them without area."""
    vertices, faces = mesh("box")
    inner = torch.tensor([[0.5, 0.1, 0.2], [-0.4, 0.3, 0.1], [0.1, -0.5, -0.3], [-0.2, -0.1, 0.6], [0.3, 0.0, 0.4]])
    own = torch.tensor([[0, 1, 2], [2, 3, 4], [3, 3, 1]], dtype=torch.int32) + len(vertices)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(4))).Q
    return torch.cat([vertices, inner]) @ turn.T + offset, torch.cat([faces, own])


@pytest.mark.parametrize("offset, most", [(0.0, 2e-6), (100.0, 2e-4)])
def test_of_few_faces_every_one_is_tried(offset, most):
    """Parallelograms, triangles and one without area: the hits and shadows of brute force, but at edges."""
    vertices, faces = turned_box(offset)
    ray = random_rays(50_000, within=0.55)
    ray = ray._replace(o=ray.o.map(lambda x: x + offset))
    few, brute = (make_caster(name, vertices, faces) for name in ("warp", "brute"))
    merged = few._head[3] < len(faces)  # far away corners are rounded too much for that
    assert few.recorded_as[-1] == "closest_of_few" and merged == (offset == 0.0)
    found, expected = few.intersect(ray), brute.intersect(ray)
    same = found.prim == expected.prim
    assert same.float().mean() > 0.999 and set(found.prim.tolist()) == set(range(len(faces) - 1))
    for column in ("u", "v", "t"):
        off = (getattr(found, column) - getattr(expected, column))[same].abs()
        assert off.median() < most and off.max() < 1000 * most  # of rays along a triangle
    tmax = torch.rand(50_000, generator=torch.Generator().manual_seed(1)) * 2
    hidden, wanted = few.occluded(ray, tmax), brute.occluded(ray, tmax)
    assert 0.1 < wanted.float().mean() < 0.9 and (hidden != wanted).float().mean() < 1e-4
    assert bool((expected.prim >= 0).all() and (found.prim >= 0).all())  # nobody gets out


def test_many_faces_have_a_tree(monkeypatch):
    vertices, faces = turned_box(0.0)
    monkeypatch.setattr(warp_few, "FEW", 7)
    assert make_caster("warp", vertices, faces).recorded_as[-1] == "closest_hit"


@pytest.mark.parametrize("offset", [0.0, 1000.0])
@pytest.mark.parametrize("constructed, few", [("box", 0), ("box", 6), ("fine sphere", 0)])
def test_no_ray_towards_an_edge_passes_between_boxes_of_the_tree_or_faces(constructed, few, offset, monkeypatch):
    """By Warp's own tree 853 of 200,000 get out of the box."""
    monkeypatch.setattr(warp_few, "FEW", few)
    vertices, faces = mesh(constructed)
    generator = torch.Generator().manual_seed(0)
    face = faces[torch.randint(len(faces), (200_000,), generator=generator)].long()
    share = torch.rand(len(face), 1, generator=generator)
    o = 0.8 * (torch.rand(len(face), 3, generator=generator) - 0.5) + offset
    vertices = vertices + offset
    target = vertices[face[:, 0]] * share + vertices[face[:, 1]] * (1 - share)
    tracer = make_caster("warp", vertices, faces)
    assert (tracer.recorded_as[-1] == "closest_of_few") == bool(few)
    ray = Ray(Vec3.of(o), Vec3.of(target - o))
    assert bool((tracer.intersect(ray).prim >= 0).all())
    assert bool(tracer.occluded(ray, torch.full((len(face),), torch.inf)).all())


def test_instances_and_spheres_are_cast_as_their_triangles():
    """Thirty places of a group, some of them mirrored, beside a tessellated sphere: the triangles that Embree names."""
    generator = torch.Generator().manual_seed(6)
    poses = torch.eye(4).repeat(30, 1, 1)
    poses[:, :3, :3] = 0.3 * torch.linalg.qr(torch.randn(30, 3, 3, generator=generator)).Q
    poses[:, :3, 3] = 3 * torch.rand(30, 3, generator=generator) - 1.5
    group = {"type": "shapegroup", "cube": {"type": "cube"}, "floor": {"type": "rectangle"}}
    scene = rb.load_dict({
        "type": "scene", "sensor": {"type": "perspective"}, "sky": {"type": "constant"}, "things": group,
        "ball": {"type": "sphere", "radius": 0.5},
        **{f"place_{k}": {"type": "instance", "group": {"type": "ref", "id": "things"}, "to_world": pose}
           for k, pose in enumerate(poses)}})
    triangles = pack(scene).triangles
    stacked = triangles.vertices.p.stack(), torch.stack(triangles.corners, 1)
    ray = random_rays(20_000, within=1.5)
    embree, warp = (make_caster(name, *stacked) for name in ("embree", "warp"))
    expected, hit = embree.intersect(ray), warp.intersect(ray)
    assert (expected.prim >= 0).float().mean() > 0.3
    assert (hit.prim != expected.prim).float().mean() < 1e-3  # at edges
    hidden = [caster.occluded(ray, torch.full((20_000,), 0.8)) for caster in (embree, warp)]
    assert 0.1 < hidden[0].float().mean() < 0.9
    assert (hidden[0] != hidden[1]).float().mean() < 1e-3


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_image_and_its_gradient_are_those_by_embree(dtype):
    scene = rb.load_dict({
        "type": "scene", "sky": {"type": "constant"},
        "sensor": {"type": "perspective", "fov": 60.0, "film": {"type": "hdrfilm", "width": 24, "height": 24}},
        "cube": {"type": "cube", "to_world": rb.look_at((0.3, 0.2, 5.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
                 "bsdf": {"type": "diffuse"}},
        "floor": {"type": "rectangle", "to_world": torch.diag(torch.tensor([9.0, 9.0, 9.0, 1.0]))}}).to(dtype)
    colour = scene.get_parameter("cube.bsdf.reflectance.value").requires_grad_()
    images, gradients = [], []
    for name in ("embree", "warp"):
        renderer = rb.Renderer(scene, spp=16, max_depth=4, caster=name)
        images.append(renderer(seed=3))
        gradients.append(torch.autograd.grad(images[-1].square().sum(), colour)[0])
        assert type(renderer.last_caster).__name__.lower() == name
    assert images[0].detach().std() > 0.05 and float(gradients[0].abs().min()) > 1.0
    assert ((images[0] - images[1]).abs().amax(1) > 1e-5).float().mean() < 0.01  # pixels with a path that meets an edge
    torch.testing.assert_close(*gradients, rtol=1e-3, atol=0)


def test_geometry_that_stays_keeps_its_tree_and_geometry_that_moves_gets_one():
    scene = rb.load_dict({"type": "scene", "sky": {"type": "constant"}, "sensor": {"type": "perspective"},
                          "cube": {"type": "cube"}})
    renderer = rb.Renderer(scene, spp=1, max_depth=2, caster="warp")
    renderer(seed=0)
    first = renderer.last_caster
    renderer(seed=1)
    assert renderer.last_caster is first
    with torch.no_grad():
        scene.cube.to_world[2, 3] += 1.0
    renderer(seed=0)
    assert renderer.last_caster is not first
    ray = random_rays(100)
    assert not torch.equal(first.intersect(ray).t, renderer.last_caster.intersect(ray).t)


@pytest.mark.parametrize("name", ["warp", "warp_few", "warp_instances"])
def test_kernels_are_compiled_for_gpus(name, tmp_path):
    """By NVIDIA's compiler, which Warp brings along, and which needs no GPU."""
    module = importlib.import_module(f"torch_radbp.raycast.{name}")
    try:
        with module_of_caster.silent():
            file, = warp.compile_aot_module(module, arch=90, module_dir=tmp_path, use_ptx=True)
    except RuntimeError as error:
        pytest.skip(f"Warp has no compiler for GPUs here: {error}")
    assert file.read_text().count(".entry") == 2


def test_many_casters_come_and_go():
    """Trees are freed with their casters: the process does not grow."""
    resource = pytest.importorskip("resource")
    vertices, faces = mesh("fine sphere")
    before = 0
    for number in range(40):
        make_caster("warp", vertices, faces)
        if number == 10:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert growth < 8 << 10  # KiB; 29 trees and their points take 25 MiB


def test_a_device_that_warp_does_not_know_is_named():
    vertices, faces = (tensor.to("meta") for tensor in mesh("box"))
    for name in ("warp", None):
        with pytest.raises(ValueError, match="'warp' works on CUDA and on the CPU, got vertices on meta.*use 'brute'"):
            make_caster(name, vertices, faces)


def test_what_to_install_is_said(monkeypatch):
    monkeypatch.delitem(sys.modules, "torch_radbp.raycast.warp", raising=False)
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(ModuleNotFoundError, match="pip install 'warp-lang>=1.19'"):
        make_caster("warp", *mesh("box"))


def test_warp_prints_nothing():
    program = """
import torch
from torch_radbp.raycast import make_caster
make_caster("warp", torch.eye(3), torch.tensor([[0, 1, 2]]))
"""
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert said.stdout == ""
