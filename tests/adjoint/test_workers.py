"""Chunks side by side: on how many threads they are traced, and that results do not depend on it."""

import threading

import pytest
import torch

import torch_radbp as rb
from tests.gradients import assert_informative, image_and_gradients, relative_error
from tests.scenes import CASES
from torch_radbp.adjoint import function
from torch_radbp.adjoint.workers import in_turns

ROUNDING = 1e-13  # of sums in another order, float64
SETTINGS = {"spp": 4, "max_depth": 4, "rr_depth": 2, "chunk": 40}


def with_threads(number: int, work):
    """What `work()` gives while torch uses `number` threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        return work()
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize("number", [2, 3])
def test_work_is_dealt_out_to_as_many_threads_as_torch_has(number):
    everyone = threading.Barrier(number)  # so that no thread takes two shares

    def share(indices: range) -> tuple[str, int, list[int]]:
        everyone.wait(timeout=60)
        return threading.current_thread().name, torch.get_num_threads(), list(indices)

    results = with_threads(number, lambda: in_turns(7, number, share))
    names = {name for name, _, _ in results}
    assert len(names) == number and threading.current_thread().name not in names
    assert [threads for _, threads, _ in results] == [1] * number  # their operations stay on them
    assert [indices for _, _, indices in results] == [list(range(worker, 7, number)) for worker in range(number)]


def test_one_thread_works_alone():
    [name] = with_threads(1, lambda: in_turns(7, 1, lambda share: threading.current_thread().name))
    assert name == threading.current_thread().name


def test_an_error_on_a_worker_is_raised():
    def fails(share: range) -> None:
        raise ValueError(f"share {share}")

    with pytest.raises(ValueError, match="share range"):
        with_threads(2, lambda: in_turns(4, 2, fails))


@pytest.mark.parametrize("name", ["cornell", "textured_lamp", "sky_and_points"])
@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.MemoizedAdjoint("log", keep_hits=False), rb.ReplayAdjoint()],
                         ids=repr)
def test_image_and_gradients_do_not_depend_on_the_number_of_threads(name, adjoint, monkeypatch):
    """Both passes run on workers; sums in another order differ by rounding."""
    case, seen = CASES[name], {"trace_chunk": set(), "lane_adjoint": set()}

    def watch(called: str) -> None:
        original = getattr(function, called)

        def watched(*arguments, **keywords):
            seen[called].add(threading.current_thread().name)
            return original(*arguments, **keywords)

        monkeypatch.setattr(function, called, watched)

    for called in seen:
        watch(called)

    def results():
        return image_and_gradients(case.scene(), case.parameters, adjoint=adjoint, **SETTINGS)

    alone, expected = with_threads(1, results)
    assert_informative(alone, expected)
    for number in (2, 3):
        for names in seen.values():
            names.clear()
        image, gradients = with_threads(number, results)
        assert all(names and threading.current_thread().name not in names for names in seen.values())
        assert relative_error(image, alone) < ROUNDING
        for gradient, wanted in zip(gradients, expected):
            assert relative_error(gradient, wanted) < ROUNDING


def test_a_small_image_is_not_dealt_out():
    """A second thread would spend more on its share of Python than it takes over."""
    renderer = rb.Renderer(CASES["cornell"].scene(), spp=1, max_depth=2)
    assert len(with_threads(4, lambda: renderer.prepare(0, None, None, None)).chunks) == 1
    assert len(with_threads(4, lambda: renderer.prepare(0, None, 1000, None)).chunks) >= 4
