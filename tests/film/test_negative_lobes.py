"""Filters with negative lobes: samples are drawn from the magnitude and count with the sign; the mean weight is 1."""

import math

import pytest
import torch
from scipy import integrate

import torch_radbp as rb
from tests.gradients import assert_informative, image_and_gradients, relative_error
from tests.scenes import CASES, cornell, load, rectangle, rgb, sensor
from torch_radbp.film.catmullrom import CatmullRom
from torch_radbp.film.filter import TABLE_SIZE
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.film.lanczos import Lanczos
from torch_radbp.film.mitchell import Mitchell
from torch_radbp.film.position import quantile

FILTERS = {"mitchell": Mitchell(), "sharp mitchell": Mitchell(B=0.1, C=0.7), "catmullrom": CatmullRom(),
           "lanczos": Lanczos(), "two lobes": Lanczos(lobes=2)}
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


@pytest.mark.parametrize("filter", FILTERS.values(), ids=FILTERS)
def test_the_samples_have_the_moments_of_the_filter(filter):
    """Of any function g the mean of weight times g is the integral of filter times g: here of powers and of a cosine."""
    def integral(g):
        lobes = [float(x) for x in range(-int(filter.radius) + 1, int(filter.radius))]
        return integrate.quad(lambda x: float(filter.evaluate(torch.tensor(x, dtype=torch.float64))) * g(x), -filter.radius,
                              filter.radius, points=lobes, limit=200)[0]

    film = HDRFilm(width=9, height=9, sample_border=True, rfilter=filter).tensors(torch.zeros((), dtype=torch.float64))
    u = (torch.arange(1 << 16, dtype=torch.float64) + 0.5) / (1 << 16)
    column = torch.full((1 << 16,), 4, dtype=torch.int32)
    middle = torch.full_like(u, 0.5)
    weight = film.weight(column, column, u, middle)
    weight = weight / weight.mean()
    x = quantile(film.filter.quantiles, u)
    total = integral(lambda x: 1.0)
    assert (weight < 0).any()
    for g in (lambda x: x, lambda x: x * x, lambda x: x**3, lambda x: torch.cos(torch.as_tensor(3 * x))):
        assert float((weight * g(x)).mean()) == pytest.approx(integral(g) / total, abs=2e-3)


@pytest.mark.parametrize("border", [False, True])
@pytest.mark.parametrize("filter", FILTERS.values(), ids=FILTERS)
def test_the_mean_weight_of_every_pixel_is_one(filter, border):
    film = HDRFilm(width=5, height=3, sample_border=border, rfilter=filter).tensors(torch.zeros((), dtype=torch.float64))
    numbers = (torch.arange(4096, dtype=torch.float64) + 0.5) / 4096
    middle = torch.full_like(numbers, 0.5)
    for column, row in ((0, 0), (4, 1), (2, 2)):
        where = [torch.full(numbers.shape, place, dtype=torch.int32) for place in (column, row)]
        # A product of a function of u and one of v.
        across, down, both = (film.weight(*where, u, v).mean()
                              for u, v in ((numbers, middle), (middle, numbers), (middle, middle)))
        assert float(across * down / both) == pytest.approx(1, abs=2e-3)
        position = film.position(*where, numbers, numbers.flip(0))
        if not border:
            assert 0 <= position.x.min() and position.x.max() <= 1 and 0 <= position.y.min() and position.y.max() <= 1


def test_signs_are_those_of_the_filter():
    table = Lanczos().table()
    assert table.signs.shape == (TABLE_SIZE - 1,) and table.signs.abs().max() <= 1 + 1e-9
    middle = 0.5 * (table.quantiles[1:] + table.quantiles[:-1])
    whole = table.signs.abs() > 1 - 1e-6
    assert whole.float().mean() > 0.99
    assert torch.equal(torch.sign(Lanczos().evaluate(middle))[whole], torch.sign(table.signs)[whole])


@pytest.mark.parametrize("name", ["mitchell", "catmullrom", "lanczos"])
def test_a_constant_is_constant_and_an_edge_rings(name):
    """Across a straight edge a pixel's value is the integral of the filter up to the edge: beyond 0 and 1, too."""
    size, tangent = 16, math.tan(math.radians(20))
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": name}, "sample_border": True}
    lamp = rectangle((-10, 0, 0), (10.0, 20.0, 1.0), emitter={"type": "area", "radiance": rgb(1, 1, 1)})  # all of x < 0
    scene = load(sensor=sensor(size, (0.03, 0, 4), (0.03, 0, 0), 40, film=film), lamp=lamp)
    image = rb.render(scene, spp=256, max_depth=1)[0, 0].mean(0)  # all rows show the same: 4096 samples a column
    edge = size / 2 - 0.03 * size / (2 * 4 * tangent)  # pixels from the left
    filter = {"mitchell": Mitchell, "catmullrom": CatmullRom, "lanczos": Lanczos}[name]()
    x = torch.linspace(-filter.radius, filter.radius, 20001, dtype=torch.float64)
    values = filter.evaluate(x)
    expected = torch.tensor([float(values[x <= edge - column - 0.5].sum() / values.sum()) for column in range(size)])
    assert expected.max() > 1.002 and expected.min() < -0.001
    assert (image - expected).abs().max() < 0.04  # 5 standard errors of 4096 signed samples, each at most 1.5
    assert (image - expected).abs().mean() < 0.012


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
