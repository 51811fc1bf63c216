"""Graphs of sequences of launches are those of the very same words, and the memory of sequences comes back in order."""

import pytest
import torch

from tests.jit.emulated import emulated
from torch_radbp.jit.nvidia import graphs
from torch_radbp.jit.nvidia.graphs import Graphs, SequenceMemory
from torch_radbp.tensors.torch_internals import holders

CPU = torch.device("cpu")


def test_a_graph_is_made_when_words_come_for_the_second_time_and_kept():
    made, known = [], Graphs()

    def make() -> str:
        made.append(1)
        return f"graph {len(made)}"

    assert [known.of(words, make) for words in (b"a", b"b", b"a", b"a", b"b", b"c")] == [
        None, None, "graph 1", "graph 1", "graph 2", None]


def test_a_graph_that_cannot_be_made_is_not_tried_again():
    asked, known = [], Graphs()
    assert [known.of(b"a", lambda: asked.append(1)) for _ in range(4)] == [None] * 4 and len(asked) == 1


def test_the_words_that_came_last_are_known(monkeypatch):
    monkeypatch.setattr(graphs, "MOST_GRAPHS", 2)
    known = Graphs()
    for words in (b"a", b"b", b"a", b"c"):  # "b" is forgotten
        known.of(words, lambda: "graph")
    assert known.of(b"a", lambda: "another") == "graph" and known.of(b"b", lambda: "another") is None


def test_torch_tells_who_holds_memory():
    """Views count, and what is freed does not: blocks are handed out again by that."""
    block = torch.empty(8, dtype=torch.uint8).untyped_storage()
    assert holders(block) == 1
    tensor = torch.empty(0, dtype=torch.uint8).set_(block)
    view = tensor.view(torch.int32)[1:]
    assert holders(block) > 2
    del tensor
    assert holders(block) > 1
    del view
    assert holders(block) == 1


def test_blocks_that_nobody_holds_are_handed_out_in_the_same_order():
    memory = SequenceMemory()

    def step() -> list[int]:
        kept = [memory.room(1024, 0, CPU)]
        for _ in range(3):
            kept.append(memory.room(1024, 0, CPU)[:10])
            memory.room(64, 0, CPU)  # free again at once
        return [tensor.data_ptr() for tensor in kept] + [memory.room(64, 0, CPU).data_ptr()]

    first = step()
    assert len(set(first)) == 5 and step() == step() == first and memory.bytes == 4 * 1024 + 64


def test_streams_do_not_share_blocks():
    memory = SequenceMemory()
    first = memory.room(1024, 0, CPU).data_ptr()
    assert memory.room(1024, 7, CPU).data_ptr() != first == memory.room(1024, 0, CPU).data_ptr()


def test_no_more_is_kept_than_said(monkeypatch):
    monkeypatch.setattr(graphs, "MOST_BYTES", 3000)
    memory = SequenceMemory()
    held = [memory.room(1000, 0, CPU) for _ in range(5)]
    assert memory.bytes == 3000 and len({tensor.data_ptr() for tensor in held}) == 5
    del held[0]
    other = memory.room(2000, 0, CPU)  # what is free is given back, and still there is no room for it
    assert memory.bytes == 2000 and len(other) == 2000
    held.clear()
    assert memory.room(2000, 0, CPU).data_ptr() and memory.bytes == 2000


def test_where_torch_does_not_tell_who_holds_memory_none_is_kept(monkeypatch):
    monkeypatch.setattr(graphs, "holders", lambda storage: 0)
    memory = SequenceMemory()
    held = [memory.room(100, 0, CPU) for _ in range(2)]
    assert memory.bytes == 0 and held[0].data_ptr() != held[1].data_ptr()


@pytest.mark.parametrize("lanes, most", [(1 << 16, True), ((1 << 16) + 1, False)])
def test_sequences_of_many_lanes_have_no_graphs(lanes, most):
    assert emulated().comes_again(lanes) == most
