"""Compiled images are the same to the last bit for any chunks and any number of threads; gradients to rounding.

A lane computes the same whichever lanes are beside it, and a pixel is summed in an order of its own. Gradients are summed in
the order of the chunks, in float64.
"""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but
from tests.gradients import assert_informative, image_and_gradients
from tests.scenes import SKY, cornell, load, overhead
from tests.scenes.everything import EVERYTHING, build_everything
from tests.scenes.smoke import box, grid, smoke
from torch_radbp.adjoint import scatter

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")
SETTINGS = {"spp": 5, "max_depth": 4, "rr_depth": 2}
DIVISIONS = [(61, 1), (61, 2), (97, 3), (20, 2)]  # lanes of a chunk, threads
DIVIDED_PIXELS = [(1, 1), (2, 2), (3, 1), (4, 2)]
ROUNDING = 1e-12
# Where terms of the order of 1 cancel, as the slopes of a pyramid's coarsest level do, 1e-16 is left of them or more.
LEAST_GRADIENT = 1e-4


@pytest.fixture
def with_threads():
    """Sets torch's number of threads for the rest of the test."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize("name", deep_but(["lamps"], EVERYTHING))
def test_images_of_all_appearances_have_the_same_bits_and_gradients_agree(name, with_threads):
    def rendered(**settings):
        scene = build_everything(name)
        for view in scene.sensors:
            view.film.width = view.film.height = view.film.crop_width = view.film.crop_height = 6
        names = [parameter for parameter, _ in scene.named_parameters()]
        return names, *image_and_gradients(scene, names, compile=True, **SETTINGS | settings)

    with_threads(1)
    names, image, gradients = rendered()
    assert_informative(image, [])
    for chunk, threads in DIVISIONS:
        with_threads(threads)
        _, found, parts = rendered(chunk=chunk)
        assert torch.equal(found, image), (chunk, threads)
        for parameter, gradient, wanted in zip(names, parts, gradients):
            largest = max(LEAST_GRADIENT, float(wanted.abs().max()))
            assert (gradient - wanted).abs().max() <= ROUNDING * largest, (parameter, chunk, threads)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_a_pixel_whose_samples_are_in_several_chunks_has_the_same_bits(dtype, with_threads):
    def image(**settings):
        return rb.render(cornell(dtype, 3), compile=True, **SETTINGS | settings)

    with_threads(1)
    expected = image()
    for chunk, threads in DIVIDED_PIXELS:
        with_threads(threads)
        assert torch.equal(image(chunk=chunk), expected), (chunk, threads)


def test_the_totals_of_a_large_table_are_there_once(with_threads, monkeypatch):
    """Where those of one worker are larger than a bound, all threads work for one; gradients agree to rounding."""
    def rendered() -> tuple[int, torch.Tensor]:
        data = torch.nn.Parameter(grid(size=(52, 52, 52)).float())  # totals of a megabyte are kept for the next step
        scene = load(torch.float32, sky=SKY, camera=overhead(), box=box(smoke(data)))
        renderer = rb.Renderer(scene, compile=True, chunk=40, **SETTINGS)
        renderer(seed=1).sum().backward()
        return len(renderer.memory.unused), data.grad

    with_threads(2)
    tables, expected = rendered()
    assert tables == 2 and expected.isfinite().all() and expected.abs().max() > LEAST_GRADIENT
    monkeypatch.setattr(scatter, "MOST_BESIDE", 1 << 20)
    tables, gradient = rendered()
    assert tables == 1
    torch.testing.assert_close(gradient, expected, rtol=1e-6, atol=1e-9)
