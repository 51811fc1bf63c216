"""Packing large meshes: what is packed is the same, and nothing is done triangle by triangle in Python."""

import sys

import pytest
import torch

import torch_radbp as rb
from tests.scenes import load, rgb, sensor
from tests.scenes.meshes import grid
from torch_radbp.scene.packing import geometry
from torch_radbp.scene.packing.pack import pack
from torch_radbp.shape.mesh import Mesh
from torch_radbp.shape.normals import angle_weighted_normals


def lines_of_python(function, *arguments) -> int:
    """How many lines of this package run in a call."""
    lines = 0

    def count(frame, event, argument):
        nonlocal lines
        if not frame.f_globals.get("__name__", "").startswith("torch_radbp"):
            return None
        lines += event == "line"
        return count

    sys.settrace(count)
    try:
        function(*arguments)
    finally:
        sys.settrace(None)
    return lines


def lamp(divisions: int) -> rb.Scene:
    return load(camera=sensor(2), lamp=grid(divisions, emitter={"type": "area", "radiance": rgb(1, 2, 3)}))


def test_packing_runs_no_python_for_each_triangle():
    small, large = lamp(20), lamp(40)  # of so many entries that tables lie in rows
    pack(lamp(4))  # what is made once a process
    assert lines_of_python(pack, large) == lines_of_python(pack, small)


@pytest.mark.parametrize("block", [1, 7, 31])
def test_normals_do_not_depend_on_the_size_of_blocks(block, monkeypatch):
    scene = load(camera=sensor(2), sky={"type": "constant"}, hills=grid(4), more=grid(2, 0.3))
    vertices, faces = scene.hills.vertex_positions, scene.hills.faces
    whole, smooth = pack(scene).triangles, angle_weighted_normals(vertices, faces)
    monkeypatch.setattr(geometry, "BLOCK", block)
    monkeypatch.setattr("torch_radbp.shape.normals.BLOCK", block)
    parts = pack(scene).triangles
    assert all(torch.equal(a, b) for a, b in zip((*whole.n, whole.clearance), (*parts.n, parts.clearance)))
    torch.testing.assert_close(angle_weighted_normals(vertices, faces), smooth, rtol=0, atol=1e-14)


def test_one_bent_normal_among_many_flat_ones_is_kept():
    flat = grid(40, 0.0)
    normals = torch.tensor([0.0, 0.0, 1.0]).repeat(len(flat["vertex_positions"]), 1)
    assert len(flat["faces"]) > 2 * geometry.FEW
    assert not pack(load(camera=sensor(2), sky={"type": "constant"}, a={**flat, "vertex_normals": normals})
                    ).layout.shading_normals
    for vertex in (0, 41, 871, len(normals) - 1):
        bent = normals.clone()
        bent[vertex] = torch.tensor([0.6, 0.0, 0.8])
        scene = load(camera=sensor(2), sky={"type": "constant"}, a={**flat, "vertex_normals": bent})
        assert pack(scene).layout.shading_normals


def test_a_rendering_makes_the_triangles_of_a_shape_once(monkeypatch):
    made = []
    triangles = Mesh.triangles
    monkeypatch.setattr(Mesh, "triangles", lambda shape: made.append(shape) or triangles(shape))
    scene = load(camera=sensor(2), hills=grid(4), lamp=grid(2, emitter={"type": "area", "radiance": rgb(1, 2, 3)}))
    scene.requires_grad_()
    with pytest.warns(rb.SilhouetteWarning):
        rb.render(scene, spp=1, max_depth=3, terms=["interior"])
    assert [shape.vertex_count for shape in made] == [scene.hills.vertex_count, scene.lamp.vertex_count]
