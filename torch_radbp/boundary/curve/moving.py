"""What moves in a scene, with its triangles."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.faces import Faces, joined_faces
from torch_radbp.interface.instances import Instances
from torch_radbp.scene.tables.scene_tensors import SceneTensors

MOST_SHOWN = 1 << 20  # edges of instances of a group that are examined; of more instances some are picked at random


class Moving(NamedTuple):
    """Which shapes and instances move in the view of a camera."""

    shapes: tuple[bool, ...]  # for each shape, those of groups last
    instances: tuple[bool, ...]  # for each instance


def moving_faces(scene: SceneTensors, counts: Sequence[int], moving: Moving, generator: torch.Generator) -> Faces | None:
    """The triangles of all shapes that move, instances included; None: nothing moves. Args as for `Outlines.of`."""
    triangles, firsts = scene.triangles, list(accumulate(counts, initial=0))
    device = triangles.material.device
    instances = triangles.casting_instances
    own = firsts[-1] if instances is None else instances.first_triangle[0]

    def of_shapes(first: int, last: int, which: Sequence[bool]) -> Tensor:
        found = [torch.arange(start, start + count, dtype=torch.int32, device=device)
                 for start, count, moves in zip(firsts, counts, which) if moves and first <= start < last]
        return torch.cat(found) if found else torch.zeros(0, dtype=torch.int32, device=device)

    world = of_shapes(0, own, moving.shapes)
    parts = [Faces(world, None if instances is None else torch.zeros_like(world), None)]
    for group in range(0 if instances is None else len(instances.first_triangle) - 1):
        first, last = instances.first_triangle[group:group + 2]
        members = of_shapes(first, last, (True,) * len(counts))
        everywhere = len(of_shapes(first, last, moving.shapes)) > 0
        chosen, part = chosen_instances(instances, group, moving, everywhere, len(members), generator)
        shows = chosen.to(device, torch.int32) + 1
        share = None if part == 1.0 else torch.full((len(shows) * len(members),), part, dtype=torch.float64, device=device)
        parts.append(Faces(members.repeat(len(shows)), shows.repeat_interleave(len(members)), share))
    return joined_faces([part for part in parts if len(part.triangle)])


def chosen_instances(instances: Instances, group: int, moving: Moving, everywhere: bool, size: int,
                     generator: torch.Generator) -> tuple[Tensor, float]:
    """The moving instances of a group, int64 from 0, a random part of them if there are too many; and the fraction selected.

    Args:
        instances: of all groups.
        group: the index of the group.
        moving: the shapes and instances that move.
        everywhere: whether something in the group moves, and so all instances.
        size: the number of triangles or edges that each instance shows.
        generator: selects instances if there are too many.
    """
    shows = range(*instances.first_instance[group:group + 2])
    wanted = torch.tensor([number for number in shows if everywhere or moving.instances[number]], dtype=torch.int64)
    most = max(1, MOST_SHOWN // max(size, 1))
    if most >= len(wanted):
        return wanted, 1.0
    return wanted[torch.randperm(len(wanted), generator=generator)[:most]], most / len(wanted)
