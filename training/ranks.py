"""The processes of a run under torchrun: which part of a step each renders, and how their gradients become one.

    torchrun --nproc-per-node 2 -m torch_radbp.training.cli optimize RECIPE

Each process has the whole scene and an optimiser of its own; since all apply the same averaged gradient, their parameters
stay the same. If there are at least as many views as processes, each renders some of the views, and the run is that of one
process but for the order of sums. Otherwise each renders all views with random numbers of its own: the gradient is the mean
over as many times the samples.

Gradients travel as float64 in one message a step, by gloo, from and to the memory of the host.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any, NamedTuple, TypeVar

import torch
import torch.distributed as dist
from torch import Tensor

Result = TypeVar("Result")

# How long a process waits for the others, while the first renders images for the report, say. One that has ended is noticed
# at once.
PATIENCE = timedelta(hours=12)


class RankError(RuntimeError):
    """Another process of the run has ended or cannot be reached."""


class Share(NamedTuple):
    """The part of a step that a process renders."""

    views: list[int]  # numbers of targets
    weight: float  # of its gradient; the weights of all processes sum to 1
    number: int  # of its random numbers, among `count`
    count: int


class Ranks(NamedTuple):
    """The processes of a run, seen from one of them; by default it is alone."""

    number: int = 0
    count: int = 1

    @property
    def is_first(self) -> bool:
        """True of the process that prints and writes."""
        return self.number == 0

    def share(self, views: int) -> Share:
        """The part of a step with this many views that this process renders."""
        if views < self.count:
            return Share(list(range(views)), 1.0 / self.count, self.number, self.count)
        own = list(range(self.number, views, self.count))
        return Share(own, len(own) / views, 0, 1)

    def sums(self, tensors: Sequence[Tensor]) -> list[Tensor]:
        """The sums of tensors over all processes, each with the shape, dtype and device of its own.

        Raises:
            RankError: a process has ended.
        """
        if self.count == 1:
            return list(tensors)
        message = torch.cat([tensor.detach().reshape(-1).to("cpu", torch.float64) for tensor in tensors])
        with exchanging(self):
            dist.all_reduce(message)
        parts = message.split([tensor.numel() for tensor in tensors])
        return [part.view(tensor.shape).to(tensor) for part, tensor in zip(parts, tensors)]

    def from_first(self, make: Callable[[], Result]) -> Result:
        """What `make()` gives in the first process, in all of them; an error that it raises is raised in all.

        Raises:
            RankError: a process has ended.
        """
        if self.count == 1:
            return make()
        found: list[Any] = [None, None]
        if self.is_first:
            try:
                found[0] = make()
            except Exception as error:
                found[1] = error
        with exchanging(self):
            dist.broadcast_object_list(found, src=0, device=torch.device("cpu"))
        if found[1] is not None:
            raise found[1]
        return found[0]


ALONE = Ranks()


@contextmanager
def exchanging(ranks: Ranks) -> Iterator[None]:
    """Says which process waited in vain if one has ended."""
    try:
        yield
    except RuntimeError as error:
        raise RankError(f"process {ranks.number} of {ranks.count} lost another one, which has ended or cannot be reached "
                        f"({str(error).splitlines()[0]})") from error


@contextmanager
def joined() -> Iterator[Ranks]:
    """The processes that torchrun has started, connected; without torchrun this one alone.

    None leaves before all have come to the end, or have failed: the first, which writes the report, is the last to come.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Ranks()
        return
    dist.init_process_group("gloo", timeout=PATIENCE)
    try:
        yield Ranks(dist.get_rank(), dist.get_world_size())
        with suppress(RuntimeError):  # whoever has ended is not waited for
            dist.barrier()
    finally:
        dist.destroy_process_group()


def on_this_machine() -> int:
    """The number of processes of the run that share the memory of this machine."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
