"""A call for which memory does not suffice is done once more, in smaller pieces, and says so in one line."""

import warnings

import pytest
import torch

import torch_radbp as rb
from tests.gradients import cotangent
from tests.scenes import cornell
from torch_radbp.adjoint import function, images
from torch_radbp.call.chunks import Chunk, LaneRange, Rows
from torch_radbp.call.less_memory import halves_of, in_halves
from torch_radbp.call.wavefronts import Wavefront

SIDE, SPP = 12, 16
PATHS = SIDE * SIDE * SPP


class Small:
    """A device on which so many paths fit at a time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, forward: int, backward: int = PATHS):
        self.traced: list[int] = []
        for module, name, most in ((images, "trace_wavefront", forward), (function, "record_wavefront", backward)):
            monkeypatch.setattr(module, name, self.bounded(getattr(module, name), most))

    def bounded(self, trace, most: int):
        def traced(call, integrand, wavefront, *more, **named):
            if wavefront.lanes > most:
                raise torch.OutOfMemoryError("CUDA out of memory")
            self.traced.append(wavefront.lanes)
            return trace(call, integrand, wavefront, *more, **named)

        return traced


def rendered(**settings) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """An image, whose samples and those of its derivative are traced apart, and gradients."""
    scene = cornell(torch.float64, SIDE)
    wanted = {name: value.requires_grad_() for name, value in scene.named_parameters() if name.endswith("reflectance.value")}
    renderer = rb.Renderer(scene, spp=SPP, max_depth=4, terms=("interior",),
                           **{"chunk": PATHS, "adjoint": rb.MemoizedAdjoint(2)} | settings)
    image = renderer(seed=2)
    gradients = torch.autograd.grad(image, list(wanted.values()), cotangent(image.detach()))
    return image.detach(), dict(zip(wanted, gradients))


@pytest.mark.parametrize("forward, backward, lines, settings", [
    (PATHS // 4, PATHS, 1, {}), (PATHS, PATHS // 4, 1, {}), (PATHS // 4, PATHS // 12, 2, {}),
    (PATHS // 4, PATHS, 1, {"share_samples": True}), (PATHS, PATHS // 4, 1, {"compile": False})], ids=str)
def test_images_and_gradients_are_those_of_a_larger_memory(forward, backward, lines, settings, monkeypatch):
    image, gradients = rendered(**settings)
    small = Small(monkeypatch, forward, backward)
    with pytest.warns(UserWarning, match=r"not enough memory on cpu for 2,304 paths.*Renderer\(chunk=576\)") as said:
        found, others = rendered(**settings)
    assert len([each for each in said if "memory" in str(each.message)]) == lines  # of each pass one
    assert torch.equal(found, image) and image.std() > 0 and PATHS // 4 in small.traced
    for name, gradient in gradients.items():
        assert gradient.abs().max() > 1e-3
        torch.testing.assert_close(others[name], gradient, rtol=1e-12, atol=0)


def test_it_is_tried_once(monkeypatch):
    Small(monkeypatch, PATHS // 8)
    with warnings.catch_warnings(), pytest.raises(torch.OutOfMemoryError):
        warnings.simplefilter("ignore")
        rendered()


def test_nothing_is_said_where_memory_suffices(monkeypatch):
    Small(monkeypatch, PATHS)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rendered()


def lanes_of(chunk: Chunk) -> set[tuple[int, int]]:
    """The rows and samples of a chunk."""
    return {(chunk.rows.first + row * chunk.rows.apart, chunk.first_sample + sample)
            for row in range(chunk.rows.count) for sample in range(chunk.samples)}


@pytest.mark.parametrize("chunk", [Chunk(0, Rows(3, 7, 2, 5), 0, 16, range(20), 0),
                                   Chunk(0, Rows(3, 1, 1, 5), 8, 24, range(20), 0),
                                   Chunk(0, Rows(3, 2, 4, 5), 0, 3, range(20), 0)])
def test_halves_of_a_chunk_are_its_rows_or_its_samples(chunk):
    first, second = halves_of(chunk)
    assert lanes_of(first).isdisjoint(lanes_of(second)) and lanes_of(first) | lanes_of(second) == lanes_of(chunk)
    assert first.lanes + second.lanes == chunk.lanes and max(first.lanes, second.lanes) <= 0.7 * chunk.lanes


def test_what_is_small_stays_and_several_chunks_are_parted():
    small, lamps = Chunk(0, Rows(3, 1, 1, 5), 0, 8, range(20), 0), LaneRange(10, 7)
    assert list(halves_of(small)) == [small] and list(halves_of(lamps)) == [LaneRange(10, 3), LaneRange(13, 4)]
    assert in_halves([Wavefront((small, small, small))]) == [Wavefront((small,)), Wavefront((small, small))]
