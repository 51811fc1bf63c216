"""The dtypes and shapes that tracing works out by itself are those that torch works out."""

import itertools

import pytest
import torch

from torch_radbp.jit.lane.inference import INFERRED

DTYPES = (torch.float32, torch.float64, torch.int32, torch.int64, torch.bool)
TENSORS = [torch.empty(shape, dtype=dtype, device="meta") for dtype in DTYPES for shape in ((7,), ())]


def arguments(name: str) -> list[tuple]:
    """What the operation may be called with: lanes and numbers of every dtype, and Python's numbers."""
    rule = INFERRED[name].__name__
    if rule == "like":
        return [(x, *[3] * (name == "full_like")) for x in TENSORS]
    if rule == "read_entry":
        return [(table, 0, index) for table in TENSORS if table.dim() for index in TENSORS]
    if rule == "chosen_value":
        return [(condition, a, b) for condition in TENSORS for a in TENSORS for b in TENSORS]
    pairs = itertools.product([*TENSORS, 2, 2.0, True], repeat=2)
    return [(x,) for x in TENSORS] + [pair for pair in pairs if any(isinstance(x, torch.Tensor) for x in pair)]


@pytest.mark.parametrize("name", [name for name in INFERRED if not name.startswith("_efficient")])
def test_what_a_rule_tells_is_what_torch_returns(name):
    compared = 0
    for given in arguments(name):
        try:
            expected = getattr(torch.ops.aten, name)(*given)
        except (RuntimeError, TypeError, IndexError):  # torch has no such operation
            continue
        told = INFERRED[name](*given)
        compared += told is not None
        assert told in (None, (expected.dtype, expected.shape)), given
    assert compared


def test_options_are_followed():
    x, y = torch.empty(7, dtype=torch.int32, device="meta"), torch.empty((), dtype=torch.float64, device="meta")
    assert INFERRED["zeros_like"](x, dtype=torch.float64) == (torch.float64, (7,))
    assert INFERRED["div"](x, x, rounding_mode="floor") == (torch.int32, (7,))
    assert INFERRED["div"](x, y, rounding_mode="trunc") == (torch.float64, (7,))


def test_zeros_that_torch_would_keep_to_itself_are_tensors_like_others():
    told = INFERRED["_efficientzerotensor"]([7], dtype=torch.float64, device="meta")
    expected = torch._efficientzerotensor([7], dtype=torch.float64, device="meta")
    assert told == (expected.dtype, expected.shape) and INFERRED["_efficientzerotensor"]([], dtype=torch.float32) is None


def test_what_torch_refuses_is_left_to_torch():
    truth, half = torch.empty(7, dtype=torch.bool, device="meta"), torch.empty(7, device="meta")
    assert INFERRED["neg"](truth) is None and INFERRED["sub"](truth, truth) is None
    assert INFERRED["bitwise_and"](half, half) is None and INFERRED["index_select"](half, 0, half) is None
