"""A renderer's method `radiance` as a module, for `torch.func`."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor, nn
from torch.func import functional_call

from torch_radbp.adjoint.forward_mode import render_outside_transforms


class RadianceOf(nn.Module):
    """A module whose call is the method `radiance` of a renderer."""

    def __init__(self, renderer: nn.Module):
        super().__init__()
        self.renderer = renderer

    def forward(self, *arguments, **settings) -> Tensor:
        return self.renderer.radiance(*arguments, **settings)


def radiance_outside(renderer: nn.Module, rays: Mapping[str, Tensor], seed: int | None, spp: int | None,
                     seed_grad: int | None) -> Tensor:
    """Computes `renderer.radiance(**rays, ...)` inside of `torch.func.jvp`; raises as `render_outside_transforms`."""
    module = RadianceOf(renderer)

    def render(tensors: dict[str, Tensor]) -> Tensor:
        given = {name: tensors[name] for name in rays}
        parameters = {name: value for name, value in tensors.items() if name not in rays}
        return functional_call(module, parameters, kwargs={**given, "seed": seed, "spp": spp, "seed_grad": seed_grad})

    return render_outside_transforms(render, {**dict(module.named_parameters()), **rays})
