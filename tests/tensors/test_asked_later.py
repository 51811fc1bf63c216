"""Questions to a device wait for each other; what is presumed is found out in the end, and done again if it was wrong."""

import pytest
import torch

from tests.rendering.host import exchanges
from torch_radbp.jit.recording.repetitions import LearntRepetitions, Repetitions, read_together
from torch_radbp.tensors.asked_later import (
    Mistaken,
    Presumptions,
    answered,
    asked_later,
    asked_together,
    presumed,
    presuming,
)

ONE, TWO, FOUR = torch.tensor([1.0]), torch.tensor([2.0, 3.0]), torch.tensor(4.0)
FLAGS = {truth: torch.tensor(truth) for truth in (True, False)}


def test_questions_are_asked_at_once_unless_somebody_will_ask():
    heard: list[list[float]] = []
    counted = exchanges(lambda: asked_later(TWO, heard.append))
    assert heard == [[2.0, 3.0]] and sum(counted.values()) == 1


def test_questions_of_all_contexts_are_asked_together():
    heard: list[list[float]] = []

    def ask() -> None:
        with asked_together():
            asked_later(ONE, heard.append)
            with asked_together():
                asked_later(TWO, heard.append)
                assert not heard and answered([FOUR]) == [4.0]
                assert heard == [[1.0], [2.0, 3.0]]

    assert sum(exchanges(ask).values()) == 1


def test_what_is_done_once_more_is_asked_once_more_and_what_is_around_it_is_not():
    inner: list[list[float]] = []
    outer: list[list[float]] = []
    learnt = LearntRepetitions()

    def work(some: Repetitions) -> int:
        asked_later(TWO, inner.append)
        some.left.append(torch.tensor([int(some.most < 10)]))
        assert read_together([torch.tensor(True)], some)
        return some.most

    def ask() -> None:
        with asked_together():
            asked_later(ONE, outer.append)
            assert learnt.enough(work) == 15

    exchanges(ask)
    assert outer == [[1.0]] and inner == [[2.0, 3.0]]  # those of the two tries in vain are of no use


@pytest.mark.parametrize("truth", [True, False])
def test_what_is_presumed_is_found_out_in_the_end(truth):
    forgotten: list[bool] = []
    tried: list[tuple[bool, bool]] = []
    presumptions = Presumptions()

    def work() -> bool:
        tried.append((presuming(), presumed(FLAGS[truth], True)))
        return tried[-1][1]

    def ask() -> None:
        assert presumptions.tried(work, lambda: forgotten.append(True)) == truth

    waits = sum(exchanges(ask).values())
    assert presumptions.mistaken != truth and len(forgotten) == (not truth)
    assert tried == ([(True, True)] if truth else [(True, True), (False, False)]) and waits == len(tried)
    exchanges(ask)
    assert tried[-1] == (truth, truth)  # who was mistaken asks from then on
    assert not presuming()


def test_on_the_processor_nothing_needs_to_be_presumed():
    assert not Presumptions().tried(lambda: presumed(FLAGS[False], True), lambda: None)


def test_an_error_that_follows_from_another_one_is_told_by_that():
    def bad(numbers: list[float]) -> None:
        raise ValueError(f"it is {numbers[0]:g}")

    def work() -> None:
        asked_later(ONE, bad)
        raise RuntimeError("something else")

    def ask() -> None:
        with pytest.raises(ValueError, match="it is 1"):
            Presumptions().tried(work, lambda: None)

    exchanges(ask)


def test_a_mistake_is_no_error_for_the_caller():
    def work() -> int:
        if presuming():
            raise Mistaken
        return 1

    assert Presumptions().tried(work, lambda: None) == 1
