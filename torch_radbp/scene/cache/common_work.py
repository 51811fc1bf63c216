"""Work that several renderings have in common: those of the same values, by the same random numbers, with other tangents.

Each column of a Jacobian is a rendering in forward mode. What paths meet, and the places at which images jump, depend on
values alone; what differs is how all that changes. Inside of `CommonWork.shared` the first rendering does such work, and the
others take its results, if all that these depend on is the same, bit by bit.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

from torch import Tensor

from torch_radbp.scene.cache.same_bits import same_bits
from torch_radbp.tensors.record import leaves_of

Result = TypeVar("Result")

MOST = 8  # results of one kind that are kept: of so many renderings, such as those of several sensors


class Facts:
    """The tensors and values on which a result depends; renderings that share work have one object for equal ones.

    Args:
        leaves: of a record.
    """

    def __init__(self, leaves: list):
        self.leaves = leaves

    @staticmethod
    def of(record: Any) -> Facts:
        """The facts on which a result depends, from a record of detached tensors and comparable values."""
        common, facts = COMMON.get(), Facts(leaves_of(record))
        return facts if common is None else common.known(facts)


class CommonWork:
    """Results that renderings of the same parameter values share; whoever changes values in place takes a new one."""

    def __init__(self) -> None:
        self.facts: list[Facts] = []
        self.results: dict[Hashable, list[tuple[list, Any]]] = {}  # by kind; what each depends on, and the result

    def known(self, facts: Facts) -> Facts:
        """The `Facts` object seen before that equals these facts, or else these facts."""
        for other in self.facts:
            if same_leaves(other.leaves, facts.leaves):
                return other
        self.facts.append(facts)
        del self.facts[:-MOST]
        return facts

    @contextmanager
    def shared(self) -> Iterator[None]:
        """A context in which renderings of this thread share their work by `once`."""
        token = COMMON.set(self)
        try:
            yield
        finally:
            COMMON.reset(token)


COMMON: ContextVar[CommonWork | None] = ContextVar("COMMON", default=None)


def once(kind: Hashable, depends_on: Callable[[], Any], make: Callable[[], Result]) -> Result:
    """The result of `make()`, or what it returned in another rendering that shares its work with this one.

    Args:
        kind: a key for what is computed.
        depends_on: returns a record of all else that the result depends on: detached tensors, comparable values, and
            `Facts`. Not called where nothing is shared.
        make: computes it, without derivatives.
    """
    common = COMMON.get()
    if common is None:
        return make()
    facts, known = leaves_of(depends_on()), common.results.setdefault(kind, [])
    for others, result in known:
        if same_leaves(facts, others):
            return result
    result = make()
    known.append((facts, result))
    del known[:-MOST]
    return result


def same_leaves(leaves: list, others: list) -> bool:
    """True if the leaves of two records are the same, tensors by their bits."""
    return len(leaves) == len(others) and all(map(alike, leaves, others))


def alike(a: Any, b: Any) -> bool:
    """True if two leaves of records are the same, tensors by their bits."""
    if a is b:
        return True
    if isinstance(a, Tensor) and isinstance(b, Tensor):
        return (a.data_ptr() == b.data_ptr() and a.shape == b.shape and a.stride() == b.stride() and a.dtype == b.dtype
                or same_bits(a, b))
    return type(a) is type(b) and bool(a == b)
