"""What a run has recovered as the leaves that `rb.covariance` asks for: values themselves, and motions of poses."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.optim.linearisation import Images
from torch_radbp.training.recovery.gains import NAME as GAINS
from torch_radbp.training.recovery.gains import RecoveredGains
from torch_radbp.training.recovery.problem import Recovery
from torch_radbp.training.recovery.recovered import RecoveredParameter
from torch_radbp.training.recovery.rigid import COMPONENTS, moved


class PlainValues(NamedTuple):
    """Leaves, and the images as a function of them.

    Attributes:
        leaves: by name, in the order of the parameters; of a pose six numbers, rotations in degrees, of gains those of
            views that are not fixed.
        images: (B, 3, H, W) of all targets' sensors, by seed and samples per pixel, attached to the leaves.
    """

    leaves: dict[str, Tensor]
    images: Images

    def leaves_of(self, name: str) -> dict[str, Tensor]:
        """Those of one parameter."""
        parts = f"{name}:", f"{name}["
        return {each: leaf for each, leaf in self.leaves.items() if each == name or each.startswith(parts)}


class Motion(nn.Module):
    """Moves a (4, 4) pose about its own origin by six numbers of their own, three angles in degrees and a translation."""

    def __init__(self, like: Tensor):
        super().__init__()
        self.numbers = nn.ParameterList([nn.Parameter(like.new_zeros(())) for _ in COMPONENTS])

    def forward(self, pose: Tensor) -> Tensor:
        numbers = torch.stack(list(self.numbers))
        return moved(pose, numbers[:3] * (math.pi / 180.0), numbers[3:])


@contextmanager
def plain_values(recovery: Recovery, chosen: Sequence[RecoveredParameter]) -> Iterator[PlainValues]:
    """The plain values of some parameters, which must be settled: see `RecoveredParameter.settle`.

    The scene is the same before and after, to the bit.
    """
    views = list(range(len(recovery.targets.names)))
    leaves: dict[str, Tensor] = {}
    poses: list[RecoveredParameter] = []
    gains: Tensor | None = None
    try:
        for each in chosen:
            if each.is_pose:
                motion = Motion(each.raw)
                parametrize.register_parametrization(each.module, each.attribute, motion)
                poses.append(each)
                leaves |= {f"{each.name}:{key}": leaf for key, leaf in zip(COMPONENTS, motion.numbers, strict=True)}
            elif isinstance(each, RecoveredGains):
                gains = each.value.clone()
                free = [view for view in views if view != each.module.fixed]
                numbers = [[row.clone() for row in gains[view].reshape(-1)] for view in free]
                for view, row in zip(free, numbers, strict=True):
                    names = [""] if len(row) == 1 else ["[0]", "[1]", "[2]"]
                    leaves |= {f"{GAINS}[{recovery.targets.names[view]}]{name}": leaf
                               for name, leaf in zip(names, row, strict=True)}
            else:
                leaves[each.name] = each.raw

        def images(seed: int, spp: int | None) -> Tensor:
            rendered = recovery.renderer(seed=seed, spp=spp, sensors=recovery.targets.sensors)
            if gains is None:
                return recovery.exposed(rendered, views)
            rows = dict(zip(free, (torch.stack(row) for row in numbers), strict=True))
            factors = [rows[view] if view in rows else gains[view].reshape(-1) for view in views]
            return rendered * torch.stack(factors)[:, :, None, None]

        yield PlainValues(leaves, images)
    finally:
        for each in poses:
            parametrize.remove_parametrizations(each.module, each.attribute, leave_parametrized=False)
            each.raw.requires_grad_(False)
