"""A network in the place of a bitmap or of a grid in space: the optimiser sees its weights.

The weights of all layers are one vector. It is the leaf of a parametrisation of the map, whose texels, or cells, thereby are
the values of the network at their centres: in the report, in the metrics, and in the scene that is saved. A network in the
place of a bitmap the light path calls where it meets the surface; one in the place of a grid is read at its cells, as of
`rb.NeuralVolume`.
"""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn

from torch_radbp.texture.bitmap import Bitmap
from torch_radbp.training.recipe_parameter import Network, Parameter


class WaveNetwork(nn.Module):
    """Linear RGB or grey at (N, A) places: waves of random directions and lengths, then layers with ReLU, then a sigmoid.

    Reference: Tancik et al. 2020, "Fourier Features Let Networks Learn High Frequency Functions in Low Dimensional Domains".

    Args:
        spec: its size and seed.
        bounds: of its values.
        channels: 3 of colours, 1 of grey.
        axes: A, 2 or 3.
    """

    def __init__(self, spec: Network, bounds: tuple[float, float], channels: int = 3, axes: int = 2):
        super().__init__()
        self.bounds = bounds
        self.sizes = [2 * spec.waves, *[spec.width] * spec.layers, channels]
        generator = torch.Generator().manual_seed(spec.seed)
        self.register_buffer("waves", spec.frequency * torch.randn(axes, spec.waves, generator=generator))
        # Drawn as `nn.Linear` draws them.
        initial = [(2.0 * torch.rand((before + 1) * after, generator=generator) - 1.0) / math.sqrt(before)
                   for before, after in pairwise(self.sizes)]
        self.register_buffer("initial_weights", torch.cat(initial))

    def forward(self, weights: Tensor, place: Tensor) -> Tensor:
        """(N, 3 or 1) values at places, attached to both."""
        phase = place @ self.waves
        values, used = torch.cat([phase.sin(), phase.cos()], 1), 0
        for number, (before, after) in enumerate(pairwise(self.sizes)):
            matrix, bias = weights[used : used + before * after].view(after, before), used + before * after
            values = nn.functional.linear(values.relu() if number else values, matrix, weights[bias : bias + after])
            used = bias + after
        lower, upper = self.bounds
        return lower + (upper - lower) * values.sigmoid()


class Texels(nn.Module):
    """Maps a vector of weights to the values of the network at the centres of texels, (H, W, 3 or 1), or of cells,
    (Z, Y, X, 3 or 1)."""

    def __init__(self, network: WaveNetwork, shape: tuple[int, ...]):
        super().__init__()
        self.network, self.shape = network, shape
        along = torch.meshgrid(*((torch.arange(side) + 0.5) / side for side in shape[:-1]), indexing="ij")
        self.register_buffer("centres", torch.stack(along[::-1], -1).view(-1, len(along)))

    def forward(self, weights: Tensor) -> Tensor:
        return self.network(weights, self.centres).view(self.shape)

    def right_inverse(self, value: Tensor) -> Tensor:
        """The initial weights, whatever the value is."""
        return self.network.initial_weights.clone()


def make_texels(spec: Parameter, held: Tensor) -> Texels:
    """Returns the map from the weights of a recipe's network to the texels of a map like `held`."""
    *sides, channels = held.shape
    return Texels(WaveNetwork(spec.network or Network(), spec.bounds, channels, len(sides)), held.shape).to(held)


class OnBitmap(nn.Module):
    """The network at surface coordinates, which a bitmap's transform and wrap mode bring into the unit square."""

    def __init__(self, network: WaveNetwork, weights: nn.Parameter, bitmap: Bitmap):
        super().__init__()
        self.network, self.weights, self.wrap_mode = network, weights, bitmap.wrap_mode
        self.register_buffer("to_uv", bitmap.to_uv.detach().clone())

    def forward(self, uv: Tensor) -> Tensor:
        place = uv @ self.to_uv[:2, :2].T + self.to_uv[:2, 3]
        return self.network(self.weights, wrapped(place, self.wrap_mode))


def wrapped(place: Tensor, mode: str) -> Tensor:
    """Brings (N, 2) places into the unit square by a bitmap's wrap mode, attached."""
    if mode == "clamp":
        return place.clamp(0.0, 1.0)
    if mode == "mirror":
        return 1.0 - (1.0 - place.remainder(2.0)).abs()
    return place.remainder(1.0)
