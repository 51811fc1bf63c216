"""A scene parameter that is recovered: its values and leaves, and what metrics and reports say of it."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.training import recipe_parameter as recipe
from torch_radbp.training.recovery.rigid import PoseError, components
from torch_radbp.training.recovery.variables import original, refine_to, replace
from torch_radbp.training.recovery.volume_picture import volume_picture


@dataclass
class RecoveredParameter:
    """One tensor of the scene that the optimiser changes.

    Attributes:
        name: as in `scene.named_parameters()`.
        module: the plugin that holds it.
        attribute: its name there.
        spec: the recipe's table.
        before: its initial value, detached.
        truth: its true value where one is known; only reports look at it.
        stand_in: what the scene has instead of the plugin, a network; None: the plugin itself.
    """

    name: str
    module: nn.Module
    attribute: str
    spec: recipe.Parameter
    before: Tensor
    truth: Tensor | None
    stand_in: nn.Module | None = None

    @property
    def attached(self) -> Tensor:
        """The current value as the renderer sees it, attached to what the optimiser changes."""
        return getattr(self.module, self.attribute)

    @property
    def value(self) -> Tensor:
        """The current value, detached."""
        with torch.no_grad():
            return self.attached.detach().clone()

    @property
    def raw(self) -> nn.Parameter:
        """The leaf that the optimiser changes."""
        return original(self.module, self.attribute)

    @property
    def leaves(self) -> dict[str, nn.Parameter]:
        """All leaves that the optimiser changes, by the names that they have in checkpoints."""
        return {self.name: self.raw}

    @property
    def held(self) -> dict[str, Tensor]:
        """The tensors of a checkpoint: the leaves, and the map beneath a grid that is coarse."""
        tensors = {name: leaf.detach() for name, leaf in self.leaves.items()}
        return tensors | ({} if self.spec_of_grid is None else {f"{self.name}:base": self.grid.base})

    def held_at(self, step: int) -> dict[str, Tensor]:
        """What `held` is like after `step` steps: tensors on the device `meta`."""
        tensors = {name: value.to("meta") for name, value in self.held.items()}
        if self.spec_of_grid is not None:
            tensors[self.name] = self.raw.new_empty(*self.cells(step), self.before.shape[-1], device="meta")
        return tensors

    @property
    def spec_of_grid(self) -> recipe.CoarseToFine | None:
        """The recipe's table of a map that is optimised coarse to fine."""
        return self.spec.coarse_to_fine

    @property
    def grid(self) -> nn.Module:
        """The parametrisation of such a map."""
        return self.module.parametrizations[self.attribute][0]

    def cells(self, step: int) -> tuple[int, ...]:
        """The size of the grid after `step` steps."""
        doubled = 2 ** self.spec_of_grid.doublings(step)
        return tuple(min(side * doubled, whole) for side, whole in zip(self.spec_of_grid.cells, self.before.shape))

    def refined_at(self, step: int) -> int:
        """After how many of `step` steps the grid was refined last; 0 if it never was."""
        doubled = [] if self.spec_of_grid is None else self.spec_of_grid.double_at
        return max((at for at in doubled if at <= step and self.cells(at) != self.cells(at - 1)), default=0)

    def refine_to(self, step: int, optimizer: torch.optim.Optimizer | None = None) -> None:
        """Gives the grid of a map the fineness that it has after `step` steps; the map stays what it is."""
        if self.spec_of_grid is not None:
            refine_to(self.module, self.attribute, self.cells(step), optimizer)

    @torch.no_grad()
    def load(self, held: dict[str, Tensor], step: int) -> None:
        """Takes the values of a checkpoint that was made after `step` steps."""
        self.refine_to(step)
        for name, value in self.held.items():
            value.copy_(held[name])

    @property
    def bounds_of_leaf(self) -> tuple[float, float] | None:
        """Between what the leaf itself is kept after each step; None: it is free."""
        return self.spec.bounds if self.spec.parametrisation == "clamp" else None

    @property
    def is_plain(self) -> bool:
        """True if the leaf is the value itself, a parameter of the scene without a parametrisation."""
        return not parametrize.is_parametrized(self.module, self.attribute)

    @property
    def is_small(self) -> bool:
        """True for a colour, a number or a matrix, which is shown entry by entry, unlike a picture or a mesh."""
        return self.before.numel() <= 16

    @property
    def is_picture(self) -> bool:
        """True for a bitmap, (H, W, 1 or 3), or a volume, (Z, Y, X, 1 or 3)."""
        return not self.is_small and self.before.dim() in (3, 4) and self.before.shape[-1] in (1, 3)

    def picture(self, value: Tensor) -> Tensor:
        """A bitmap as it is, a volume by its slices and sums, relative to those of the truth: (H, W, 1 or 3)."""
        if value.dim() == 3:
            return value
        return volume_picture(value, value if self.truth is None else self.truth)

    @property
    def is_pose(self) -> bool:
        """True for a (4, 4) matrix that is recovered as a rotation and a translation."""
        return self.spec.parametrisation == "rigid"

    def motion(self, pose: Tensor) -> dict[str, float]:
        """The motion from the initial pose to another by component, rotations in degrees."""
        return components(self.before, pose)

    def pose_error(self, pose: Tensor) -> PoseError:
        """Angle and distance between a pose and the true one."""
        return PoseError.between(pose, self.truth)

    @property
    def distance_column(self) -> str:
        """The column of metrics.csv with the distance from the truth, the RMS difference."""
        return f"{self.name}:rmse"

    @property
    def size(self) -> float:
        """What that distance is to be compared with: the RMS of the truth; 0 if it is not known."""
        return 0.0 if self.truth is None else self.truth.square().mean().sqrt().item()

    def compared(self, value: Tensor) -> dict[str, Any]:
        """What a run's summary says of a value and the truth; nothing if that is not known."""
        if self.truth is None:
            return {}
        difference = (value - self.truth).abs()
        found = {"mean_truth": self.truth.mean().item(), "largest_error": difference.max().item(),
                 "rmse": difference.square().mean().sqrt().item(),
                 "rmse_before": (self.before - self.truth).square().mean().sqrt().item()}
        if self.is_small:
            found["truth"] = self.truth.flatten().tolist()
        if self.is_pose:
            found |= {"true_motion": self.motion(self.truth), "pose_error": self.pose_error(value)._asdict(),
                      "pose_error_before": self.pose_error(self.before)._asdict()}
        return found

    def columns(self, value: Tensor) -> dict[str, float]:
        """Returns columns of metrics.csv at a value: every entry of a small parameter, the mean of a large one, the error.

        Of a pose, the motion from the initial one: rotation vector in degrees and translation.
        """
        if self.is_pose:
            columns = {f"{self.name}:{key}": entry for key, entry in self.motion(value).items()}
        elif value.dim() == 0:
            columns = {self.name: value.item()}
        elif self.is_small:
            columns = {f"{self.name}[{index}]": entry for index, entry in enumerate(value.flatten().tolist())}
        else:
            columns = {f"{self.name}:mean": value.mean().item()}
        if self.truth is not None:
            columns[self.distance_column] = (value - self.truth).square().mean().sqrt().item()
        return columns

    @torch.no_grad()
    def project_(self) -> None:
        """Puts the value back between its bounds, where no parametrisation does."""
        if self.bounds_of_leaf is not None:
            self.raw.clamp_(*self.bounds_of_leaf)

    def settle(self, scene: nn.Module) -> None:
        """Ends the parametrisation: the scene holds the plain value again."""
        if self.stand_in is not None:
            replace(scene, self.stand_in, self.module)
        if parametrize.is_parametrized(self.module, self.attribute):
            parametrize.remove_parametrizations(self.module, self.attribute)
        self.raw.requires_grad_(False)
