"""The weighted sum of image losses that a recipe asks for.

Every step renders two independent buffers. `two_buffer_l2`, which has no bias at any number of samples, takes them as they
are and is the one to start with; the other losses see each with the derivative of the other. `torch_radbp.losses` says why.
"""

from collections.abc import Callable

import kornia
import torch
from torch import Tensor, nn

from torch_radbp.formats.image import linear_to_srgb
from torch_radbp.losses import exchange_derivatives, masked_mean, two_buffer_l2
from torch_radbp.training import recipe_loss as recipe

TONE_MAPPINGS: dict[str, Callable[[Tensor], Tensor]] = {
    "none": lambda image: image,
    "log1p": lambda image: torch.log1p(image.clamp(min=0)),
    "srgb": lambda image: linear_to_srgb(image.clamp(min=0)),
}


def _error_map(spec: recipe.ImageLoss) -> Callable[[Tensor, Tensor], Tensor]:
    """The function that gives each pixel its error, (B, C or 1, H, W), of two images."""
    match spec:
        case recipe.L1():
            return lambda image, target: (image - target).abs()
        case recipe.L2():
            return lambda image, target: (image - target).square()
        case recipe.SSIM():
            return kornia.losses.SSIMLoss(spec.window, max_val=spec.max_value, reduction="none")
        case recipe.MultiScaleSSIM():
            error = kornia.losses.MS_SSIMLoss(spec.sigmas, spec.max_value, alpha=spec.alpha, compensation=1.0,
                                              reduction="none")
            return lambda image, target: error(image, target)[:, None]
    raise TypeError(f"no loss for {spec!r}")


class Objective(nn.Module):
    """The recipe's losses as one module: `objective(buffers, target, mask) -> (loss, terms)`.

    Args:
        losses: the recipe's `[[loss]]` tables.
    """

    def __init__(self, losses: list[recipe.AnyLoss]):
        super().__init__()
        self.specs = list(losses)
        self.error_maps = [None if spec.name == "two_buffer_l2" else _error_map(spec) for spec in losses]

    @property
    def names(self) -> list[str]:
        """Of the terms."""
        return list(dict.fromkeys(spec.name for spec in self.specs))

    def spp_of_buffer(self, spp: int) -> int:
        """Samples per pixel of each buffer: all of an image with `two_buffer_l2`, else half of them, rounded up."""
        return spp if None in self.error_maps else -(-spp // 2)

    def forward(self, buffers: tuple[Tensor, Tensor], target: Tensor, mask: Tensor | None = None
                ) -> tuple[Tensor, dict[str, Tensor]]:
        """Computes the weighted sum, and each unweighted term by name.

        Args:
            buffers: independent renderings, each (B, 3, H, W) linear.
            target: (B, 3, H, W) linear.
            mask: (B, 1, H, W), how much of each pixel counts; None: all count the same. Where it is 0 windows of SSIM see
                the target.
        """
        images = exchange_derivatives(*buffers)
        within = images if mask is None else tuple(mask * image + (1 - mask) * target for image in images)
        total, terms = 0.0, {}
        for spec, error_map in zip(self.specs, self.error_maps):
            if error_map is None:
                term = two_buffer_l2(*buffers, target, mask)
            else:
                tone = TONE_MAPPINGS[spec.tone_mapping]
                seen = within if spec.windowed else images
                term = sum(masked_mean(error_map(tone(image), tone(target)), mask) for image in seen) / 2
            total = total + spec.weight * term
            terms[spec.name] = terms.get(spec.name, 0.0) + term.detach()
        return total, terms
