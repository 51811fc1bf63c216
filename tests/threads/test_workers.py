"""Chunks side by side: on how many threads they are traced, and that results do not depend on it."""

import threading
import time
from collections.abc import Iterable
from types import ModuleType

import pytest
import torch

import torch_radbp as rb
from tests.gradients import assert_informative, image_and_gradients, relative_error
from tests.scenes import CASES
from torch_radbp.adjoint import images
from torch_radbp.call.pixels import Films
from torch_radbp.threads import team
from torch_radbp.threads.workers import in_turns

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

    def share(indices: Iterable[int]) -> tuple[str, int, list[int]]:
        everyone.wait(timeout=60)
        return threading.current_thread().name, torch.get_num_threads(), list(indices)

    results = with_threads(number, lambda: in_turns(7, number, share))
    names = {name for name, _, _ in results}
    assert len(names) == number and threading.current_thread().name in names
    assert [threads for _, threads, _ in results] == [1] * number  # their operations stay on them
    assert [indices for _, _, indices in results] == [list(range(worker, 7, number)) for worker in range(number)]


def test_one_thread_works_alone():
    [name] = with_threads(1, lambda: in_turns(7, 1, lambda share: threading.current_thread().name))
    assert name == threading.current_thread().name


def test_shares_stay_the_same_if_one_thread_takes_them_all(monkeypatch):
    """Sums would otherwise depend on how busy the machine is."""
    monkeypatch.setattr(team.Team, "call", lambda self, task, helpers: None)  # all are busy elsewhere
    assert with_threads(3, lambda: in_turns(7, 3, list)) == [[0, 3, 6], [1, 4], [2, 5]]


def test_an_error_on_a_worker_is_raised():
    def fails(share: Iterable[int]) -> None:
        raise ValueError(f"share {list(share)}")

    with pytest.raises(ValueError, match=r"share \["):
        with_threads(2, lambda: in_turns(4, 2, fails))


def test_after_an_error_no_other_chunk_is_begun():
    """Nothing works on in the background once the call has failed."""
    begun, failed = [], threading.Event()

    def work(share: Iterable[int]) -> None:
        for number in share:
            begun.append(number)
            if number == 0:
                while len(begun) < 2:
                    time.sleep(0.001)
                failed.set()
                raise KeyboardInterrupt
            failed.wait(60)
            time.sleep(0.05)

    with pytest.raises(KeyboardInterrupt):
        with_threads(2, lambda: in_turns(2000, 2, work))
    count = len(begun)
    assert count < 100
    time.sleep(0.1)
    assert len(begun) == count


@pytest.mark.parametrize("name", ["cornell", "textured_lamp", "sky_and_points"])
@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.MemoizedAdjoint("log", keep_hits=False), rb.ReplayAdjoint()],
                         ids=repr)
def test_image_and_gradients_do_not_depend_on_the_number_of_threads(name, adjoint, monkeypatch):
    """Both passes run on workers too; sums in another order differ by rounding."""
    case, seen, torch_threads = CASES[name], {"trace_wavefront": set(), "adjoint": set()}, [1]

    def watch(module: ModuleType | type, called: str) -> None:
        original = getattr(module, called)

        def watched(*arguments, **keywords):
            seen[called].add(threading.current_thread().name)
            while len(seen[called]) < torch_threads[0]:  # so that no thread takes two shares
                time.sleep(0.001)
            return original(*arguments, **keywords)

        monkeypatch.setattr(module, called, watched)

    watch(images, "trace_wavefront")
    watch(Films, "adjoint")

    def results():
        return image_and_gradients(case.scene(), case.parameters, adjoint=adjoint, share_samples=True, **SETTINGS)

    alone, expected = with_threads(1, results)
    assert_informative(alone, expected)
    for number in (2, 3):
        for names in seen.values():
            names.clear()
        torch_threads[0] = number
        image, gradients = with_threads(number, results)
        assert all(len(names) == number for names in seen.values())
        assert relative_error(image, alone) < ROUNDING
        for gradient, wanted in zip(gradients, expected):
            assert relative_error(gradient, wanted) < ROUNDING


def test_a_small_image_is_not_dealt_out():
    """A second thread would spend more on its share of Python than it takes over."""
    renderer = rb.Renderer(CASES["cornell"].scene(), spp=1, max_depth=2)
    assert len(with_threads(4, lambda: renderer.prepare(0, None, None, None)).wavefronts) == 1
    assert len(with_threads(4, lambda: renderer.prepare(0, None, 10_000, None)).wavefronts) >= 4
