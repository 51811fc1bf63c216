"""Fused loops of dual tensors: values and tangents are those of plain torch."""

import pytest
import torch
from torch.autograd import forward_ad

from tests.jit.emulated import emulated
from torch_radbp.jit import UnknownOperation
from torch_radbp.jit.dual import DualFunction, DualParts, dual, values_and_tangents

LANES = 1000


def function(tables, x, index, power):
    """Tables and lanes; results that carry a tangent and results that carry none, an argument and a decision among them."""
    read = tables[0].index_select(0, index) * torch.where(x > 0.3, torch.sqrt(x), 0.5 * x)
    plain = tables[1].index_select(0, index)
    return [read + plain, torch.atan2(read, plain)], (read.detach(), x > 0.5, index), read ** power


def arguments(dtype: torch.dtype, dual: bool) -> tuple:
    generator = torch.Generator().manual_seed(4)
    tables = [torch.rand(50, generator=generator, dtype=dtype) for _ in range(2)]
    x, index = torch.rand(LANES, generator=generator, dtype=dtype), torch.arange(LANES, dtype=torch.int32) % 50
    tangents = torch.randn(50, generator=generator, dtype=dtype), torch.randn(LANES, generator=generator, dtype=dtype)
    if dual:
        tables[0], x = forward_ad.make_dual(tables[0], tangents[0]), forward_ad.make_dual(x, tangents[1])
    return tuple(tables), x, index, 3


def tensors(record) -> list:
    return [part for parts in record for part in (parts if isinstance(parts, (list, tuple)) else [parts])]


@pytest.mark.parametrize("dtype, rtol", [(torch.float32, 2e-6), (torch.float64, 1e-14)], ids=str)
@pytest.mark.parametrize("target", [None, "emulated"])
def test_values_and_tangents_are_those_of_torch(dtype, rtol, target):
    fused = DualFunction(function, ("tables",), emulated() if target else None)
    with forward_ad.dual_level():
        given = arguments(dtype, dual=True)
        found, expected = (tensors(each(*given)) for each in (fused, function))
        for (value, tangent), (right, slope) in zip(map(values_and_tangents, found), map(values_and_tangents, expected)):
            torch.testing.assert_close(value, right, rtol=rtol, atol=0)
            assert (tangent is None) == (slope is None)
            if slope is not None:
                assert slope.abs().max() > 0
                torch.testing.assert_close(tangent, slope, rtol=rtol, atol=1e-6 if dtype == torch.float32 else 1e-14)
        assert [values_and_tangents(part)[1] is not None for part in found] == [True, True, False, False, False, True]


def test_what_has_a_tangent_may_change_from_call_to_call():
    fused = DualFunction(lambda x, y: x * y, ())
    x, y, slope = torch.rand(9), torch.rand(9), torch.rand(9)
    with forward_ad.dual_level():
        dual_x, dual_y = forward_ad.make_dual(x, slope), forward_ad.make_dual(y, slope)
        for a, b, tangent in ((dual_x, y, slope * y), (x, dual_y, x * slope), (dual_x, dual_y, slope * y + x * slope)):
            value, found = values_and_tangents(fused(a, b))
            torch.testing.assert_close(found, tangent)
            torch.testing.assert_close(value, x * y)
        assert values_and_tangents(fused(x, y))[1] is None


def test_an_operation_that_is_none_of_lanes_is_refused():
    with forward_ad.dual_level(), pytest.raises(UnknownOperation, match="sort"):
        DualFunction(lambda x: x.sort()[0], ())(forward_ad.make_dual(torch.rand(5), torch.rand(5)))


def test_tangents_that_there_is_room_for_are_written_and_zero_where_there_are_none():
    fused, (x, y, slope) = DualFunction(lambda x, y: (x * y, y + 1.0)), torch.rand(3, 9)
    with forward_ad.dual_level():
        room = dual(tuple(torch.full((12,), 7.0) for _ in range(2)), tuple(torch.full((12,), 7.0) for _ in range(2)))
        fused.into(room, 2, DualParts.of((forward_ad.make_dual(x, slope), y)))
        expected_tangents = (slope * y, torch.zeros(9))
        for (value, tangent), right, expected in zip(map(values_and_tangents, room), (x * y, y + 1.0), expected_tangents):
            torch.testing.assert_close(value[2:11], right)
            torch.testing.assert_close(tangent[2:11], expected)
            assert (value[[0, 1, 11]] == 7).all() and (tangent[[0, 1, 11]] == 7).all()


def test_tangents_that_there_is_no_room_for_are_an_error():
    x, slope = torch.rand(2, 9)
    with forward_ad.dual_level(), pytest.raises(ValueError, match="no room"):
        DualFunction(lambda x: 2.0 * x).into(torch.empty(9), 0, DualParts.of((forward_ad.make_dual(x, slope),)))
