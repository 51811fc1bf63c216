"""Volumes: values at points against torch's and Mitsuba's interpolation, their derivatives, compiled values, and bounds."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from torch_radbp.formats.volume import write_volume
from torch_radbp.io.build import build_plugin
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.jit.stages import CompiledStages
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Vec3

POSE = torch.as_tensor(translate((0.3, -0.2, 0.1)) @ rotate((1, 2, 3), 40) @ scale((2, 1, 0.5)))
MODES = [(filter_type, wrap_mode) for filter_type in ("trilinear", "nearest") for wrap_mode in ("clamp", "repeat", "mirror")]


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def made(**attributes):
    return build_plugin({"type": "gridvolume"} | attributes, "volume").double()


def places(count: int = 400) -> Vec3:
    """In and outside of the grid."""
    return Vec3.of(4 * random(count, 3, seed=1) - 2)


@stage("table")
def values_at(table, kind, p: Vec3) -> tuple[torch.Tensor, ...]:
    """The channels of a volume."""
    return kind.values(table, p)


@pytest.mark.parametrize("channels", [1, 3, 6])
def test_inside_of_the_cube_it_interpolates_between_the_centres_of_cells(channels):
    """As `grid_sample` without aligned corners and with a border."""
    data, p = random(4, 3, 5, channels), random(200, 3, seed=1)
    volume = made(data=data)
    found = torch.stack(volume.kind().values(volume.table(), Vec3.of(p)))
    expected = torch.nn.functional.grid_sample(data.movedim(-1, 0)[None], (2 * p - 1)[None, None, None],
                                               padding_mode="border", align_corners=False)
    torch.testing.assert_close(found, expected.reshape(channels, -1))
    if channels < 6:
        assert torch.equal(torch.stack(volume.kind().eval(volume.table(), Vec3.of(p))), found.expand(3, -1))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("filter_type, wrap_mode", MODES)
def test_values_are_those_of_mitsuba(filter_type, wrap_mode, channels, mi):
    data, p, modes = random(4, 3, 5, channels), places(), {"filter_type": filter_type, "wrap_mode": wrap_mode}
    volume = made(data=data, to_world=POSE, **modes)
    theirs = mi.load_dict({"type": "gridvolume", "grid": mi.VolumeGrid(data.numpy().astype("f4")),
                           "to_world": mi.ScalarTransform4f(POSE.numpy()), **modes})
    found = torch.stack(volume.kind().eval(volume.table(), p), 1)
    interaction = mi.Interaction3f()
    for place, value in zip(p.stack().tolist(), found):
        interaction.p = mi.Point3f(*place)
        np.testing.assert_allclose(np.array(theirs.eval(interaction)), value.detach().numpy(), rtol=0, atol=1e-5)


@pytest.mark.parametrize("channels", [1, 3, 6])
def test_a_grid_that_mitsuba_has_made_is_taken(channels, mi):
    values = random(4, 3, 5, channels).float()
    assert torch.equal(made(grid=mi.VolumeGrid(values.numpy())).data, values.double())


@pytest.mark.parametrize("wrap_mode", ["clamp", "repeat", "mirror"])
def test_derivatives_by_values_and_by_the_point_are_those_of_differences(wrap_mode):
    """Backwards and forwards, in and outside of the grid, along random directions."""
    volume, p = made(data=random(2, 3, 2, 3), to_world=POSE, wrap_mode=wrap_mode), places(10).stack()

    def values(data, p):
        table = torch.func.functional_call(Read(volume), {"volume.data": data})
        return torch.stack(volume.kind().eval(table, Vec3.of(p)))

    assert torch.autograd.gradcheck(values, [volume.data.requires_grad_(), p.requires_grad_()], check_forward_ad=True,
                                    fast_mode=True)


@pytest.mark.parametrize("filter_type, wrap_mode", MODES)
@pytest.mark.parametrize("channels", [1, 3])
def test_slopes_are_the_derivatives_of_values(filter_type, wrap_mode, channels):
    volume = made(data=random(3, 4, 2, channels), to_world=POSE, filter_type=filter_type, wrap_mode=wrap_mode)
    p, table = places(50).stack().requires_grad_(), volume.table()
    slopes = volume.kind().slopes(table, Vec3.of(p))
    for value, slope in zip(volume.kind().values(table, Vec3.of(p)), slopes, strict=True):
        assert filter_type == "trilinear" or not value.requires_grad
        expected = torch.autograd.grad(value.sum(), p, retain_graph=True)[0] if value.requires_grad else torch.zeros_like(p)
        torch.testing.assert_close(slope.stack(), expected)


class Read(torch.nn.Module):
    """The table of a volume, as the result of a module."""

    def __init__(self, volume):
        super().__init__()
        self.volume = volume

    def forward(self):
        return self.volume.table()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("channels", [1, 3, 6])
@pytest.mark.parametrize("filter_type, wrap_mode", MODES)
def test_compiled_values_are_those_of_plain_torch(filter_type, wrap_mode, channels, dtype):
    volume = made(data=random(7, 8, 9, channels), to_world=POSE, filter_type=filter_type, wrap_mode=wrap_mode).to(dtype)
    p, table = places(1000).map(lambda part: part.to(dtype)), volume.table()
    with torch.no_grad():
        found = CompiledStages()(values_at)(table, volume.kind(), p)
        expected = values_at(table, volume.kind(), p)
    torch.testing.assert_close(torch.stack(found), torch.stack(expected))


def test_far_away_the_nearest_value_is_read():
    volume = made(data=torch.arange(8.0).reshape(2, 2, 2))
    far = Vec3(*(torch.tensor([-1e12, 1e12, -3e9, 3e9], dtype=torch.float64),) * 3)
    assert volume.kind().eval(volume.table(), far).x.tolist() == [0.0, 7.0, 0.0, 7.0]


def test_values_lie_between_the_extremes_and_corners_bound_them():
    volume = made(data=random(3, 4, 5, 3), to_world=POSE)
    largest, least = volume.extremes()
    assert (largest, least) == (volume.data.max(), volume.data.min()) and not largest.requires_grad
    corner, far = volume.corners()[0], volume.corners()[-1]
    torch.testing.assert_close(corner, POSE[:3, 3])
    torch.testing.assert_close(far, POSE[:3, :3].sum(1) + POSE[:3, 3])
    values = volume.kind().eval(volume.table(), places(10000)).stack()
    assert least - 1e-12 <= values.min() and values.max() <= largest + 1e-12
    constant = build_plugin({"type": "constvolume", "value": {"type": "rgb", "value": [0.2, 0.7, 0.4]}}, "volume")
    assert [float(each) for each in constant.extremes()] == pytest.approx([0.7, 0.2])
    assert constant.corners().tolist()[-1] == [1.0, 1.0, 1.0]
    assert constant.kind().eval(constant.table(), places(2).map(torch.Tensor.float)).stack()[1].tolist() == pytest.approx(
        [0.2, 0.7, 0.4])


def test_a_file_says_which_box_it_fills(tmp_path):
    write_volume(tmp_path / "g.vol", random(2, 3, 4, 1).numpy(), (-1, 0, 2, 1, 4, 3))
    volume = made(filename=str(tmp_path / "g.vol"), use_grid_bbox=True, to_world=POSE)
    expected = torch.tensor([[-1.0, 0, 2], [1, 4, 3]], dtype=torch.float64) @ POSE[:3, :3].T + POSE[:3, 3]
    torch.testing.assert_close(volume.corners()[[0, -1]], expected)
    assert torch.equal(made(filename=str(tmp_path / "g.vol")).corners()[-1], torch.ones(3, dtype=torch.float64))
    (tmp_path / "empty.vol").write_bytes((tmp_path / "g.vol").read_bytes()[:36] + bytes(12) + bytes(96))
    with pytest.raises(ValueError, match="use_grid_bbox: the box of .*empty.vol must be finite and not empty"):
        made(filename=str(tmp_path / "empty.vol"), use_grid_bbox=True)


@pytest.mark.parametrize("attributes, message", [
    ({}, "a gridvolume needs one of filename, grid and data, got none"),
    ({"grid": torch.ones(1, 1, 1), "data": torch.ones(1, 1, 1)}, "got grid and data"),
    ({"data": torch.ones(2, 2)}, r"data of a gridvolume must have shape .* got \(2, 2\)"),
    ({"data": torch.ones(2, 2, 2, 4)}, r"C 1, 3 or 6, got \(2, 2, 2, 4\)"),
    ({"data": torch.ones(2, 0, 2)}, r"got \(2, 0, 2, 1\)"),
    ({"data": -torch.ones(1, 1, 1)}, "data must be at least 0, got -1"),
    ({"data": torch.full((1, 1, 1), torch.nan)}, "data must be finite"),
    ({"data": torch.ones(1, 1, 1), "filter_type": "cubic"}, "filter_type 'cubic' is not known"),
    ({"data": torch.ones(1, 1, 1), "wrap_mode": "mirrored"}, "did you mean 'mirror'"),
    ({"data": torch.ones(1, 1, 1), "use_grid_bbox": True}, "use_grid_bbox needs a filename"),
    ({"data": torch.ones(1, 1, 1), "to_world": torch.zeros(4, 4)}, "to_world must be"),
])
def test_what_makes_no_sense_is_refused_by_name(attributes, message):
    with pytest.raises(ValueError, match=f"volume.*{message}"):
        made(**attributes)
