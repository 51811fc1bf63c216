"""Silhouettes by testing all edges from light samples, instead of sampling a tree.

A way down a tree (`edge_tree.py`) ends at a silhouette or at none, by chances that only roughly follow the angles under
which silhouettes are seen. Light samples look at the whole scene: where edges are few beside them, it costs less to try each
edge from several, and what is found then counts by its angle alone.

From small lights most edges are silhouettes nowhere, and few nearly everywhere. Each edge is tried from some light samples
first. They only tell which edges are worth trying from many others: were they to count, edges that they miss would count too
little. Neighbours of silhouettes are worth it too: they are silhouettes now and then, and what is found rarely counts much.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edge_order import GROUP
from torch_radbp.boundary.curve.geometry import Geometry
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.eye.edge_tree import numbers_to
from torch_radbp.boundary.eye.eyes import Eyes
from torch_radbp.boundary.eye.seen_edges import angle_seen
from torch_radbp.boundary.eye.ways_down import STEPS, PickedEdges
from torch_radbp.jit.order import chosen
from torch_radbp.sampling.sampler import SampleKey, fine_unit, hash32
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import rows

FEWEST = 32  # eyes from which each edge is tried: of less, those few tell nothing that are to tell which edges are worth it
FIRST = 1 / 8  # share of what is tried by which one tells which edges are silhouettes,
SEEN, CLOSE, OTHER = 3 / 8, 3 / 8, 1 / 8  # and shares of these, of their neighbours, and of all others
SALT = 0x3C9A5B71  # tells the random numbers of the first from others


def eyes_for_each(outline: Outline, eyes: Eyes, looks: int) -> int:
    """The number of viewpoints from which each edge can be tested at the cost of descents of a tree; 0: too few to do so."""
    count = len(eyes.w)
    each = min(count, looks * GROUP * count // len(outline.crease))
    return each if each >= min(FEWEST, count) else 0


class EyesOfEdge(NamedTuple):
    """The number of viewpoints that test an edge; () int32 each."""

    each: Tensor  # successive ones
    count: Tensor  # of all


class Tried(NamedTuple):
    """Tests of edges from viewpoints: whether they are silhouettes there; N tests."""

    eye: Tensor  # (N,) int32, viewpoint
    angle: Tensor  # (N,) float64, angle that the edge subtends; 0: no silhouette


def edges_tried(stages: Stages, geometry: Geometry, outline: Outline, eyes: Eyes, seed: SampleKey, each: int,
                extent: Tensor) -> tuple[PickedEdges, Tensor]:
    """Finds silhouettes by testing all edges from light samples: the edges, and their viewpoints, (K,) int32.

    Args:
        stages, geometry, eyes, seed: as for `seen_edges.places_seen`.
        outline: the edges.
        each: the mean number of viewpoints, successive ones, that test an edge.
        extent: () of the scene.
    """
    def found_from(edges: Tensor, each: int, seed: SampleKey) -> tuple[PickedEdges, Tensor]:
        lane, count = numbers_to(each * len(edges), eyes.w), len(eyes.w)
        pairing = EyesOfEdge(*(torch.full((), value, dtype=torch.int32, device=lane.device) for value in (each, count)))
        tried = stages(edge_tried)(geometry, outline, eyes, edges, seed, pairing, extent, lane)
        kept = chosen(tried.angle > 0.0)
        (eye, angle), edge = rows(tried, kept), rows(edges, torch.div(kept, each, rounding_mode="floor"))
        return PickedEdges(edge, torch.full_like(angle, count / each), angle), eye

    edges, ways = numbers_to(len(outline.crease), eyes.w), each * len(outline.crease)
    if each == len(eyes.w):
        return found_from(edges, each, seed)
    pilot, _ = found_from(edges, int(each * FIRST), seed._replace(seed=hash32(seed.seed ^ SALT)))
    seen = torch.zeros_like(edges, dtype=torch.bool)
    seen[pilot.edge.long()] = True
    close = close_to(geometry, outline, pilot.edge)
    likely = [(edges[own], share) for own, share in ((seen, SEEN), (close & ~seen, CLOSE), (~close, OTHER))]
    return joined([found_from(own, min(len(eyes.w), max(1, int(share * ways / len(own)))), seed)
                   for own, share in likely if len(own)])


def close_to(geometry: Geometry, outline: Outline, found: Tensor) -> Tensor:
    """(E,) bool: edges that share a vertex with one of those in `found`, (K,) int32."""
    touched = torch.zeros(len(geometry.triangles.vertices.p.x), dtype=torch.bool, device=found.device)
    for end in outline.edges[:2]:
        touched[rows(end, found).long()] = True
    return rows(touched, outline.edges.a) | rows(touched, outline.edges.b)


@stage("geometry", "outline", "eyes", "edges")
def edge_tried(geometry: Geometry, outline: Outline, eyes: Eyes, edges: Tensor, seed: SampleKey, pairing: EyesOfEdge,
               extent: Tensor, lane: Tensor) -> Tried:
    """Tests whether edges are silhouettes as seen from viewpoints.

    Args:
        geometry, outline, extent: as for `seen_edges.angle_seen`.
        eyes: the viewpoints.
        edges: (K,) int32, the edges that are tested.
        seed: of random numbers.
        pairing: the number of viewpoints that test an edge.
        lane: (N,) int32, that number times the index into `edges`, plus the number of the viewpoint among those of the edge.
    """
    each, count = pairing
    place = torch.div(lane, each, rounding_mode="floor")
    edge = rows(edges, place)
    first = (fine_unit(edge * STEPS[0] + hash32(seed.seed)) * count).floor().to(torch.int32)
    eye = first.clamp_max(count - 1) + (lane - place * each)
    eye = eye - count * (eye >= count).to(torch.int32)
    return Tried(eye, angle_seen(geometry, outline, edge, rows(eyes, eye), extent))
