"""A boundary term of one's own: a line painted on a surface, against closed forms; nothing outside of this file knows it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.boundary.closed_forms import DARK, SIZE, along, assert_close, derivative, parallel
from tests.scenes import diffuse, load, overhead, rectangle
from torch_radbp.boundary.curve import term
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.curve.term import LinesTerm, boundary_term
from torch_radbp.call.render_call import RenderCall
from torch_radbp.interface.texture import TableReader, TexturePoint
from torch_radbp.plugin import REGISTRY, Texture, register
from torch_radbp.plugin.domain import NUMBER, Domain
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.scene.packing.attributes import textures_of
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec2, Vec3

LEFT, RIGHT = torch.tensor([3.0, 2.0, 1.0], dtype=torch.float64), torch.tensor([0.5, 0.25, 0.75], dtype=torch.float64)


@dataclass(frozen=True)
class PaintReader(TableReader):
    """Reads two colours on either side of a line. Bank: (X,), where the line is."""

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> Tensor:
        return torch.stack([texture.place.detach().to(dtype=dtype, device=device) for texture in textures])

    def read(self, bank: Tensor, row: Tensor, point: TexturePoint) -> Vec3:
        is_left = point.uv.x < lookup(bank, row)
        return Vec3(*(torch.where(is_left, left, torch.full_like(point.uv.x, right))
                      for left, right in zip(LEFT.tolist(), RIGHT.tolist())))

    def rise(self, bank: Tensor, row: Tensor, point: TexturePoint) -> Vec2:
        return Vec2(0.0 * point.uv.x, 0.0 * point.uv.x)


class PaintedLine(Texture):
    """Two colours: one where u is less than `place`, one beyond."""

    def __init__(self, *, place: float = 0.5):
        super().__init__()
        self.freeze("place", torch.tensor(float(place), dtype=torch.float64))

    def domains(self) -> dict[str, Domain]:
        return {"place": NUMBER}

    def sources(self) -> tuple[Tensor, ...]:
        return self.place,

    def texels(self) -> Tensor:
        """(1, 1, 3) the mean of both colours."""
        return (0.5 * (LEFT + RIGHT)).to(self.place).view(1, 1, 3)

    def resolution(self) -> tuple[int, int]:
        return 1, 1

    def reader(self) -> PaintReader:
        return PaintReader()


class PaintedLines(LinesTerm):
    """Where `PaintedLine` jumps: u - place is 0."""

    what = "painted lines"

    def slide(self, call: RenderCall) -> bool:
        return any(isinstance(part, PaintedLine) and part.place.requires_grad for part in call.module.modules())

    def lines(self, rendering: Rendering) -> list[tuple[JumpLines, ...]]:
        return [tuple(JumpLines(1.0, 0.0, -float(paint.place.detach()), 0, 0, -paint.place) for paint in own)
                for own in paints(rendering)]

    def sliding(self, rendering: Rendering) -> list[list[str]]:
        return [[name for paint in own for name in rendering.moving(paint, ("place",))] for own in paints(rendering)]


def paints(rendering: Rendering) -> list[list[PaintedLine]]:
    """Those of each shape."""
    return [[texture for owner in filter(None, (shape.bsdf, shape.emitter)) for _, texture in textures_of(owner)
             if isinstance(texture, PaintedLine)] for shape in rendering.shapes]


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """Term and texture are there while they are tested: other tests go over all that the package has."""
    monkeypatch.setattr(term, "TERMS", list(term.TERMS))
    monkeypatch.setattr("torch_radbp.boundary.terms.jump_watch.TERMS", term.TERMS)
    boundary_term(PaintedLines)
    register("texture", "painted_line")(PaintedLine)
    yield
    del REGISTRY["texture"]["painted_line"]


def glowing(place: float, **attributes) -> dict:
    """A painted lamp."""
    return {"emitter": {"type": "area", "radiance": {"type": "painted_line", "place": place}}} | attributes


def seen_at(x: float, weights: Tensor) -> Tensor:
    """What the sums of the weighted image gain where a line moves by one to the right that is seen at x, up and down."""
    pixel = 2 / SIZE
    return (LEFT - RIGHT) * weights[:, int((x + 1) / pixel)].sum() / pixel


WEIGHTS = torch.linspace(1.0, 2.0, SIZE, dtype=torch.float64).expand(SIZE, SIZE)
ONE = torch.ones((), dtype=torch.float64)


@pytest.mark.parametrize("settings", [{}, {"compile": False}, {"sampling": "attached"}], ids=str)
def test_a_line_seen_directly(settings):
    """A sheet 6 wide: the line moves by 6 where its place does by one, and with the sheet."""
    scene = load(torch.float64, camera=parallel(), sky=DARK, sheet=rectangle((0, 0, 0), 3, **glowing(0.54)))
    x = 6 * 0.54 - 3
    found = derivative(scene, "sheet.emitter.radiance.place", ONE, WEIGHTS, **settings)
    assert_close(found, 6 * seen_at(x, WEIGHTS))
    assert_close(derivative(scene, "sheet.to_world", along(0), WEIGHTS, **settings), seen_at(x, WEIGHTS))


@pytest.mark.parametrize("settings", [{}, {"compile": False}], ids=str)
def test_a_line_seen_in_a_mirror(settings):
    """A sheet above the camera, in a mirror below it that sends rays straight back."""
    mirror = rectangle((0, 0, 0), 9, bsdf={"type": "conductor", "material": "none"})
    scene = load(torch.float64, camera=parallel(), sky=DARK, mirror=mirror,
                 sheet=rectangle((0, 0, 5), 3, (1, 0, 0), 180, **glowing(0.54)))
    found = derivative(scene, "sheet.emitter.radiance.place", ONE, WEIGHTS, max_depth=2, **settings)
    assert_close(found, 6 * seen_at(6 * 0.54 - 3, WEIGHTS), 0.03)


HEIGHT, ALBEDO, PIXELS = 2.0, 0.7, 2


def lit(place: float) -> rb.Scene:
    """A small part of a floor, seen from between it and a painted lamp, two wide, that faces it."""
    return load(torch.float64, camera=overhead(PIXELS, 1.5, 0.01), floor=rectangle((0, 0, 0), 0.5, bsdf=diffuse(ALBEDO)),
                lamp=rectangle((0, 0, HEIGHT), 1, (1, 0, 0), 180, **glowing(place)))


@pytest.mark.parametrize("nee", [True, False])
def test_a_line_on_a_lamp_as_vertices_of_paths_see_it(nee):
    """Where it moves by dx = 2 dplace, one colour takes the place of the other along the line."""
    y, x = torch.linspace(-1, 1, 100001, dtype=torch.float64), 2 * 0.6 - 1
    received = torch.trapezoid(HEIGHT**2 / (x * x + y * y + HEIGHT**2) ** 2, y) * (LEFT - RIGHT)
    found = derivative(lit(0.6), "lamp.emitter.radiance.place", ONE, spp=8192, max_depth=2, nee=nee)
    assert_close(found, 2 * ALBEDO / math.pi * received * PIXELS**2, 0.03)


def said(scene: rb.Scene, name: str, **settings) -> list[str]:
    """What is warned of before a derivative."""
    scene.get_parameter(name).requires_grad_()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rb.Renderer(scene, spp=1, max_depth=1, **settings)(seed=1)
    return [str(warning.message) for warning in caught]


def test_a_term_that_is_switched_off_names_what_moves_its_lines_in_view():
    for name in ("sheet.emitter.radiance.place", "sheet.to_world", "camera.to_world"):
        sheet = rectangle((0, 0, 0), 9, **glowing(0.5))
        message, = said(load(camera=parallel(4), sheet=sheet), name, terms=["interior"])
        assert f"`{name}` lack the contribution of painted lines" in message
        assert said(load(camera=parallel(4), sheet=sheet), name) == []
    aside = rectangle((0, 0, 0), 9, **glowing(0.9))
    assert said(load(camera=parallel(4), sheet=aside), "sheet.emitter.radiance.place", terms=["interior"]) == []
