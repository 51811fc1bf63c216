"""Losses of noisy images whose derivatives are not biased by the noise, as far as that is possible (`rb.losses`).

A rendering I is a random estimate of the true image. The derivative of a loss f(I) at one set of samples is f'(I) dI, and
E[f'(I) dI] differs from E[f'(I)] E[dI], because the same noise is in both factors: of the squared error by twice the
covariance of a pixel and its derivative, which pulls bright things to dark. Two independent renderings take it apart. What
remains is the curvature of f' itself: E[f'(I)] is f'(E[I]) only where f' is linear, as that of the squared error is.

Every loss takes two renderings of two seeds, the target, and a mask, so that one can stand in the place of another:

| loss | with noisy renderings |
|---|---|
| `two_buffer_l2` | value and derivative are unbiased |
| `two_buffer_relative_l2` | the derivative has the sign and the zero of the unbiased one; its size is off |
| `two_buffer_log_l2`, `ssim`, `lpips`, `exchanged` of any other | biased, the less the less noise there is |

References: Gkioulekas et al. 2016, "An evaluation of computational imaging techniques for heterogeneous inverse scattering";
Azinovic et al. 2019, "Inverse path tracing for joint material and lighting estimation", section 4.
"""

from torch_radbp.losses.exchange import exchange_derivatives, exchanged
from torch_radbp.losses.log import two_buffer_log_l2
from torch_radbp.losses.masked import masked_mean
from torch_radbp.losses.perceptual import lpips
from torch_radbp.losses.relative import two_buffer_relative_l2
from torch_radbp.losses.structural import ssim
from torch_radbp.losses.two_buffer import two_buffer_l2

__all__ = ["exchange_derivatives", "exchanged", "lpips", "masked_mean", "ssim", "two_buffer_l2", "two_buffer_log_l2",
           "two_buffer_relative_l2"]
