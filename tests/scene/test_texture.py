"""Texture lookups against the definition: bilinear weights, wrap modes, transforms, row 0 at v = 0."""

import numpy as np
import pytest
import torch

from tests.scenes import texels
from tests.texture.texel_by_texel import HEIGHT, WIDTH, reference
from torch_radbp.scene.packing.radiances import BankBuilder
from torch_radbp.tensors.vec import Vec2
from torch_radbp.texture.bank import sample_texture
from torch_radbp.texture.bitmap import Bitmap, texture_bank
from torch_radbp.texture.rgb import RGB


def values(textures, which, uv):
    """(N, 3) of the textures `which` (N,) at `uv` (N, 2)."""
    bank = BankBuilder()
    for texture in textures:
        bank.add(texture.double())
    tensors = texture_bank(bank.textures, torch.float64, torch.device("cpu"))
    index = torch.as_tensor(which, dtype=torch.int32)
    return sample_texture(tensors, index, Vec2.of(torch.as_tensor(uv))).stack().detach().numpy()


@pytest.mark.parametrize("filter_type", ["bilinear", "nearest"])
@pytest.mark.parametrize("mode", ["repeat", "mirror", "clamp"])
def test_a_lookup_is_the_weighted_mean_of_its_texels(mode, filter_type):
    data = texels(HEIGHT, WIDTH, 3)
    uv = np.random.default_rng(1).uniform(-2.6, 3.6, (200, 2))
    texture = Bitmap(data=torch.from_numpy(data), wrap_mode=mode, filter_type=filter_type)
    expected = np.stack([reference(texture.data.double().numpy(), u, v, mode, filter_type == "nearest") for u, v in uv])
    np.testing.assert_allclose(values([texture], np.zeros(200), uv), expected, rtol=0, atol=1e-12)


def test_row_zero_lies_at_v_zero():
    texture = Bitmap(data=torch.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) / 12.0, filter_type="nearest")
    found = values([texture], [0, 0, 0], np.array([[0.01, 0.01], [0.99, 0.01], [0.01, 0.99]]))[:, 0] * 12
    np.testing.assert_allclose(found, [0, 3, 8], atol=1e-6)


def test_to_uv_is_applied_before_the_lookup():
    data = texels(HEIGHT, WIDTH, 3)
    matrix = torch.eye(4)
    matrix[:2, [0, 1, 3]] = torch.tensor([[0.6, -1.6, 0.25], [0.8, 1.2, 0.5]])
    uv = np.random.default_rng(1).uniform(0, 1, (50, 2))
    moved = np.stack([0.6 * uv[:, 0] - 1.6 * uv[:, 1] + 0.25, 0.8 * uv[:, 0] + 1.2 * uv[:, 1] + 0.5], 1)
    plain, turned = Bitmap(data=torch.from_numpy(data)), Bitmap(data=torch.from_numpy(data), to_uv=matrix)
    np.testing.assert_allclose(values([turned], np.zeros(50), uv), values([plain], np.zeros(50), moved), atol=1e-6)


def test_each_lane_reads_its_own_texture():
    colour, bitmap = RGB(value=torch.tensor([0.1, 0.2, 0.3])), Bitmap(data=torch.from_numpy(texels(HEIGHT, WIDTH)))
    other = Bitmap(data=torch.from_numpy(texels(1, 1, 9)), filter_type="nearest")
    uv = np.random.default_rng(2).uniform(0, 1, (30, 2))
    which = np.arange(30) % 3
    together = values([colour, bitmap, other], which, uv)
    for k, texture in enumerate((colour, bitmap, other)):
        np.testing.assert_allclose(together[which == k], values([texture], np.zeros(10), uv[which == k]), atol=1e-15)
    np.testing.assert_allclose(together[which == 0], [[0.1, 0.2, 0.3]] * 10, atol=1e-8)
