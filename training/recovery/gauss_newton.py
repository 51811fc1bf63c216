"""The steps of `optimizer = "gauss-newton"`: all leaves together, by the residuals of a recipe's losses."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from torch_radbp.optim.gauss_newton import GaussNewton, ranges
from torch_radbp.training.recovery.losses import TONE_MAPPINGS

if TYPE_CHECKING:
    from torch_radbp.training.recovery.problem import Recovery

COLUMNS = ("spp", "damping", "noise_share")  # of the search, in metrics.csv


class JointSteps:
    """Makes the steps of a recipe whose optimiser is Gauss-Newton.

    Args:
        recovery: with its renderer, targets and parameters, whose leaves are moved within their bounds; those without a
            parametrisation or bounds within the ranges of the scene.

    Raises:
        ValueError: several processes share the run.
    """

    def __init__(self, recovery: "Recovery"):
        if recovery.ranks.count > 1:
            raise ValueError('optimizer = "gauss-newton" is for one process; start the run without torchrun')
        self.recovery = recovery
        recipe, spec = recovery.recipe, recovery.recipe.optimizer
        self.leaves = {name: leaf for each in recovery.parameters for name, leaf in each.leaves.items()}
        spp, seed = recipe.render.spp, recipe.render.seed * 0x9E3779B1 % 2**28
        self.optimizer = GaussNewton(self.leaves.values(), spp=spp, max_spp=max(spec.max_spp or 64 * spp, spp), seed=seed,
                                     damping=spec.damping, robust=spec.robust, iterations=spec.iterations)
        self.optimizer.low, self.optimizer.high = self._ends()
        targets, masks = recovery.targets.images, recovery.targets.masks
        count = len(recovery.objective.specs) * targets.numel()
        weight = torch.ones_like(targets) if masks is None else masks.expand_as(targets)
        # The mean of the squares of all residuals is then the weighted sum of the losses.
        self.scales = [(each.weight * count / float(weight.double().sum()) * weight).sqrt()
                       for each in recovery.objective.specs]

    def _ends(self) -> tuple[Tensor, Tensor]:
        """The least and greatest values of all leaves, (n,) float64 each."""
        ends = []
        for each in self.recovery.parameters:
            for leaf in each.leaves.values():
                low, high = each.bounds_of_leaf or (-math.inf, math.inf)
                like = torch.full((leaf.numel(),), low, dtype=torch.float64, device=leaf.device)
                if each.is_plain and each.bounds_of_leaf is None:
                    ends.append(ranges(torch.optim.SGD([leaf]), self.recovery.scene))
                else:
                    ends.append((like, torch.full_like(like, high)))
        low, high = zip(*ends, strict=True)
        return torch.cat(low), torch.cat(high)

    def residuals(self, seed: int, spp: int | None) -> list[Tensor]:
        """One tensor of the shape of the targets for each loss, attached."""
        recovery = self.recovery
        rendered = recovery.renderer(seed=seed, sensors=recovery.targets.sensors, spp=spp)
        image, target = recovery.exposed(rendered, list(range(len(recovery.targets.names)))), recovery.targets.images
        tones = [TONE_MAPPINGS[getattr(spec, "tone_mapping", "none")] for spec in recovery.objective.specs]
        return [scale * (tone(image) - tone(target)) for scale, tone in zip(self.scales, tones, strict=True)]

    def take(self, stopped: Callable[[], bool]) -> tuple[Tensor, dict[str, Tensor], str | None]:
        """Makes one step.

        Args:
            stopped: asked before each rendering; True ends the step, as if it had not begun.

        Returns:
            the loss and its terms before the step, NaN if it was not made; why it was not, or None.

        Raises:
            KeyboardInterrupt: it was stopped.
        """
        buffers: list[list[Tensor]] = []

        def closure(seed: int, spp: int | None) -> list[Tensor]:
            if stopped():
                raise KeyboardInterrupt
            found = self.residuals(seed, spp)
            if len(buffers) < 2:  # the first two are those of where the step begins
                buffers.append([each.detach() for each in found])
            return found

        before, at = self.optimizer.state_dict(), {name: leaf.detach().clone() for name, leaf in self.leaves.items()}
        kept = self.optimizer.kept
        specs = self.recovery.objective.specs
        try:
            loss = self.optimizer.step(closure)
        except BaseException as error:
            self.optimizer.load_state_dict(before)
            self.optimizer.kept = kept
            with torch.no_grad():
                for name, leaf in self.leaves.items():
                    leaf.copy_(at[name])
            if not isinstance(error, (ValueError, FloatingPointError)):
                raise
            self.optimizer.seed += 1  # the next one has other samples
            missing = self.recovery.targets.images.new_tensor(math.nan)
            return missing, dict.fromkeys(self.recovery.objective.names, missing), str(error)
        terms: dict[str, Tensor] = {}
        for spec, one, other in zip(specs, *buffers, strict=True):
            terms[spec.name] = terms.get(spec.name, 0.0) + (one * other).mean() / (spec.weight * len(specs))
        return self.recovery.targets.images.new_tensor(loss), terms, None

    def columns(self) -> dict[str, float]:
        """What metrics.csv has of the search after a step."""
        return {f"gauss_newton.{key}": self.optimizer.search[key] for key in COLUMNS}

    def state(self) -> dict[str, Any]:
        """What a checkpoint has of it, in numbers and lists that JSON can hold."""
        held = self.optimizer.state_dict()
        search = {key: value if math.isfinite(value) else 0.0 for key, value in held["search"].items()}
        place = held["kept_at"]
        if place is not None:
            place = place | {"position": place["position"].tolist()}
        return {"search": search, "seed": held["seed"], "kept_for": held["kept_for"], "kept_at": place}

    def load(self, state: dict[str, Any]) -> None:
        """Continues from a checkpoint's."""
        self.optimizer.load_state_dict(self.optimizer.state_dict() | state)
