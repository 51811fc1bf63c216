"""The weighted sum of image losses that a recipe asks for.

Every step renders two independent buffers. `two_buffer_l2`, which has no bias at any number of samples, takes them as they
are and is the one to start with; the other losses see each with the derivative of the other. `torch_radbp.losses` says why.
"""

from collections.abc import Callable

import kornia
import torch
from torch import Tensor, nn

from torch_radbp.formats.image import linear_to_srgb
from torch_radbp.losses import exchange_derivatives, two_buffer_l2
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

    def spp_of_buffer(self, spp: int) -> int:
        """Samples per pixel of each buffer: all of an image with `two_buffer_l2`, else half of them, rounded up."""
        return spp if None in self.image_losses else -(-spp // 2)

    def forward(self, buffers: tuple[Tensor, Tensor], target: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """Computes the weighted sum, and each unweighted term by name.

        Args:
            buffers: independent renderings, each (B, 3, H, W) linear.
            target: (B, 3, H, W) linear.
        """
        images = exchange_derivatives(*buffers)
        total, terms = 0.0, {}
        for spec, image_loss in zip(self.specs, self.image_losses):
            if image_loss is None:
                term = two_buffer_l2(*buffers, target)
            else:
                tone = TONE_MAPPINGS[spec.tone_mapping]
                term = sum(image_loss(tone(image), tone(target)) for image in images) / 2
            total = total + spec.weight * term
            terms[spec.name] = terms.get(spec.name, 0.0) + term.detach()
        return total, terms
