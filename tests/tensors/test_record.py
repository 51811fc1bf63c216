"""Records of nested tuples: leaves counted as torch's own `pytree` counts them."""

from typing import NamedTuple

import torch
from torch.utils._pytree import tree_flatten

from torch_radbp.tensors.record import leaves_of, mapped, tensors_in, with_leaves


class Pair(NamedTuple):
    a: object
    b: object


RECORD = Pair((torch.tensor(1.0), None, ()), Pair("name", (Pair(2, 3.5),)))


def test_leaves_are_those_of_pytree():
    assert leaves_of(RECORD) == tree_flatten(RECORD)[0] and len(leaves_of(RECORD)) == 5


def test_a_record_with_other_leaves_has_the_same_structure():
    found = with_leaves(RECORD, range(5))
    assert found == Pair((0, 1, ()), Pair(2, (Pair(3, 4),))) and type(found.b) is Pair
    assert with_leaves(RECORD, leaves_of(RECORD)) == RECORD and with_leaves(7, [8]) == 8


def test_tensors_are_the_leaves_that_are_some():
    weight = torch.nn.Parameter(torch.ones(2))
    record = {"first": RECORD, "then": [weight, None, RECORD.a[0]]}
    assert [id(tensor) for tensor in tensors_in(record)] == [id(tensor) for tensor in (RECORD.a[0], weight, RECORD.a[0])]
    assert tensors_in(weight)[0] is weight and tensors_in(None) == []


def test_mapped_records_have_the_same_structure():
    found = mapped({"first": RECORD, "then": [1, (2, None)]}, lambda leaf: leaf is None)
    assert found == {"first": Pair((False, True, ()), Pair(False, (Pair(False, False),))), "then": [False, (False, True)]}
    assert type(found["first"].b) is Pair
