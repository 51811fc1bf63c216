"""A window is a part of the image: its pixels are those of the whole, and so are its derivatives, at its own cost."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import assert_informative, cotangent, relative_error, unwarned_renderer
from tests.scenes import cornell, diffuse, load, rectangle, rgb, sensor
from torch_radbp.film.hdrfilm import HDRFilm

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
FILM = {"type": "hdrfilm", "width": 14, "height": 12, "crop_offset_x": 1, "crop_width": 12}  # 12 x 12 pixels are rendered
WINDOWS = {"whole": (0, 0, 12, 12), "inside": (3, 4, 5, 2), "at a border": (0, 7, 4, 5), "one pixel": (11, 11, 1, 1)}
WINDOW = (2, 3, 7, 5)


def room(dtype: torch.dtype = torch.float64, rfilter: str = "gaussian", cameras: int = 1, **film) -> rb.Scene:
    film = {**FILM, "rfilter": {"type": rfilter}, **film}
    places = [(0.3 * number, 0.1, 3.5) for number in range(cameras)]
    return cornell(dtype, sensors={f"camera_{number}": sensor(12, place, film=film) for number, place in enumerate(places)})


def cut(image: torch.Tensor, window: tuple[int, int, int, int]) -> torch.Tensor:
    """What one cuts out of a whole image."""
    x, y, width, height = window
    return image[..., y:y + height, x:x + width]


@pytest.mark.parametrize("border", [False, True], ids=["", "sample_border"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian", "lanczos"])
def test_a_window_has_the_bits_of_the_whole_image(rfilter, border):
    """Samples that count in it from beside it are there, and no others than those of the whole image."""
    renderer = rb.Renderer(room(torch.float32, rfilter, sample_border=border), spp=5, max_depth=4)
    whole = renderer(seed=3)
    assert whole.isfinite().all() and whole.std() > 0.01
    for window in WINDOWS.values():
        assert torch.equal(renderer(seed=3, window=window), cut(whole, window))


def test_an_eager_window_is_the_whole_image_s_up_to_rounding():
    renderer = rb.Renderer(room(), spp=4, max_depth=4, compile=False)
    whole = renderer(seed=3)
    for window in WINDOWS.values():
        torch.testing.assert_close(renderer(seed=3, window=window), cut(whole, window), rtol=1e-13, atol=1e-15)


def test_compiled_and_eager_windows_agree():
    scene = room()
    fused, eager = (rb.Renderer(scene, spp=4, max_depth=4, compile=compile)(seed=3, window=WINDOW)
                    for compile in (True, False))
    torch.testing.assert_close(fused, eager, rtol=1e-11, atol=1e-13)


def test_a_window_is_that_of_a_film_with_such_a_crop_and_border():
    """In distribution: there pixels are numbered from the crop's corner, so that they have other samples."""
    x, y, width, height = WINDOW
    crop = {"crop_offset_x": x + 1, "crop_offset_y": y, "crop_width": width, "crop_height": height, "sample_border": True}
    of_crop, of_window = rb.Renderer(room(**crop), spp=4), rb.Renderer(room(), spp=4)
    expected, found = (torch.stack([image(seed) for seed in range(24)]) for image in (
        lambda seed: of_crop(seed=seed)[0], lambda seed: of_window(seed=seed, window=WINDOW)[0]))
    error = (expected.var(0) + found.var(0)).div(24).sqrt()
    z = (found.mean(0) - expected.mean(0)) / error.clamp_min(1e-9)
    assert found.shape == expected.shape and expected.mean() > 0.05
    assert z.abs().max() < 4.5 and 0.5 < z.std() < 1.3


def test_each_sensor_may_have_its_window_and_a_sensor_several():
    renderer = rb.Renderer(room(torch.float32, cameras=2), spp=3, max_depth=3)
    whole = renderer(seed=1)
    first, second = (2, 3, 5, 4), (7, 8, 5, 4)
    found = renderer(seed=1, window=[first, second])
    assert torch.equal(found, torch.stack([cut(whole[0], first), cut(whole[1], second)]))
    found = renderer(seed=1, sensors=[1, 1], window=torch.tensor([first, second]))
    assert torch.equal(found, torch.stack([cut(whole[1], first), cut(whole[1], second)]))


def test_windows_of_one_size_may_be_of_films_of_several():
    films = [{**FILM, "rfilter": {"type": "box"}}, {**FILM, "crop_width": 9, "rfilter": {"type": "box"}}]
    scene = cornell(torch.float32, sensors={f"camera_{k}": sensor(12, film=film) for k, film in enumerate(films)})
    renderer = rb.Renderer(scene, spp=2)
    with pytest.raises(ValueError, match="must have films of one size"):
        renderer()
    assert torch.equal(renderer(window=(4, 4, 3, 2))[1:], cut(renderer(sensors=1), (4, 4, 3, 2)))


NAMES = ("white.reflectance.value", "light.emitter.radiance.value", "camera_0.to_world", "box.to_world")


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.MemoizedAdjoint(stride=2), rb.TapeAdjoint()], ids=repr)
@pytest.mark.parametrize("share", [False, True], ids=["", "share_samples"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_gradients_are_those_of_the_whole_image_with_a_loss_on_the_same_pixels(rfilter, share, adjoint):
    scene = room(rfilter=rfilter)
    wanted = [scene.get_parameter(name).requires_grad_() for name in NAMES]
    renderer = unwarned_renderer(scene, spp=3, max_depth=3, adjoint=adjoint, share_samples=share, terms=["interior"])
    whole, part = renderer(seed=2), renderer(seed=2, window=WINDOW)
    w = cotangent(part.detach())
    expected = torch.autograd.grad(cut(whole, WINDOW), wanted, w)
    assert_informative(whole.detach(), expected)
    for found, reference in zip(torch.autograd.grad(part, wanted, w), expected):
        assert relative_error(found, reference) < 1e-10


def test_forward_mode_is_the_transpose_of_backward_mode():
    scene = room()
    names = ("white.reflectance.value", "box.to_world")
    tangents = {name: cotangent(scene.get_parameter(name).detach(), 3) for name in names}
    tangents["box.to_world"][3] = 0
    image = rb.jvp(scene, tangents, seed=4, spp=3, max_depth=3, share_samples=True, window=WINDOW)
    w = cotangent(image)
    wanted = [scene.get_parameter(name).requires_grad_() for name in names]
    part = rb.render(scene, seed=4, spp=3, max_depth=3, share_samples=True, window=WINDOW)
    gradients = torch.autograd.grad(part, wanted, w)
    expected = sum(float((gradient * tangents[name]).sum()) for name, gradient in zip(names, gradients))
    assert image.shape == (1, 3, 5, 7) and abs(expected) > 0.01
    assert float((image * w).sum()) == pytest.approx(expected, rel=1e-10)


def test_quantities_of_a_window_are_those_of_the_whole_image():
    names = ["depth", "sh_normal", "hit"]
    scene = room()
    pose = scene.get_parameter("box.to_world").requires_grad_()
    renderer = rb.Renderer(scene, spp=3, max_depth=3, terms=["interior"])
    _, whole = renderer(seed=5, aovs=names)
    image, part = renderer(seed=5, aovs=names, window=WINDOW)
    alone = renderer.aovs(names, seed=5, window=WINDOW)
    assert torch.equal(image, renderer(seed=5, window=WINDOW))
    for name in names:
        torch.testing.assert_close(part[name], cut(whole[name], WINDOW), rtol=1e-13, atol=1e-15)
        torch.testing.assert_close(alone[name], part[name], rtol=1e-13, atol=1e-15)
    w = cotangent(part["depth"].detach())
    expected, found = (torch.autograd.grad(depth, pose, w)[0] for depth in (cut(whole["depth"], WINDOW), part["depth"]))
    assert_informative(whole["depth"].detach(), [expected])
    assert relative_error(found, expected) < 1e-10


def plate_and_lamp(rfilter: str) -> rb.Scene:
    """A plate before a wall, on which its shadow falls."""
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": rfilter}}
    return load(sensor=sensor(16, (0, 0, 4), film=film), wall=rectangle((0, 0, -0.5), 2.0, bsdf=diffuse(0.8, 0.7, 0.6)),
                plate=rectangle((0.1, 0.05, 0.5), 0.4, angle=20, bsdf=diffuse(0.3, 0.5, 0.2)),
                lamp={"type": "point", "position": [1.2, 0.9, 2.5], "intensity": rgb(9, 8, 7)})


PRIMARY, SHADOW = ("primary", (2, 5, 7, 6), 12), ("shadow", (1, 5, 11, 10), 128)


@pytest.mark.parametrize("rfilter, term, window, spp", [("gaussian", *PRIMARY), ("box", *SHADOW), deep("box", *PRIMARY),
                                                        deep("gaussian", *SHADOW)])
def test_edges_and_shadows_add_to_a_window_what_they_add_to_the_whole_image(rfilter, term, window, spp):
    """They are sampled anew, so in the mean over seeds."""
    scene, count, settings = plate_and_lamp(rfilter), 16, {"spp": spp, "max_depth": 2, "terms": [term]}
    shift = torch.zeros(4, 4, dtype=torch.float64)
    shift[0, 3], shift[1, 3] = 1.0, 0.6

    def derivatives(first: int, **part) -> torch.Tensor:
        return torch.stack([rb.jvp(scene, {"plate.to_world": shift}, seed=seed, **settings, **part)[0]
                            for seed in range(first, first + count)])

    whole, part = cut(derivatives(0), window), derivatives(100, window=window)
    assert part.abs().mean() > 0.01
    error = (whole.var(0) + part.var(0)).div(count).sqrt()
    certain = error < 1e-12
    z = ((part.mean(0) - whole.mean(0)) / error.clamp_min(1e-12))[~certain]
    assert torch.equal(part.mean(0)[certain], whole.mean(0)[certain])
    assert len(z) > 20 and z.abs().max() < 5 and z.std() < 1.5
    # Together the pixels say more: a bias of 3% of the sum would be seen.
    sums = [image.sum((1, 2, 3)) for image in (whole, part)]
    spread = float(sum(each.var() for each in sums).div(count).sqrt())
    assert 4 * spread < 0.03 * float(sums[0].mean().abs())
    assert abs(float(sums[0].mean() - sums[1].mean())) < 4 * spread


def test_backward_mode_has_the_edges_and_shadows_of_forward_mode():
    window, scene = (2, 5, 7, 6), plate_and_lamp("gaussian")
    shift = torch.zeros(4, 4, dtype=torch.float64)
    shift[0, 3] = 1.0
    image = rb.jvp(scene, {"plate.to_world": shift}, seed=1, spp=8, max_depth=2, window=window)
    w = cotangent(image)
    pose = scene.get_parameter("plate.to_world").requires_grad_()
    for adjoint in (rb.MemoizedAdjoint(), rb.TapeAdjoint()):
        part = rb.render(scene, seed=1, spp=8, max_depth=2, window=window, adjoint=adjoint)
        gradient, = torch.autograd.grad(part, pose, w)
        assert abs(float(gradient[0, 3])) > 0.1
        assert float((image * w).sum()) == pytest.approx(float(gradient[0, 3]), rel=1e-9)


@pytest.mark.parametrize("rfilter, beside", [("box", 0), ("gaussian", 2)])
def test_a_window_costs_its_own_pixels_and_those_that_the_filter_reaches(rfilter, beside):
    renderer = rb.Renderer(room(rfilter=rfilter), spp=6)

    def lanes(window: tuple[int, int, int, int] | None) -> int:
        return sum(wavefront.lanes for wavefront in renderer.prepare(0, None, None, None, window=window).wavefronts)

    assert lanes(None) == 12 * 12 * 6
    assert lanes((4, 5, 3, 2)) == (3 + 2 * beside) * (2 + 2 * beside) * 6
    assert lanes((0, 0, 3, 2)) == (3 + beside) * (2 + beside) * 6  # beyond the image there are no samples


def test_a_window_is_the_same_however_it_is_divided():
    scene = room(torch.float32)
    images = [rb.Renderer(scene, spp=9, max_depth=3, chunk=chunk)(seed=1, window=WINDOW) for chunk in (None, 64, 200)]
    assert images[0].std() > 0.01 and all(torch.equal(images[0], image) for image in images)


def test_the_memory_plan_is_that_of_the_window():
    renderer = rb.Renderer(room(), spp=8, memory_budget="1GiB")
    assert renderer.memory_plan(window=WINDOW).peak < renderer.memory_plan().peak


@pytest.mark.parametrize("window, words", {
    "outside": ((8, 0, 5, 2), r"5 x 2 pixels at \(8, 0\) must be at least 1 x 1 and lie inside the image of 12 x 12"),
    "negative": ((-1, 0, 5, 2), "lie inside the image of 12 x 12"),
    "empty": ((1, 1, 0, 2), "must be at least 1 x 1"),
    "half a pixel": ((1, 1, 2.5, 2), "width of window must be an integer, got 2.5"),
    "too few": ((1, 1, 2), r"must be \(x, y, width, height\), four integers, got \(1, 1, 2\)"),
    "a number": (3, r"must be \(x, y, width, height\), integers, or a list"),
    "a word": ("left", "window must be"),
    "too many windows": ([(0, 0, 2, 2)] * 3, "or a list of one for each of the 2, got 3"),
    "two sizes": ([(0, 0, 2, 2), (0, 0, 2, 3)], "must have windows of one size"),
    "an array of floats": (np.array([0.0, 0.0, 2.0, 2.0]), "x of window must be an integer"),
}.values(), ids=str)
@pytest.mark.hostile
def test_what_is_no_window_is_refused_with_words(window, words):
    renderer = rb.Renderer(room(cameras=2))
    with pytest.raises(ValueError, match=words):
        renderer(window=window)


@pytest.mark.hostile
def test_a_window_of_an_image_that_is_too_large_to_number_is_refused():
    scene = room()
    scene.sensors[0].film = HDRFilm(width=1 << 16, height=1 << 16)
    with pytest.raises(ValueError, match="must be of an image of at most 2147483647 pixels"):
        rb.Renderer(scene)(window=(0, 0, 4, 4))


def test_what_derivatives_lack_is_said_of_all_windows_at_the_first():
    """A loop over random crops is told at once, whatever the first one shows."""
    scene = plate_and_lamp("box")
    scene.get_parameter("plate.to_world").requires_grad_()
    for term, words in (("shadow", "contribution of silhouettes"), ("primary", "borders of shadows")):
        renderer = rb.Renderer(scene, spp=1, max_depth=2, terms=["interior", term])
        with pytest.warns(rb.SilhouetteWarning, match=f"`plate.to_world` lack .*{words}"):
            renderer(seed=0, window=(0, 0, 2, 2))
