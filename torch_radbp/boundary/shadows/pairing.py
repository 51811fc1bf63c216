"""Which edges are looked at from which points: as many pairs of each body, so that few edges are seen from many points."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.lookup import lookup
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sampling.sampler import SampleKey, fine_unit, hash32
from torch_radbp.vec import TINY, rows

FEWEST_EYES = 16  # that look at a body


class Bodies(NamedTuple):
    """B shapes, and how they are looked at; (B,) each."""

    first: Tensor  # int32, where their edges begin in `Pairing.edges`
    edges: Tensor  # int32, how many they have
    stride: Tensor  # int32, of how many edges that follow each other an eye looks at one
    seeing: Tensor  # int32, how many eyes look at them
    pair: Tensor  # int32, the first of their pairs: those of an edge together
    eyes: Tensor  # float64, of how many eyes one looks
    start: Tensor  # float64, which is the first, of those
    times: Tensor  # float64, for how many pairs each stands


class Pairing(NamedTuple):
    """Which edges each eye looks at: P pairs, of each body about as many, so that few edges are seen by many eyes."""

    extent: Tensor  # () of the scene, float64
    seed: Tensor  # () int32
    last: Tensor  # () float64, number of the last eye
    body: Tensor  # (P,) int32
    bodies: Bodies
    edges: Tensor  # (E,) int32, in the order of their bodies

    def __call__(self, pair: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Edges and eyes of pairs, (N,) int32; whether there is such an edge, (N,) bool; and `Bodies.times`."""
        body = lookup(self.body, pair)
        own = rows(self.bodies, body)
        look = torch.div(pair - own.pair, own.seeing, rounding_mode="floor")
        turn = pair - own.pair - look * own.seeing
        place = look * own.stride + (hash32(turn ^ hash32(body + self.seed)) & 0x7FFFFFFF) % own.stride
        eye = torch.minimum(torch.floor((turn.double() + own.start) * own.eyes), self.last).to(torch.int32)
        edge = lookup(self.edges, own.first + torch.minimum(place, own.edges - 1))
        return edge, eye, place < own.edges, own.times


def pairing_of(extent: Tensor, body: Tensor, eyes: int, seed: SampleKey, examined: int) -> Pairing:
    """Which edges eyes look at.

    Args:
        extent: () of the scene.
        body: (E,) int32, whose edges they are.
        eyes: how many.
        seed: of the random numbers.
        examined: pairs, about.
    """
    present, body = torch.unique(body, return_inverse=True)
    edges = torch.bincount(body)
    level = filled_to(edges.double() * eyes, float(examined))
    seeing = torch.floor(level / edges).clamp(min(FEWEST_EYES, eyes), eyes)
    stride = torch.ceil(seeing * edges / level).clamp_min(1)
    looks = torch.ceil(edges / stride)
    pairs = (seeing * looks).long()
    start = fine_unit(hash32(hash32(present.to(torch.int32)) ^ seed.seed))
    first, pair = (torch.cat([part.new_zeros(1), part.cumsum(0)[:-1]]) for part in (edges, pairs))
    whole = [column.to(torch.int32) for column in (first, edges, stride, seeing, pair)]
    return Pairing(extent.clamp_min(TINY), seed.seed, torch.full_like(start[0], eyes - 1),
                   torch.repeat_interleave(pairs).to(torch.int32),
                   Bodies(*whole, eyes / seeing, start, stride * (eyes / seeing)), body.argsort(stable=True).to(torch.int32))


def filled_to(wanted: Tensor, supply: float) -> Tensor:
    """() how much each may have at most, so that together they have no more than there is; `wanted`: (B,) float64."""
    ascending = wanted.sort().values
    left = supply - (running_sum(ascending) - ascending)  # if all that want less have what they want
    levels = left / torch.arange(len(wanted), 0, -1, device=wanted.device)
    enough = levels >= ascending
    return torch.where(enough.all(), ascending[-1], levels[(~enough).int().argmax()])
