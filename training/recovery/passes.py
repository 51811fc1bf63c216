"""Long renderings in passes: progress can be shown, they can be ended early, and their noise is measured."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.formats.image import linear_to_srgb

NEXT_SEED = 0x1000193  # passes share no samples


class Estimate(NamedTuple):
    """An image as far as it has been rendered.

    Attributes:
        image: (B, 3, H, W) linear RGB, detached.
        spp: samples per pixel so far.
        noise: RMS standard error of a pixel; None after a single pass.
        visible_noise: the same as a screen shows it, in [0, 1] sRGB.
    """

    image: Tensor
    spp: int
    noise: float | None = None
    visible_noise: float | None = None


def render_in_passes(
    renderer: Callable[..., Tensor], sensors: list[int], spp: int, seed: int, passes: int, go_on: Callable[[Estimate], bool]
) -> Estimate:
    """Renders with up to `spp` samples per pixel.

    Args:
        renderer: what to render with, called as an `rb.Renderer`.
        sensors: indices of the sensors.
        spp: samples per pixel at most.
        seed: of the random numbers.
        passes: how many of nearly equal size; at least 1 and at most `spp`.
        go_on: asked after each pass but the last; False ends the rendering there.
    """
    halves, counts = [0.0, 0.0], [0, 0]  # of odd and of even passes: their difference tells the noise
    with torch.no_grad():
        for number in range(passes):
            samples = spp // passes + (number < spp % passes)
            image = renderer(seed=seed + number * NEXT_SEED, sensors=sensors, spp=samples)
            halves[number % 2] = halves[number % 2] + image * samples
            counts[number % 2] += samples
            estimate = Estimate((halves[0] + halves[1]) / sum(counts), sum(counts))
            if number > 0:
                one, other = (half / count for half, count in zip(halves, counts))
                noise, visible_noise = standard_error(one, other), standard_error(shown(one), shown(other))
                estimate = estimate._replace(noise=noise, visible_noise=visible_noise)
            if number + 1 < passes and not go_on(estimate):
                break
    return estimate


def standard_error(one: Tensor, other: Tensor) -> float:
    """Computes the RMS standard error of the mean of two independent estimates of equal quality."""
    return (one - other).square().mean().sqrt().item() / 2


def shown(image: Tensor) -> Tensor:
    """Returns a linear image as a screen shows it, sRGB in [0, 1]."""
    return linear_to_srgb(image.clamp(0, 1))
