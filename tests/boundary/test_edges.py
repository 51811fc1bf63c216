"""Edges that warnings are about: those of large meshes, of tiny ones; none are looked at before somebody could want it."""

import warnings

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from torch_radbp.boundary.terms import jump_watch as warning
from torch_radbp.boundary.terms.jump_watch import SilhouetteWarning
from torch_radbp.io.values.transform import scale, translate
from torch_radbp.shape.surface import grid

SKY = {"type": "constant"}
DIVISIONS = 40


def sheet(half: float = 1.0, loose: bool = False) -> dict:
    """A wavy square of 3200 triangles, if `loose` with vertices of their own."""
    uv, faces = grid(DIVISIONS, DIVISIONS)
    x, y = (half * (2 * uv - 1)).unbind(1)
    vertices = torch.stack([x, y, 0.02 * torch.sin(3 * x + 2 * y)], 1)
    if loose:
        vertices, faces = vertices[faces].reshape(-1, 3), torch.arange(3 * len(faces)).reshape(-1, 3)
    return {"type": "mesh", "vertex_positions": vertices, "faces": faces, "bsdf": diffuse(0.5)}


def messages(scene: rb.Scene, *names: str) -> list[str]:
    for name in names:
        scene.get_parameter(name).requires_grad_()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rb.render(scene, spp=1, max_depth=2, terms=["interior"])
    return [str(warning.message) for warning in caught if issubclass(warning.category, SilhouetteWarning)]


@pytest.mark.parametrize("loose", [False, True])
@pytest.mark.parametrize("name", ["sheet.vertex_positions", "camera.to_world"])
def test_the_rim_of_a_large_mesh_is_found_and_its_inside_has_none(name, loose):
    assert messages(load(camera=sensor(4), sky=SKY, sheet=sheet(0.8, loose)), name)
    assert not messages(load(camera=sensor(4), sky=SKY, sheet=sheet(3.0, loose)), name)


def test_a_small_shape_beside_a_large_one_is_looked_at():
    small = {"type": "cube", "to_world": translate((0.3, 0.2, 0.5)) @ scale((0.1, 0.1, 0.1))}
    message, = messages(load(camera=sensor(4), sky=SKY, sheet=sheet(3.0), small=small), "camera.to_world")
    assert "6 edges" in message
    aside = {"type": "cube", "to_world": translate((-2.2, 0.1, 1)) @ scale((0.2, 0.2, 0.2))}  # whose shadow is in view
    lamp = {"type": "point", "position": [-4.4, 0.2, 3], "intensity": rgb(9, 7, 5)}
    message, = messages(load(camera=sensor(4, fov=30), sheet={**sheet(9.0), "to_world": translate((0, 0, -1))}, aside=aside,
                             point=lamp), "point.position")
    assert "`point.position`" in message and "borders of shadows" in message


def test_a_tiny_shape_in_a_huge_scene_has_edges():
    tiny = {"type": "cube", "to_world": translate((3e-3, 2e-3, 0)) @ scale((1e-3, 1e-3, 1e-3))}
    message, = messages(load(camera=sensor(4, (0, 0, 0.03)), sky=SKY, sheet=sheet(3000.0), tiny=tiny), "tiny.to_world")
    assert "6 edges" in message


def test_nothing_is_looked_for_unless_something_moves(monkeypatch):
    def refuse(*arguments):
        raise AssertionError("edges or lights are looked at for nothing")

    monkeypatch.setattr(warning, "silhouettes_left_out", refuse)
    monkeypatch.setattr(warning, "shadows_left_out", refuse)
    monkeypatch.setattr(warning, "flat", refuse)
    lamp = rectangle((0, 0, 3), 0.3, (1, 0, 0), 180, emitter={"type": "area", "radiance": rgb(9, 7, 5)})
    scene = load(camera=sensor(4), lamp=lamp, sheet=sheet(), mirror={"type": "sphere", "bsdf": {"type": "conductor"}})
    assert messages(scene, "sheet.bsdf.reflectance.value", "lamp.emitter.radiance.value") == []
    scene.requires_grad_()
    with torch.no_grad():
        assert messages(scene) == []
    with pytest.raises(AssertionError, match="for nothing"):
        messages(scene)


def test_a_plane_is_flat_however_it_lies_and_a_slight_bend_is_not():
    generator = np.random.default_rng(0)
    plane = torch.from_numpy(generator.uniform(-1, 1, (1000, 2)) @ generator.uniform(-1, 1, (2, 3)) + 5.0)
    assert warning.flat(plane) and warning.flat(plane.float().double() * 1e-3)
    assert not warning.flat(plane + 1e-4 * torch.from_numpy(generator.standard_normal((1000, 3))))
