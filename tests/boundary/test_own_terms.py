"""Boundary terms of one's own, of shadows and of what the camera sees; nothing outside of this file knows them."""

from __future__ import annotations

import warnings

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.boundary.closed_forms import DARK, GLOW, JUMP, SIZE, along, assert_close, derivative, parallel
from tests.scenes import load, rectangle
from torch_radbp.boundary.curve.edge_places import edge_place, edge_weight
from torch_radbp.boundary.curve.film_term import FILM_TERMS, CurvesInView, ExaminedView, FilmTerm, film_term, lines_in_view
from torch_radbp.boundary.curve.geometry import Geometry
from torch_radbp.boundary.curve.outline import Jumps
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.terms.shadow_term import SHADOW_TERMS, CutOff, ShadowTerm, TermSize, shadow_term
from torch_radbp.call.render_call import RenderCall
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec2

COLUMN, ROW, STRENGTH = 5, 3, (2.0, 3.0, 4.0)


class LineOfLight(ShadowTerm):
    """Light that ends at one place of the film, which moves to the right as the first vertex of the scene does."""

    rank = 99

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        return TermSize(found=1, kept=1)

    def applies(self) -> bool:
        return True

    def samples(self, number: int) -> CutOff:
        one = torch.ones(1, dtype=torch.float64)
        strength = torch.tensor(STRENGTH, dtype=torch.float64)[:, None]
        return CutOff(Vec2((COLUMN + 0.5) * one, (ROW + 0.5) * one), Vec2(one, 0.0 * one), strength, None)

    def seen(self, number: int, geometry: Geometry, found: CutOff) -> Vec2:
        x = lookup(geometry.triangles.vertices.p.x, torch.zeros(1, dtype=torch.int32)).double()
        return Vec2(x, 0.0 * x)

    def left_out(self, rendering: Rendering) -> set[str]:
        return {"sheet.to_world"}


@pytest.fixture
def line_of_light():
    shadow_term(LineOfLight)
    yield
    SHADOW_TERMS.remove(LineOfLight)


def sheet() -> rb.Scene:
    """A sheet that fills the view: no edge is seen, and no shadow."""
    return load(torch.float64, camera=parallel(), sky=DARK, sheet=rectangle((0, 0, 0), 9, **GLOW))


def image_of_motion() -> Tensor:
    """The derivative of the image by a motion to the right that `LineOfLight` says."""
    expected = torch.zeros(3, SIZE, SIZE, dtype=torch.float64)
    expected[:, ROW, COLUMN] = torch.tensor(STRENGTH)
    return expected


@pytest.mark.parametrize("settings", [{}, {"compile": False}, {"adjoint": rb.TapeAdjoint()}], ids=str)
def test_a_term_of_shadows_is_one_class(line_of_light, settings):
    scene, weights = sheet(), torch.rand(3, SIZE, SIZE, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    pose = scene.get_parameter("sheet.to_world").requires_grad_()
    renderer = rb.Renderer(scene, spp=1, max_depth=2, terms=["shadow"], **settings)
    image = renderer(seed=1)
    found, = torch.autograd.grad((image * weights).sum(), pose)
    assert float(found[0, 3]) == pytest.approx(float((image_of_motion() * weights).sum()), rel=1e-12)
    scene.requires_grad_(False)
    motion = rb.jvp(scene, {"sheet.to_world": along(0)}, spp=1, max_depth=2, terms=["shadow"], seed=1)
    torch.testing.assert_close(motion[0], image_of_motion(), rtol=1e-12, atol=0.0)


def test_a_term_of_shadows_that_is_off_says_what_it_leaves_out(line_of_light):
    messages = []
    for terms in (["interior", "primary"], ["interior", "primary", "shadow"]):
        scene = sheet()
        scene.get_parameter("sheet.to_world").requires_grad_()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            rb.Renderer(scene, spp=1, max_depth=2, terms=terms)(seed=1)
        messages.append([str(warning.message) for warning in caught])
    (message,), nothing = messages
    assert "`sheet.to_world` lack the contribution of the borders of shadows" in message and nothing == []


class EdgesOnceMore(FilmTerm):
    """All edges, which another term has already."""

    rank = 99

    def in_view(self, viewed: ExaminedView, jumps: Jumps) -> list[CurvesInView]:
        return lines_in_view(viewed, jumps.outline, edge_weight, edge_place)


def test_a_term_of_what_the_camera_sees_is_one_class():
    """A square before the dark that moves to the right: light is gained at one side of it, and lost at the other one."""
    weights = torch.linspace(0.0, 1.0, SIZE, dtype=torch.float64).expand(SIZE, SIZE)
    scene = load(torch.float64, camera=parallel(), sky=DARK, square=rectangle((0, 0, 0), 0.5, **GLOW))
    once = derivative(scene, "square.to_world", along(0), weights, spp=1024)
    assert abs(float(once.sum())) > 0.1 * float(JUMP.abs().sum())
    film_term(EdgesOnceMore)
    try:
        assert_close(derivative(scene, "square.to_world", along(0), weights, spp=1024), 2 * once, 0.02)
    finally:
        FILM_TERMS[:] = [term for term in FILM_TERMS if not isinstance(term, EdgesOnceMore)]
