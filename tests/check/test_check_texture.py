"""Textures of the package have finite values and derivatives; modules that have not, or leave their range, are found out."""

import pytest
import torch
from torch import nn

import torch_radbp as rb
from torch_radbp.plugin import REGISTRY

IMAGE = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(0))
TEXTURES = {
    "rgb": {"value": [0.2, 0.5, 0.9]}, "srgb": {"color": [0.2, 0.5, 0.9]}, "uniform": {"value": 0.4},
    "bitmap": {"data": IMAGE, "raw": True}, "checkerboard": {"color0": {"type": "bitmap", "data": IMAGE, "raw": True}},
    "mesh_attribute": {"name": "vertex_colour"}, "spectrum": {"value": 0.3}, "d65": {}, "rawconstant": {"value": 0.3},
    "blackbody": {"temperature": 4000.0},
    "regular": {"wavelength_min": 400.0, "wavelength_max": 700.0, "values": "0.2, 0.8, 0.5"},
    "irregular": {"wavelengths": "400, 500, 700", "values": "0.2, 0.8, 0.5"},
    "volume": {"volume": {"type": "gridvolume", "data": IMAGE[None], "wrap_mode": "mirror"}},
}


@pytest.mark.parametrize("name", [name for name, plugin in REGISTRY["texture"].items()
                                  if plugin.__module__.startswith("torch_radbp.")])
def test_every_texture_of_the_package_agrees(name):
    assert name in TEXTURES, f"the texture {name!r} has no row: add one to TEXTURES of this file"
    result = rb.check_texture({"type": name, **TEXTURES[name]}, low=0.0)
    assert result.agrees, str(result)
    assert {finding.check for finding in result.findings} == {"finite", "derivatives", "range"}


class Function(nn.Module):
    """A module that is a function of places and one parameter."""

    def __init__(self, function):
        super().__init__()
        self.function, self.scale = function, nn.Parameter(torch.tensor(0.5))

    def forward(self, place):
        return self.function(place[:, :1], self.scale)


BROKEN = {
    "a logarithm": (lambda u, scale: scale * u.log(), {"finite"}),
    "a quotient at 0": (lambda u, scale: scale / u, {"finite"}),
    "a root at 0": (lambda u, scale: scale * u.abs().sqrt().clamp(0, 1), {"derivatives"}),
    "a norm at 0": (lambda u, scale: scale * (u * u).sqrt().clamp(0, 1), {"derivatives"}),
    "values below 0": (lambda u, scale: scale * torch.sin(u), {"range"}),
    "values above 1": (lambda u, scale: 3 * scale * torch.sin(u) ** 2, {"range"}),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_wrong_is_found(name):
    function, expected = BROKEN[name]
    module = Function(function)
    result = rb.check_texture(module, low=0.0, high=1.0)
    assert set(result.failed) == expected, str(result)
    assert module.scale.dtype == torch.float32 and module.scale.grad is None and module.scale.requires_grad


def test_a_module_of_positions_and_no_stated_range_agree():
    module = nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 3))
    result = rb.check_texture(rb.NeuralTexture(module, of="position"))
    assert result.agrees and "range" not in str(result), str(result)


@pytest.mark.hostile
def test_what_is_no_texture_is_named():
    with pytest.raises(TypeError, match="texture must be a texture, a module or a dict that describes one, got a str"):
        rb.check_texture("wood.png")
    with pytest.raises(ValueError, match="places must be an integer of at least 1000, got 1"):
        rb.check_texture({"type": "rgb", "value": 0.5}, places=1)
