"""The weighted sum of image losses that a recipe asks for.

`two_buffer_l2`, which has no bias at any number of samples, is the one to start with; `torch_radbp.losses` says why.
"""

from collections.abc import Callable

import kornia
import torch
from torch import Tensor, nn

from torch_radbp.io.image import linear_to_srgb
from torch_radbp.losses import two_buffer_l2
from torch_radbp.training import recipe

TONE_MAPPINGS: dict[str, Callable[[Tensor], Tensor]] = {
    "none": lambda image: image,
    "log1p": lambda image: torch.log1p(image.clamp(min=0)),
    "srgb": lambda image: linear_to_srgb(image.clamp(min=0)),
}


def _image_loss(spec: recipe.ImageLoss) -> Callable[[Tensor, Tensor], Tensor]:
    match spec:
        case recipe.L1():
            return nn.functional.l1_loss
        case recipe.L2():
            return nn.functional.mse_loss
        case recipe.SSIM():
            return kornia.losses.SSIMLoss(spec.window, max_val=spec.max_value)
        case recipe.MultiScaleSSIM():
            return kornia.losses.MS_SSIMLoss(spec.sigmas, spec.max_value, alpha=spec.alpha, compensation=1.0)
    raise TypeError(f"no loss for {spec!r}")


class Objective(nn.Module):
    """The recipe's losses as one module: `objective(buffers, target) -> (loss, terms)`.

    Args:
        losses: the recipe's `[[loss]]` tables.
    """

    def __init__(self, losses: list[recipe.AnyLoss]):
        super().__init__()
        self.specs = list(losses)
        self.image_losses = [None if spec.name == "two_buffer_l2" else _image_loss(spec) for spec in losses]

    @property
    def buffers_needed(self) -> int:
        """Independent renderings wanted per step: 2 with `two_buffer_l2`, else 1."""
        return 2 if None in self.image_losses else 1

    def forward(self, buffers: list[Tensor], target: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """Computes the weighted sum, and each unweighted term by name.

        Args:
            buffers: `buffers_needed` independent renderings, each (B, 3, H, W) linear; one-image losses see their mean.
            target: (B, 3, H, W) linear.
        """
        mean = torch.stack(buffers).mean(0) if len(buffers) > 1 else buffers[0]
        total, terms = 0.0, {}
        for spec, image_loss in zip(self.specs, self.image_losses):
            if image_loss is None:
                term = two_buffer_l2(*buffers, target)
            else:
                tone = TONE_MAPPINGS[spec.tone_mapping]
                term = image_loss(tone(mean), tone(target))
            total = total + spec.weight * term
            terms[spec.name] = terms.get(spec.name, 0.0) + term.detach()
        return total, terms
