"""The exposure of photographs: a gain and a white balance for each view."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torch_radbp.photographs.linear_images import check_linear_images, view_indices
from torch_radbp.plugin import boolean, integer


class Exposure(nn.Module):
    """Multiplies images by the gain and the white balance of their view, both positive since their logarithms are optimised.

        exposure = rb.Exposure(len(photographs), fixed=0)
        a, b = (renderer(seed=2 * step + k, sensors=batch.sensors) for k in (0, 1))
        a, b = exposure(a, batch.views), exposure(b, batch.views)
        loss = rb.losses.two_buffer_l2(a, b, batch.image, batch.mask)

    Twice the light and half of every gain make the same photographs, and so do bluer light and redder balances. One view
    that is `fixed` removes that ambiguity; or a prior does, such as `rb.priors.white_balance(exposure.gains)`.

    It is linear in the images, so that whatever is unbiased with noisy renderings is so behind it.

    Parameters, without a unit, of natural logarithms:
        log_gain: (V,) of the exposure of each view, the same for all channels.
        log_balance: (V, 3) of each channel; what they have in common is left to `log_gain`. Absent without a balance.

    Args:
        views: V, how many there are.
        fixed: the index of a view whose gains stay what they are at first; None: all are free.
        white_balance: whether channels have gains of their own.
        gains: (V,) or (V, 3) to begin with, such as exposure times relative to one another; 1 by default.

    Raises:
        ValueError: if there is no such view, or gains have another shape or are not positive and finite.
    """

    def __init__(self, views: int, *, fixed: int | None = None, white_balance: bool = True, gains: Tensor | None = None):
        super().__init__()
        count = integer("views", views, 1)
        if fixed is not None and not 0 <= integer("fixed", fixed) < count:
            raise ValueError(f"fixed must be the index of a view, from 0 to {count - 1}, got {fixed}")
        start = torch.ones(count) if gains is None else torch.as_tensor(gains).detach().to(torch.get_default_dtype())
        if start.shape not in ((count,), (count, 3)):
            raise ValueError(f"gains must have shape ({count},) or ({count}, 3), got {tuple(start.shape)}")
        if not bool((start > 0).all() and start.isfinite().all()):
            raise ValueError("gains must be positive and finite")
        if start.ndim == 2 and not boolean("white_balance", white_balance):
            raise ValueError(f"gains without white_balance must have shape ({count},), got {tuple(start.shape)}")
        start = start.log().reshape(count, -1).expand(-1, 3)
        self.log_gain = nn.Parameter(start.mean(1))
        balance = start - start.mean(1, keepdim=True)
        self.log_balance = nn.Parameter(balance) if boolean("white_balance", white_balance) else None
        self.register_buffer("start", start.contiguous())
        self.fixed = fixed

    @property
    def gains(self) -> Tensor:
        """(V, 3) the factor of each channel of each view; attached, but for the view that is fixed."""
        logarithm = self.log_gain[:, None].expand(-1, 3)
        if self.log_balance is not None:
            logarithm = logarithm + self.log_balance - self.log_balance.mean(1, keepdim=True)
        if self.fixed is not None:
            view = torch.arange(len(logarithm), device=logarithm.device)[:, None]
            logarithm = torch.where(view == self.fixed, self.start, logarithm)
        return logarithm.exp()

    def forward(self, images: Tensor, views: int | Tensor) -> Tensor:
        """Multiplies images by the gains of their views.

        Args:
            images: (B, 3, H, W) linear radiance, attached.
            views: (B,) integers, or one.

        Returns:
            (B, 3, H, W), attached to images and parameters.

        Raises:
            ValueError: if there is no such view, or not one for each image.
        """
        check_linear_images(images)
        return images * self.gains[view_indices(views, images, len(self.log_gain))][:, :, None, None].to(images)
