"""Media that make no sense are refused by one message each, which names plugin and parameter.

Files cut short are in `formats/test_volume.py`, lost media in `test_homogeneous.py`, groups in `test_boundaries.py`.
"""

from __future__ import annotations

import math

import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, overhead, rectangle, rgb

NULL, SKY = {"type": "null"}, {"type": "constant"}
DARK = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.0}


def grid(value: float, *shape: int) -> dict:
    return {"type": "gridvolume", "data": torch.full(shape or (2, 2, 2), value)}


def box(**medium):
    """A scene with a box of a medium."""
    return load(torch.float32, camera=overhead(2, 4.0), sky=SKY, box={"type": "cube", "bsdf": NULL, "interior": medium})


@pytest.mark.parametrize("kind", ["homogeneous", "heterogeneous"])
@pytest.mark.parametrize("values, message", [
    ({"sigma_t": -1.0}, "sigma_t must be at least 0, got -1"),
    ({"sigma_t": rgb(1, math.nan, 1)}, "sigma_t must be finite, got .*nan"),
    ({"sigma_t": 1e20}, "sigma_t must be at most 1e.18 in magnitude, got 1e.20"),
    ({"scale": -2.0}, "scale must be at least 0, got -2"),
    ({"scale": math.inf}, "scale must be finite, got inf"),
    ({"albedo": 1.5}, r"albedo must be in \[0, 1\], got 1.5"),
    ({"albedo": -0.5}, r"albedo must be in \[0, 1\], got -0.5"),
    ({"albedo": grid(1.0, 2, 2, 2, 6)}, "albedo of h.*geneous must have 1 or 3 channels, got a gridvolume of 6"),
    ({"sigma_t": grid(1.0, 2, 2)}, r"data of a gridvolume must have shape \(Z, Y, X\) .*, got \(2, 2\)"),
    ({"sigma_t": grid(-1.0)}, "data must be at least 0, got -1"),
    ({"sample_emitters": False}, "sample_emitters must be true"),
])
def test_values_that_make_no_sense_are_refused_by_name(kind, values, message):
    with pytest.raises(rb.SceneError, match=f"box.interior.*{message}"):
        box(type=kind, **values)


def test_a_homogeneous_medium_has_no_grids():
    with pytest.raises(rb.SceneError, match="sigma_t of homogeneous must be the same everywhere, got a gridvolume"):
        box(type="homogeneous", sigma_t=grid(1.0))


def test_the_nearest_name_of_a_medium_is_told():
    with pytest.raises(rb.SceneError, match="medium type 'homogenous' is not supported; did you mean 'homogeneous'"):
        box(type="homogenous")


@pytest.mark.parametrize("name, value, message", [
    ("sigma_t.data", -1.0, "must be at least 0, got -1"),
    ("sigma_t.data", math.nan, "has 8 of 8 values that are NaN or infinite"),
    ("albedo.data", 1.5, r"must be in \[0, 1\], got 1.5"),
    ("albedo.value.value", 1.5, r"must be in \[0, 1\], got 1.5"),
    ("scale", -1.0, "must be at least 0, got -1"),
])
def test_values_that_leave_their_range_later_are_refused_by_name_and_clamped(name, value, message):
    scene = box(type="heterogeneous", sigma_t=grid(1.0), albedo=grid(0.5) if "albedo.data" == name else 0.5)
    parameter = scene.get_parameter(f"box.interior.{name}").requires_grad_()
    parameter.data.fill_(value)
    with pytest.raises(ValueError, match=f"box.interior.{name}' {message}"):
        rb.render(scene, spp=1)
    scene.clamp_()
    if math.isfinite(value):
        assert (parameter == min(max(value, 0.0), 1.0)).all()


def test_weights_of_phase_functions_that_leave_their_range_later_are_refused():
    blend = {"type": "blendphase", "weight": 0.5, "first": {"type": "isotropic"}, "second": {"type": "hg", "g": 0.5}}
    scene = box(type="homogeneous", phase=blend)
    scene.get_parameter("box.interior.phase_function.weight.value.value").data.fill_(1.5)
    with pytest.raises(ValueError, match=r"box.interior.phase_function.weight.value.value' must be in \[0, 1\], got 1.5"):
        rb.render(scene, spp=1)


def test_grids_of_another_size_may_be_assigned_but_of_no_other_number_of_axes():
    scene = box(type="heterogeneous", sigma_t=grid(1.0))
    scene.box.interior.sigma_t.data = torch.nn.Parameter(torch.ones(3, 4, 5, 1))
    rb.render(scene, spp=1)
    scene.box.interior.sigma_t.data = torch.nn.Parameter(torch.ones(2, 2))
    with pytest.raises(ValueError, match=r"box.interior.sigma_t.data' must have shape \(Z, Y, X, 1\) or .*got \(2, 2\)"):
        rb.render(scene, spp=1)


def test_a_sensor_that_does_not_say_so_stands_in_no_medium():
    """As in Mitsuba: a boundary that is left from a sensor's empty space ends nothing; `medium` of the sensor says it."""
    around = {"type": "sphere", "radius": 9.0, "bsdf": NULL, "interior": {"type": "ref", "id": "dark"}}
    silent = load(torch.float64, dark=DARK, camera=overhead(2, 4.0), sky=SKY, around=around)
    said = load(torch.float64, dark=DARK, camera=overhead(2, 4.0) | {"medium": {"type": "ref", "id": "dark"}}, sky=SKY,
                around=around)
    assert torch.allclose(rb.render(silent, spp=4), torch.ones((), dtype=torch.float64))
    left = rb.render(said, spp=1024).mean()
    assert float(left) == pytest.approx(math.exp(-0.5 * 13.0), rel=0.1)  # from 4 above the middle down


@pytest.mark.parametrize("floor", [False, True])
def test_behind_a_boundary_that_does_not_close_the_medium_goes_on(floor):
    """As in Mitsuba: to the next surface, or for ever, so that nothing is seen through it."""
    under = rectangle((0, 0, 0), 9.0, bsdf=diffuse(0, 0, 0), emitter={"type": "area", "radiance": 1.0})
    scene = load(torch.float64, camera=overhead(2, 4.0, 1e-4), sky=SKY, **({"floor": under} if floor else {}),
                 sheet=rectangle((0, 0, 2), 50.0, bsdf=NULL, interior=DARK))
    image = rb.render(scene, spp=1024, seed=1).mean()
    assert float(image) == pytest.approx(math.exp(-0.5 * 2.0) if floor else 0.0, rel=0.03)
