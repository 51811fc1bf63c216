"""Lines along which textures jump, against closed forms: of the lines, and of what they add to derivatives."""

from __future__ import annotations

import math

import pytest
import torch

from tests.boundary.closed_forms import DARK, SIZE, along, assert_close, derivative, parallel
from tests.scenes import diffuse, load, overhead, rectangle, rgb
from tests.scenes.inner_jumps import CHECKERBOARD, POINT, VIEWED, nearest, patterned
from torch_radbp.boundary.curve.faces import Faces
from torch_radbp.boundary.curve.texture_lines import segments_along
from torch_radbp.io.values.transform import scale
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.texture.bitmap import Bitmap
from torch_radbp.texture.checkerboard import Checkerboard

BRIGHT, DIM = torch.tensor([3.0, 2.0, 1.0], dtype=torch.float64), torch.tensor([0.5, 0.25, 2.0], dtype=torch.float64)
SQUARES = {"type": "checkerboard", "color0": rgb(*BRIGHT.tolist()), "color1": rgb(*DIM.tolist())}


def two_triangles() -> Faces:
    """Those of a unit square."""
    return Faces(torch.arange(2, dtype=torch.int32), None, None)


def levels(lines: JumpLines) -> tuple[torch.Tensor, ...]:
    """At the corners of a unit square's two triangles."""
    u, v = torch.tensor([[0.0, 1, 1], [0, 1, 0]]).double(), torch.tensor([[0.0, 0, 1], [0, 1, 1]]).double()
    return tuple((lines.x * u + lines.y * v + lines.z).unbind(1))


def test_each_line_crosses_each_triangle_once_and_edges_have_one_owner():
    """u = 1/4, 2/4, 3/4, and u = 0, an edge of the second triangle; u = 1 would belong to what lies beyond."""
    found = segments_along(two_triangles(), levels(JumpLines(4.0, 0.0, 0.0)), JumpLines(4.0, 0.0, 0.0))
    lengths = torch.hypot(found.end.x - found.start.x, found.end.y - found.start.y)
    assert found.triangle[lengths > 1e-3].tolist() == [0, 0, 0, 1, 1, 1, 1]
    known = ((found.aside.x != 0) | (found.aside.y != 0))[lengths > 1e-3]
    assert known.tolist() == [True] * 3 + [False] + [True] * 3


def test_a_line_along_the_diagonal_counts_for_one_of_its_triangles():
    lines = JumpLines(1.0, -1.0, 0.0)  # integers at u - v = 0, the diagonal, and in the corners
    found = segments_along(two_triangles(), levels(lines), lines)
    lengths = torch.hypot(found.end.x - found.start.x, found.end.y - found.start.y)
    assert int((lengths > 1e-3).sum()) == 1


def test_segments_lie_on_the_lines():
    lines = JumpLines(3.7, -5.1, 0.3)
    found = segments_along(two_triangles(), levels(lines), lines)
    assert len(found.triangle) >= 9
    corner = levels(lines)
    for end in (found.start, found.end):
        own = [value[found.triangle.long()] for value in corner]
        level = own[0] * (1 - end.x - end.y) + own[1] * end.x + own[2] * end.y
        assert (level - level.round()).abs().max() < 1e-12
        assert min(float(weight.min()) for weight in (end.x, end.y, 1 - end.x - end.y)) > -1e-12


def test_lines_inside_of_a_range_only():
    lines = JumpLines(8.0, 0.0, 0.0, 2, 5)
    found = segments_along(two_triangles(), levels(lines), lines)
    assert len(found.triangle) == 2 * 4


def test_textures_name_their_lines():
    assert Checkerboard(to_uv=scale((3, 2, 1))).jumps() == (JumpLines(6.0, 0.0, 0.0), JumpLines(0.0, 4.0, 0.0))
    image = torch.rand(4, 3, 3)
    assert Bitmap(data=image).jumps() == ()
    assert Bitmap(data=image, filter_type="nearest").jumps() == (JumpLines(3.0, 0.0, 0.0), JumpLines(0.0, 4.0, 0.0))
    assert Bitmap(data=image, filter_type="nearest", wrap_mode="clamp").jumps() == (
        JumpLines(3.0, 0.0, 0.0, 1, 2), JumpLines(0.0, 4.0, 0.0, 1, 3))
    nested = Checkerboard(color0=Bitmap(data=image, filter_type="nearest"), color1=0.5)
    assert len(nested.jumps()) == 4


@pytest.mark.parametrize("bitmap", [False, True], ids=["checkerboard", "texels"])
def test_squares_move_with_their_surface(bitmap):
    """Glowing stripes, 5 / 6 wide, of a sheet beyond the view: three borders in view move by one, and carry their jumps."""
    texture = {"type": "bitmap", "bitmap": torch.stack([BRIGHT, DIM])[None].float(), "filter_type": "nearest",
               "raw": True} if bitmap else SQUARES
    radiance = texture | {"to_uv": scale((12, 0.9, 1))}
    sheet = rectangle((0.1, 0, 0), (10, 400, 1), emitter={"type": "area", "radiance": radiance})
    scene = load(torch.float64, camera=parallel(), sky=DARK, sheet=sheet)
    weights = torch.linspace(1.0, 2.0, SIZE, dtype=torch.float64).expand(SIZE, SIZE)
    found = derivative(scene, "sheet.to_world", along(0), weights)
    assert_close(found, carried_by_borders(weights))


def carried_by_borders(weights: torch.Tensor) -> torch.Tensor:
    """What changes where borders move by one that lie where 24 u is an integer, u = (x - 0.1) / 20 + 1 / 2; v = 1 / 2 lies
    between two lines."""
    expected, pixel = torch.zeros(3, dtype=torch.float64), 2 / SIZE
    for number, x in ((11, 0.1 - 5 / 6), (12, 0.1), (13, 0.1 + 5 / 6)):
        left, right = (DIM, BRIGHT) if number % 2 == 0 else (BRIGHT, DIM)
        expected += (left - right) * weights[0, int((x + 1) / pixel)] / pixel * SIZE
    return expected


def test_squares_slide_where_surface_coordinates_move():
    """The same, where u grows by one: borders move by -20. And where v does, nothing does that is in view."""
    u, v = torch.tensor([[0.0, 1, 1, 0], [0, 0, 1, 1]], dtype=torch.float64)
    sheet = {"type": "mesh", "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]), "vertex_texcoords": torch.stack([u, v], 1),
             "vertex_positions": torch.stack([20 * u - 9.9, 800 * v - 400, 0 * u], 1),
             "emitter": {"type": "area", "radiance": SQUARES | {"to_uv": scale((12, 0.9, 1))}}}
    weights = torch.linspace(1.0, 2.0, SIZE, dtype=torch.float64).expand(SIZE, SIZE)
    scene = load(torch.float64, camera=parallel(), sky=DARK, sheet=sheet)
    u, v = torch.eye(2, dtype=torch.float64)
    assert_close(derivative(scene, "sheet.vertex_texcoords", u.expand(4, 2), weights), -20 * carried_by_borders(weights))
    assert derivative(scene, "sheet.vertex_texcoords", v.expand(4, 2), weights).abs().max() < 1e-6


def test_squares_of_a_lamp_slide_as_a_floor_below_sees_them():
    """The line u = 1/2, over the middle of the floor, moves by -2.5 where u grows by one."""
    x, y = torch.tensor([[-1.0, 1, 1, -1], [-1, -1, 1, 1]], dtype=torch.float64)
    lamp = {"type": "mesh", "faces": torch.tensor([[0, 2, 1], [0, 3, 2]]),
            "vertex_texcoords": torch.stack([0.5 + 0.4 * x, 0.25 + 0.2 * y], 1),
            "vertex_positions": torch.stack([x, y, 0 * x + 2], 1), "emitter": {"type": "area", "radiance": SQUARES}}
    scene = load(torch.float64, camera=overhead(2, 1.5, 0.01), lamp=lamp, floor=rectangle((0, 0, 0), 0.5, bsdf=diffuse(0.7)))
    found = derivative(scene, "lamp.vertex_texcoords", torch.tensor([1.0, 0.0]).double().expand(4, 2), spp=8192, max_depth=2)
    line = torch.linspace(-1, 1, 100001, dtype=torch.float64)
    received = torch.trapezoid(4 / (line * line + 4) ** 2, line) * (BRIGHT - DIM)
    assert_close(found, -2.5 * 0.7 / math.pi * received * 4, 0.03)


def test_the_light_of_squares_under_a_lamp_follows_a_narrower_view():
    """Light that varies over the squares: what the lines add to the whole image, by sums over a fine grid of directions."""
    scene = load(torch.float64, sensor=VIEWED, **patterned(CHECKERBOARD), lamp=POINT)
    found = derivative(scene, "sensor.x_fov", torch.ones((), dtype=torch.float64), spp=1024, max_depth=2,
                       terms=("primary",))
    pose, floor = (scene.get_parameter(name).detach().double() for name in ("sensor.to_world", "floor.to_world"))
    inverse, to_uv = torch.linalg.inv(floor), torch.as_tensor(CHECKERBOARD["to_uv"]).double()
    x, y = torch.meshgrid(*((torch.arange(1200, dtype=torch.float64) + 0.5) / 600 - 1,) * 2, indexing="ij")

    def seen(fov: float) -> tuple[torch.Tensor, torch.Tensor]:
        """Which colour each direction meets, and how bright the light is there."""
        half = math.tan(math.radians(fov) / 2)
        d = torch.stack([-x * half, -y * half, torch.ones_like(x)], -1) @ pose[:3, :3].T
        o, flat = inverse[:3, :3] @ pose[:3, 3] + inverse[:3, 3], d @ inverse[:3, :3].T
        t = -o[2] / flat[..., 2]
        uv = torch.stack([(o[axis] + t * flat[..., axis] + 1) / 2 for axis in (0, 1)], -1)
        cells = torch.floor(2 * (uv @ to_uv[:2, :2].T + to_uv[:2, 3]))
        reach = torch.tensor(POINT["position"], dtype=torch.float64) - (pose[:3, 3] + t[..., None] * d)
        squared = (reach**2).sum(-1)
        normal = torch.nn.functional.normalize(floor[:3, 2], dim=0)
        return cells.sum(-1) % 2, (reach @ normal).clamp_min(0) / squared**1.5 / math.pi

    step = 0.1
    (wider, _), (narrower, _), (_, light) = seen(40 + step), seen(40 - step), seen(40)
    jump = (torch.tensor([0.8, 0.3, 0.1]) - torch.tensor([0.2, 0.4, 0.9])).double() * torch.tensor([8.0, 7.0, 9.0]).double()
    expected = jump * ((wider - narrower) * light).mean() / (2 * step) * 16 * 16
    assert_close(found, expected, 0.03)


def test_what_does_not_move_is_not_looked_at(monkeypatch):
    from torch_radbp.boundary.curve import texture_lines
    from torch_radbp.boundary.terms import primary

    def unexpected(*_):
        raise AssertionError("lines were looked for")

    monkeypatch.setattr(texture_lines, "segments_along", unexpected)
    smooth = {"type": "bitmap", "bitmap": torch.rand(4, 4, 3), "raw": True}
    sheet = {"type": "mesh", "faces": torch.tensor([[0, 1, 2]]), "vertex_positions": 3 * torch.eye(3),
             "vertex_texcoords": torch.eye(3)[:, :2], "bsdf": {"type": "diffuse", "reflectance": smooth}}
    with monkeypatch.context() as context:
        context.setattr(primary, "jumps_of_views", unexpected)
        slid = load(torch.float64, sensor=VIEWED, sheet=sheet, lamp=POINT)
        assert derivative(slid, "sheet.vertex_texcoords", torch.ones(3, 2), spp=4, max_depth=2).isfinite().all()
    scene = load(torch.float64, sensor=VIEWED, **patterned(nearest("repeat")), lamp=POINT, plate=rectangle((0, 0, 0.5), 0.2))
    assert derivative(scene, "plate.to_world", along(0), spp=4, max_depth=2).isfinite().all()
