"""Lens distortion, forward against kornia's or by formulas in plain numbers, back against forward, derivatives against
finite differences."""

import math

import pytest
import torch
from torch.autograd import gradcheck

from torch_radbp.sensor.distortion import BrownConrady, FieldOfView, KannalaBrandt, ThinPrismFisheye
from torch_radbp.tensors.vec import Vec2, Vec3

BROWN = {
    "none": {},
    "barrel": {"k1": -0.3},
    "pincushion": {"k1": 0.25, "k2": 0.1},
    "tangential": {"p1": 0.03, "p2": -0.02},
    "five": {"k1": -0.28, "k2": 0.09, "k3": -0.01, "p1": 0.001, "p2": -0.002},
    "rational": {"k1": 0.4, "k2": 0.1, "k3": 0.02, "k4": 0.7, "k5": 0.2, "k6": 0.03, "p1": -0.01, "p2": 0.02},
}
FISHEYE = {
    "equidistant": {}, "one": {"k1": -0.05}, "four": {"k1": 0.06, "k2": -0.03, "k3": 0.01, "k4": -0.002},
}
PRISM = {
    "radial": {"k1": -0.05, "k2": 0.01}, "tangential": {"p1": 0.02, "p2": -0.03}, "prism": {"sx1": 0.03, "sy1": -0.02},
    "all": {"k1": 0.06, "k2": -0.03, "k3": 0.01, "k4": -0.002, "p1": 0.01, "p2": -0.02, "sx1": 0.015, "sy1": -0.01},
}
VIEWS = {"narrow": {"omega": 1e-3}, "wide": {"omega": 0.9}, "widest": {"omega": 2.6}}
ALL = [*((BrownConrady, each) for each in BROWN.values()), *((KannalaBrandt, each) for each in FISHEYE.values()),
       *((ThinPrismFisheye, each) for each in PRISM.values()), *((FieldOfView, each) for each in VIEWS.values())]
IDS = [*BROWN, *FISHEYE, *PRISM, *VIEWS]
ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # of OpenCV


def lens(model, coefficients, dtype=torch.float64):
    return model(**{name: torch.tensor(value, dtype=dtype) for name, value in coefficients.items()})


def slopes(reach: float, count: int = 400, dtype=torch.float64) -> Vec2:
    """Points of a square, the middle among them."""
    generator = torch.Generator().manual_seed(2)
    points = (torch.rand(count, 2, generator=generator, dtype=torch.float64) * 2 - 1) * reach
    points[0] = 0
    return Vec2.of(points.to(dtype))


def ahead(point: Vec2) -> Vec3:
    return Vec3(point.x, point.y, torch.ones_like(point.x))


@pytest.mark.parametrize("coefficients", BROWN.values(), ids=BROWN)
def test_brown_conrady_is_that_of_kornia(coefficients):
    distort_points = pytest.importorskip("kornia.geometry.calibration").distort_points
    point = slopes(0.6)
    expected = distort_points(point.stack()[None], torch.eye(3, dtype=torch.float64)[None],
                              torch.tensor([[coefficients.get(name, 0.0) for name in ORDER]], dtype=torch.float64))[0]
    found = lens(BrownConrady, coefficients).distorted(ahead(point)).stack()
    assert (found - expected).abs().max() < 1e-12
    assert not coefficients or (found - point.stack()).abs().max() > 0.005


@pytest.mark.parametrize("coefficients", FISHEYE.values(), ids=FISHEYE)
def test_the_fisheye_is_that_of_kornia(coefficients):
    distort = pytest.importorskip("kornia.geometry.camera").distort_points_kannala_brandt
    point = slopes(2.0)
    intrinsics = [1.0, 1.0, 0.0, 0.0, *(coefficients.get(f"k{number}", 0.0) for number in (1, 2, 3, 4))]
    expected = distort(point.stack(), torch.tensor(intrinsics, dtype=torch.float64))
    assert (lens(KannalaBrandt, coefficients).distorted(ahead(point)).stack() - expected).abs().max() < 1e-12


@pytest.mark.parametrize("coefficients", PRISM.values(), ids=PRISM)
def test_a_thin_prism_is_that_of_colmap(coefficients):
    """In complex numbers: z of length theta goes to z radial + 2 (p2 Re z + p1 Im z) z + theta^2 (p2 + sx1 + i (p1 + sy1)),
    which is COLMAP's formula, component by component."""
    point = slopes(2.0)
    found = lens(ThinPrismFisheye, coefficients).distorted(ahead(point)).stack()
    k1, k2, k3, k4, p1, p2, sx1, sy1 = (coefficients.get(name, 0.0) for name in ThinPrismFisheye._fields)
    for (x, y), pair in zip(point.stack().tolist()[1:], found.tolist()[1:]):
        theta = math.atan(math.hypot(x, y))
        z = theta * complex(x, y) / abs(complex(x, y))
        radial = 1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8
        wanted = z * radial + 2 * (p2 * z.real + p1 * z.imag) * z + theta**2 * complex(p2 + sx1, p1 + sy1)
        assert abs(complex(*pair) - wanted) < 1e-12
    assert found[0].abs().max() < 1e-12


@pytest.mark.parametrize("coefficients", VIEWS.values(), ids=VIEWS)
def test_a_field_of_view_is_that_of_devernay_and_faugeras(coefficients):
    """r' = atan(2 r tan(omega / 2)) / omega: 1/2 stays 1/2, and without omega everything does."""
    omega, point = coefficients["omega"], slopes(3.0)
    found = lens(FieldOfView, coefficients).distorted(ahead(point)).stack()
    for (x, y), (found_x, found_y) in zip(point.stack().tolist()[1:], found.tolist()[1:]):
        r = math.hypot(x, y)
        wanted = math.atan(2 * r * math.tan(omega / 2)) / omega
        assert math.hypot(found_x, found_y) == pytest.approx(wanted, abs=1e-12)
        assert found_x * y == pytest.approx(found_y * x, abs=1e-12)
    half, _ = lens(FieldOfView, coefficients).distorted(ahead(Vec2.of(torch.tensor([[0.5, 0.0]], dtype=torch.float64))))
    assert float(half) == pytest.approx(0.5, abs=1e-12)
    if omega < 0.01:  # the difference is r' omega^2 (1 / 12 - r^2 / 3)
        torch.testing.assert_close(found, point.stack(), rtol=7 * omega**2, atol=0)


def test_a_fisheye_with_a_prism_sees_beyond_a_right_angle():
    """Without coefficients it is equidistant; beyond half a circle there is nothing."""
    angle = torch.tensor([0.0, 0.5, 1.5, 2.0, 3.1, 3.2, 9.0], dtype=torch.float64)
    point = Vec2(angle * 0.6, angle * -0.8)
    for given in (ThinPrismFisheye(), lens(ThinPrismFisheye, {"sx1": 1e-9})):
        d, seen = given.direction(point)
        assert seen.tolist() == [True] * 5 + [False] * 2
        torch.testing.assert_close(d.z[:5], torch.cos(angle[:5]), rtol=0, atol=1e-7)
        torch.testing.assert_close(torch.stack(tuple(d)).norm(dim=0), torch.ones_like(angle))
    bent = lens(ThinPrismFisheye, PRISM["all"] | {"k1": 0.03, "k2": -0.002, "k3": 0.0, "k4": 0.0})  # monotone that far
    wide = Vec3.of(torch.tensor([[0.9, 0.2, -0.4], [-0.5, 0.8, -0.2], [0.3, -0.6, 0.7]], dtype=torch.float64))
    length = torch.stack(tuple(wide)).norm(dim=0)
    back, seen = bent.direction(bent.distorted(wide))
    assert seen.all()
    torch.testing.assert_close(back.stack(), wide.stack() / length[:, None], rtol=0, atol=1e-9)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_field_of_view_ends_at_a_right_angle(dtype):
    """At a distance of pi / (2 omega) from the middle; beyond it the axis, and finite derivatives."""
    omega = torch.tensor(0.8, dtype=dtype, requires_grad=True)
    radius = torch.tensor([0.0, 1.0, 1.95, 1.97, 30.0], dtype=dtype)  # pi / 1.6 = 1.963
    d, seen = FieldOfView(omega).direction(Vec2(radius * 0.8, radius * 0.6))
    assert seen.tolist() == [True] * 3 + [False] * 2
    assert d.x[3:].abs().max() == d.y[3:].abs().max() == 0
    gradient, = torch.autograd.grad((d.x + d.y).sum(), omega)
    assert torch.isfinite(gradient) and gradient != 0


@pytest.mark.parametrize("dtype, tolerance", [(torch.float64, 1e-12), (torch.float32, 2e-6)], ids=["double", "single"])
@pytest.mark.parametrize("model, coefficients", ALL, ids=IDS)
def test_undistortion_is_the_reverse(model, coefficients, dtype, tolerance):
    given, point = lens(model, coefficients, dtype), slopes(0.9 if model.is_fisheye else 0.6, dtype=dtype)
    direction, seen = given.direction(given.distorted(ahead(point)))
    assert seen is None or seen.all()
    assert (direction.x / direction.z - point.x).abs().max() < tolerance
    assert (direction.y / direction.z - point.y).abs().max() < tolerance


def test_a_fisheye_sees_beyond_a_right_angle():
    """Equidistant: the distance from the middle is the angle."""
    angle = torch.tensor([0.0, 0.5, 1.5, 2.0, 3.1, 3.2, 9.0], dtype=torch.float64)
    d, seen = KannalaBrandt().direction(Vec2(angle * 0.6, angle * -0.8))
    assert seen.tolist() == [True] * 5 + [False] * 2
    torch.testing.assert_close(d.z[:5], torch.cos(angle[:5]), rtol=0, atol=1e-12)
    torch.testing.assert_close(d.x[:5], 0.6 * torch.sin(angle[:5]), rtol=0, atol=1e-12)
    assert all(torch.isfinite(component).all() for component in d)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_points_that_nothing_is_projected_to_are_told_and_finite(dtype):
    """r (1 - 0.3 r^2) has its maximum 0.7027 at r = 1.0541: beyond it there is no direction, and before it one."""
    radius = torch.tensor([0.0, 0.5, 0.69, 0.71, 0.8, 3.0, 100.0], dtype=dtype)
    k1 = torch.tensor(-0.3, dtype=dtype, requires_grad=True)
    point = Vec2(radius * 0.8, radius * 0.6)
    d, seen = BrownConrady(k1=k1).direction(point)
    assert seen.tolist() == [True] * 3 + [False] * 4
    found = torch.hypot(d.x, d.y)[:3]
    assert (found < 1.0542).all()
    torch.testing.assert_close(found - 0.3 * found**3, radius[:3], rtol=0, atol=1e-6)
    gradient, = torch.autograd.grad((d.x + d.y).sum(), k1)
    assert torch.isfinite(gradient) and gradient != 0


@pytest.mark.parametrize("model, coefficients", [(BrownConrady, BROWN["rational"]), (BrownConrady, BROWN["five"]),
                                                 (KannalaBrandt, FISHEYE["four"]), (ThinPrismFisheye, PRISM["all"]),
                                                 (FieldOfView, VIEWS["wide"])])
def test_derivatives_of_undistortion_are_those_of_finite_differences(model, coefficients):
    values = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in coefficients.values()]
    point = slopes(0.5, 5).stack()[1:].clone().requires_grad_()

    def direction(point, *values):
        found, _ = model(**dict(zip(coefficients, values))).direction(Vec2.of(point))
        return found.stack()

    assert gradcheck(direction, (point, *values), eps=1e-6, atol=1e-8, rtol=1e-7, check_forward_ad=True)
    jacobians = torch.autograd.functional.jacobian(direction, (point, *values))
    assert all(jacobian.abs().max() > 1e-4 for jacobian in jacobians)
