"""Filters with negative lobes: samples count with a negative sign in pixels around them."""

import math

import pytest
import torch

import torch_radbp as rb
from tests.film.straight_edge import SIZE, columns_at_an_edge
from tests.gradients import assert_informative, image_and_gradients, relative_error
from tests.scenes import CASES, cornell, sensor
from torch_radbp.film.catmullrom import CatmullRom
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.film.lanczos import Lanczos
from torch_radbp.film.mitchell import Mitchell

PLACES = [0.0, 0.3, 0.7, 1.2, 1.7, 2.5]


@pytest.mark.parametrize("name, attributes", [("mitchell", {}), ("mitchell", {"B": 0.2, "C": 0.6}), ("catmullrom", {}),
                                              ("lanczos", {}), ("lanczos", {"lobes": 2})])
def test_values_are_those_of_mitsuba(name, attributes):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    theirs = mi.load_dict({"type": name, **attributes})
    ours = {"mitchell": Mitchell, "catmullrom": CatmullRom, "lanczos": Lanczos}[name](**attributes)
    assert ours.radius == theirs.radius()
    x = torch.tensor([place for place in PLACES if place < ours.radius], dtype=torch.float64)
    expected = torch.tensor([theirs.eval(float(place)) for place in x], dtype=torch.float64)
    torch.testing.assert_close(ours.evaluate(x), expected, rtol=0, atol=1e-6)
    assert (expected < -0.005).any()


def test_the_default_of_lanczos_at_some_places_by_hand():
    x = torch.tensor([0.0, 0.5, 1.0, 1.5, 4.0], dtype=torch.float64)
    expected = [1.0, (2 / math.pi) * (3 / math.pi), 0.0, (-2 / (3 * math.pi)) * (2 / math.pi), 0.0]
    torch.testing.assert_close(Lanczos().evaluate(x), torch.tensor(expected).double(), rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", ["mitchell", "catmullrom", "lanczos"])
def test_a_constant_is_constant_and_an_edge_rings(name):
    """Across a straight edge a pixel's value is the integral of the filter up to the edge: beyond 0 and 1, too."""
    image, edge = columns_at_an_edge(rfilter={"type": name}, sample_border=True)
    filter = {"mitchell": Mitchell, "catmullrom": CatmullRom, "lanczos": Lanczos}[name]()
    x = torch.linspace(-filter.radius, filter.radius, 20001, dtype=torch.float64)
    values = filter.evaluate(x)
    expected = torch.tensor([float(values[x <= edge - column - 0.5].sum() / values.sum()) for column in range(SIZE)])
    assert expected.max() > 1.002 and expected.min() < -0.001
    assert (image - expected).abs().max() < 0.01
    assert (image - expected).abs().mean() < 0.002
    away = torch.arange(SIZE).add(0.5).sub(edge).abs() > filter.radius + 0.5
    assert away.any() and (image - (expected > 0.5).float())[away].abs().max() < 1e-5


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.MemoizedAdjoint(2, keep_hits=False), rb.ReplayAdjoint(),
                                     rb.QuadraticAdjoint()], ids=repr)
def test_every_strategy_weighs_gradients_as_the_image(adjoint):
    film = {"type": "hdrfilm", "width": 6, "height": 6, "rfilter": {"type": "lanczos"}}

    def results(adjoint, **settings):
        return image_and_gradients(cornell(sensors={"sensor": sensor(6, film=film)}), CASES["cornell"].parameters, spp=4,
                                   max_depth=3, adjoint=adjoint, **settings)

    image, expected = results(rb.TapeAdjoint(), compile=False)
    assert_informative(image, expected)
    for compile in (False, True):
        found, gradients = results(adjoint, compile=compile)
        assert relative_error(found, image) < 1e-12
        assert all(relative_error(gradient, wanted) < 1e-10 for gradient, wanted in zip(gradients, expected))


def test_forward_mode_weighs_tangents_as_the_image():
    film = {"type": "hdrfilm", "width": 6, "height": 6, "rfilter": {"type": "mitchell"}}
    scene = cornell(sensors={"sensor": sensor(6, film=film)})
    name = "light.emitter.radiance.value"
    radiance = scene.get_parameter(name).detach()
    tangent = rb.jvp(scene, {name: radiance}, spp=4, max_depth=3, seed=2, share_samples=True)
    image = rb.render(scene, spp=4, max_depth=3, seed=2)  # linear in the only light
    assert relative_error(tangent, image) < 1e-10


@pytest.mark.parametrize("make, message", [
    (lambda: Mitchell(B=math.nan), "B and C must be finite"),
    (lambda: Lanczos(lobes=0), "lobes must be an integer of at least 1"),
    (lambda: Lanczos(lobes=2.5), "lobes must be an integer"),
    (lambda: HDRFilm(pixel_format="xyz"), "'xyz' is not supported"),
    (lambda: HDRFilm(component_format="half"), "component_format 'half' is not"),
    (lambda: HDRFilm(file_format="png"), "file_format 'png' is not")])
def test_what_cannot_be_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
