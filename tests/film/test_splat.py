"""Samples count in the pixels around them: against sums that are written out one by one, in numpy."""

from itertools import product

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import assert_informative, cotangent, relative_error
from tests.scenes import cornell, sensor
from torch_radbp.call import chunks
from torch_radbp.call.pixels import Films, film_places, filters_of, sums_of_wavefront
from torch_radbp.film.box import Box
from torch_radbp.film.gaussian import Gaussian
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.film.lanczos import Lanczos
from torch_radbp.film.mitchell import Mitchell
from torch_radbp.film.splat import Block, Deposited, deposited, gathered_from_sums, sums_of
from torch_radbp.film.tent import Tent
from torch_radbp.jit.stages import compiled
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Vec2

FILTERS = {"box": Box(), "wide box": Box(radius=1.2), "tent": Tent(), "narrow tent": Tent(radius=0.4),
           "gaussian": Gaussian(), "wide gaussian": Gaussian(stddev=0.8), "mitchell": Mitchell(), "lanczos": Lanczos()}


def the_call(filter, spp: int, compile: bool, **film):
    """A call of a box of 9 x 7 pixels, and its renderer."""
    scene = cornell(sensors={"sensor": sensor(9, film={"type": "hdrfilm", "width": 9, "height": 7, **film})})
    scene.sensors[0].film.rfilter = filter
    renderer = rb.Renderer(scene, spp=spp, max_depth=3, compile=compile)
    return renderer, renderer.prepare(3, None, None, None)


def samples(call) -> tuple[np.ndarray, np.ndarray]:
    """Where the samples lie, pixels from the upper left corner of the window, (N, 2); and two values of each, (N, 2)."""
    places = []
    for wavefront in call.wavefronts:
        chunk, = wavefront.chunks
        grid, place = call.views[0].grid, film_places(call, wavefront, 0)
        pixel = chunk.rows.numbers(place.x.device).repeat_interleave(chunk.samples)
        row, column = torch.div(pixel, grid.columns, rounding_mode="floor"), pixel % grid.columns
        places.append(torch.stack([column + place.x, row + place.y], 1) - grid.window.rows.before)
    places = torch.cat(places).double().numpy()
    return places, np.stack([np.cos(3 * places[:, 0] + places[:, 1]), 1 + places[:, 1] ** 2], 1)


def written_out(filter, places: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(C, 7, 9) the image, and (7, 9) the sums of the filter."""
    def at(x: np.ndarray) -> np.ndarray:
        inside = np.abs(x) <= filter.radius
        return np.where(inside, filter.evaluate(torch.from_numpy(x)).numpy(), 0.0)

    image, filters = np.zeros((values.shape[1], 7, 9)), np.zeros((7, 9))
    for row, column in product(range(7), range(9)):
        counts = at(places[:, 0] - column - 0.5) * at(places[:, 1] - row - 0.5)
        filters[row, column] = counts.sum()
        image[:, row, column] = counts @ values / (filters[row, column] if filters[row, column] else 1.0)
    return image, filters


@pytest.mark.parametrize("compile", [False, True])
@pytest.mark.parametrize("border", [False, True])
@pytest.mark.parametrize("name", FILTERS)
def test_images_are_the_sums_of_samples_over_the_sums_of_the_filter(name, border, compile):
    _, call = the_call(FILTERS[name], 5, compile, sample_border=border)
    places, values = samples(call)
    beside = 2 * border * FILTERS[name].kernel().reach
    assert len(places) == (9 + beside) * (7 + beside) * 5
    expected, sums = written_out(FILTERS[name], places, values)
    first = 0

    def work(wavefront):
        nonlocal first
        own = torch.from_numpy(values[first:first + wavefront.lanes]).unbind(1)
        first += wavefront.lanes
        place = film_places(call, wavefront, 0)
        return sums_of_wavefront(call, wavefront, [value.contiguous() for value in own], place), None

    found = Films().gather(call._replace(workers=1), work)
    assert np.abs(sums).max() > 0.5 and np.abs(expected).max() > 1
    np.testing.assert_allclose(found.filters[0].numpy(), sums, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.values[0].numpy(), expected, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("name, border, compile", [
    case if case in (("box", False, True), ("gaussian", True, False), ("gaussian", True, True), ("lanczos", False, True))
    else deep(*case) for case in product(("box", "gaussian", "lanczos"), (False, True), (False, True))])
def test_images_have_the_same_bits_in_bands_and_chunks_of_any_size(name, border, compile, monkeypatch):
    """Bands of one row are less than a sample reaches."""
    def image(band: int, **settings) -> tuple[int, torch.Tensor]:
        monkeypatch.setattr(chunks, "BAND", band)
        scene = cornell(torch.float32, sensors={"sensor": sensor(9, film={
            "type": "hdrfilm", "width": 9, "height": 7, "sample_border": border})})
        scene.sensors[0].film.rfilter = FILTERS[name]
        renderer = rb.Renderer(scene, max_depth=3, compile=compile, **settings)
        groups = {wavefront.group for wavefront in renderer.prepare(3, None, None, None).wavefronts}
        return len(groups), renderer(seed=3)

    for spp in (3, 20):
        once, expected = image(1 << 18, spp=spp)
        assert once == 1 and expected.abs().max() > 0.1
        bands = ((1, 1), (20, 1), (1 << 18, 1)) if spp == 3 else ((20, 1), (30, 9 * 20 * 2))
        for band, chunk in bands:
            groups, found = image(band, spp=spp, chunk=chunk)
            assert groups > 1 or chunk > 1 or band == 1 << 18
            assert torch.equal(found, expected), (spp, band, chunk)


@pytest.mark.parametrize("name", ["box", "gaussian", "mitchell"])
def test_what_lanes_are_asked_for_is_the_transpose(name):
    renderer, call = the_call(FILTERS[name], 3, True, sample_border=name == "mitchell")
    places, values = samples(call)
    wanted = cotangent(torch.zeros(1, 3, 7, 9, dtype=torch.float64))
    filters = filters_of(call, 0)
    pixels = call.sink.adj_sums(call, wanted, filters)
    adjoint = torch.cat([torch.stack(call.sink.adjoint(call, wavefront, film_places(call, wavefront, 0), pixels))
                         for wavefront in call.wavefronts], 1)
    expected, _ = written_out(FILTERS[name], places, values)
    product = float((wanted[0, 0] * torch.from_numpy(expected[0])).sum())
    assert abs(product) > 1e-3
    assert float((adjoint[0] * torch.from_numpy(values[:, 0])).sum()) == pytest.approx(product, rel=1e-9)


@pytest.mark.parametrize("name", ["tent", deep("lanczos")])
def test_recorded_sums_have_the_derivatives_of_autograd_and_second_ones(name):
    kernel, generator = FILTERS[name].kernel(), torch.Generator().manual_seed(1)
    u, v, *values = (torch.rand(12, generator=generator, dtype=torch.float64) for _ in range(4))
    block = Block(Vec2(u, v), 3, 3)
    inputs = [value.requires_grad_() for value in values]
    assert torch.autograd.gradcheck(lambda *own: Deposited.apply(kernel, block, *own), inputs, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(lambda *own: Deposited.apply(kernel, block, *own).square(), inputs)


def test_compiled_and_eager_sums_are_the_same_but_for_rounding():
    kernel, generator = Gaussian().kernel(), torch.Generator().manual_seed(2)
    u, v, value = (torch.rand(7 * 11, generator=generator, dtype=torch.float64) for _ in range(3))
    found = [sums_of(stages(deposited), kernel, (value,), Block(Vec2(u, v), 11, 11)) for stages in (EAGER, compiled())]
    assert found[0].shape == (5, 5, 2, 7) and found[0].abs().max() > 1
    torch.testing.assert_close(found[1], found[0], rtol=0, atol=1e-14)
    adjoint, = gathered_from_sums(kernel, Block(Vec2(u, v), 11, 11), found[0][:, :, 1:])
    assert float((adjoint * value).sum()) == pytest.approx(float((found[0][:, :, 1] ** 2).sum()), rel=1e-12)


def test_the_integrals_of_a_filter_inside_a_window():
    """Of a tent that is cut in half at the border."""
    film = HDRFilm(width=4, height=3, rfilter=Tent()).tensors(torch.zeros((), dtype=torch.float64))
    torch.testing.assert_close(film.inside_x, torch.tensor([0.875, 1, 1, 0.875], dtype=torch.float64), rtol=0, atol=1e-6)
    film = HDRFilm(width=4, height=3, rfilter=Tent(), sample_border=True).tensors(torch.zeros((), dtype=torch.float64))
    torch.testing.assert_close(film.inside_y, torch.ones(3, dtype=torch.float64), rtol=0, atol=1e-6)


@pytest.mark.parametrize("border", [False, True])
@pytest.mark.parametrize("name", ["box", "gaussian", "lanczos"])
def test_a_point_counts_as_many_samples_there_would(name, border):
    """The mean over all of the window of what points count in a pixel is 1."""
    film = HDRFilm(width=5, height=4, rfilter=FILTERS[name], sample_border=border).tensors(torch.zeros(()).double())
    steps, reach = 40, int(film.before.x)
    x, y = ((torch.arange((pixels + 2 * reach) * steps, dtype=torch.float64) + 0.5) / steps - reach for pixels in (5, 4))
    points = Vec2(x.repeat(len(y)), y.repeat_interleave(len(x)))
    total = torch.zeros(20, dtype=torch.float64)
    for pixel, counts in film.around(points):
        total.index_add_(0, pixel, counts)
    torch.testing.assert_close(total / steps**2, torch.ones(20, dtype=torch.float64), rtol=0, atol=2e-3)


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.TapeAdjoint()], ids=repr)
def test_a_crop_with_a_gaussian_has_the_derivative_of_differences(adjoint):
    """Where samples of the image count in pixels around, those beyond the window do not."""
    film = {"type": "hdrfilm", "width": 12, "height": 10, "crop_offset_x": 3, "crop_offset_y": 2, "crop_width": 5,
            "crop_height": 6, "rfilter": {"type": "gaussian"}}
    name = "white.reflectance.value"

    def image(shift: float, **settings):
        scene = cornell(sensors={"sensor": sensor(12, film=film)})
        value = scene.get_parameter(name).requires_grad_()
        with torch.no_grad():
            value += shift
        renderer = rb.Renderer(scene, spp=4, max_depth=3, share_samples=True, **settings)
        return renderer(seed=2), value

    found, value = image(0.0, adjoint=adjoint)
    w = cotangent(found)
    gradient, = torch.autograd.grad((found * w).sum(), value)
    with torch.no_grad():
        step = 1e-4
        expected = float(((image(step)[0] - image(-step)[0]) * w).sum() / (2 * step))
    assert_informative(found, [gradient])
    assert relative_error(gradient.sum(), torch.tensor(expected, dtype=torch.float64)) < 1e-6
