"""What a GPU does beside the functions of lanes: entries are put, and numbers added, by kernels that run emulated here."""

import pytest
import torch

from tests.jit.edge_values import DTYPES
from tests.jit.emulated import Emulated
from tests.jit.programs import addition
from torch_radbp.jit.lane.graph import LANES
from torch_radbp.jit.lane.trace import traced_program
from torch_radbp.jit.nvidia.gpu import Gpu, gpu_of
from torch_radbp.jit.nvidia.nvptx import ptx
from torch_radbp.jit.nvidia.nvptx_lanes import put_text, scatter_text
from torch_radbp.jit.recording.any_device import AnyDevice
from torch_radbp.jit.target import target_of


@pytest.mark.parametrize("lanes", [1, 127, 1000])
def test_entries_are_put_into_their_places(lanes):
    gpu, generator = Gpu(Emulated()), torch.Generator().manual_seed(2)
    place = torch.randperm(2 * lanes + 3, generator=generator)[:lanes]
    targets = [torch.rand(2 * lanes + 3, generator=generator).mul(9).to(dtype) for dtype in DTYPES]
    entries = [torch.rand(lanes, generator=generator).mul(9).to(dtype) for dtype in DTYPES]
    expected = [target.index_copy(0, place, entry) for target, entry in zip(targets, entries)]
    gpu.put(targets, place.to(torch.int32), entries)
    assert all(map(torch.equal, targets, expected))
    assert [launch.name for launch in gpu.launcher.launches] == ["put"]  # one for all


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("copies", [1, 64])
def test_numbers_are_added_to_tables_by_one_kernel(dtype, copies):
    gpu = Gpu(Emulated())
    cases = [addition(3000, entries, tables, copies, dtype) for entries, tables in ((1, 1), (4, 3), (700, 2))]
    gpu.scatter_add(cases, 3000)
    for case in cases:
        for numbers, totals in zip(case.numbers, case.sums.totals):
            expected = torch.zeros(len(totals), dtype=torch.float64).index_add_(0, case.index, numbers.double())
            torch.testing.assert_close(totals.sum(1), expected, rtol=1e-13, atol=1e-13)  # of another order of the sum
            assert (totals != 0).all(0).all() if len(totals) == 1 else totals.any()
        touched = torch.zeros_like(case.sums.touched).index_fill_(0, case.index.long() // 16, True)
        assert torch.equal(case.sums.touched, touched)
    gpu.scatter_add(cases, 3000)
    assert [launch.name for launch in gpu.launcher.launches] == ["scatter"] * 2 and len(gpu.kernels) == 1


def test_lanes_of_a_warp_take_different_copies_of_a_small_table():
    gpu = Gpu(Emulated())
    case = addition(64, 1, 1, gpu.copies(1), torch.float32)
    gpu.scatter_add([case], 64)
    assert torch.equal(case.sums.totals[0][0].float(), case.numbers[0])
    assert gpu.copies(1 << 20) == 1


def test_torch_adds_in_order_where_it_is_told_to_be_deterministic():
    gpu, case = Gpu(Emulated()), addition(500, 7, 2, 1, torch.float32)
    before = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(True)
    try:
        gpu.scatter_add([case], 500)
    finally:
        torch.use_deterministic_algorithms(before)
    assert not gpu.launcher.launches
    for numbers, totals in zip(case.numbers, case.sums.totals):
        expected = torch.zeros(7, dtype=torch.float64).index_add_(0, case.index, numbers.double())
        assert torch.equal(totals.squeeze(1), expected)


@pytest.mark.parametrize("copies", [1, 64])
def test_sums_do_not_depend_on_the_order_of_the_threads_where_torch_is_deterministic(copies, monkeypatch):
    def sums(deterministic: bool) -> list[torch.Tensor]:
        monkeypatch.setattr(torch, "are_deterministic_algorithms_enabled", lambda: deterministic)
        found = []
        for backwards in (False, True):
            case = addition(5000, 7, 1, copies, torch.float64)
            Gpu(Emulated(backwards=backwards)).scatter_add([case], 5000)
            found.append(case.sums.totals[0])
        expected = torch.zeros(7, dtype=torch.float64).index_add_(0, case.index, case.numbers[0])
        torch.testing.assert_close(found[0].sum(1), expected, rtol=1e-13, atol=1e-13)
        return found

    assert torch.equal(*sums(True)) and not torch.equal(*sums(False))


def test_lanes_are_chosen_and_partitioned_by_torch():
    gpu, generator = Gpu(Emulated()), torch.Generator().manual_seed(5)
    number = torch.randint(0, 4, (999,), generator=generator, dtype=torch.int32)
    order, counts = gpu.partition(number, 6)
    expected, expected_counts = target_of(number.device).partition(number, 6)
    assert torch.equal(order, expected) and list(counts) == list(expected_counts)
    assert torch.equal(gpu.chosen(number > 1), target_of(number.device).chosen(number > 1))


def test_numbers_are_added_by_the_instruction_for_it():
    text = ptx(scatter_text([(torch.float32, 3), (torch.float64, 1)]), "sm_80")
    assert text.count("add.f64") >= 4 and "cas" not in text  # no loop of compare and swap
    assert ".visible .entry put(" in ptx(put_text(DTYPES), "sm_90")


def test_without_a_driver_nothing_is_compiled_and_the_message_says_what_is_missing():
    target = gpu_of(torch.device("cuda", 0)) if not torch.cuda.is_available() else AnyDevice("NVIDIA's compile=False")
    with pytest.raises(RuntimeError, match="NVIDIA's .*compile=False"):
        target.compile(traced_program(lambda x: [x + 1], [torch.float32], [LANES]))


def test_on_other_devices_lanes_are_moved_by_torch():
    target = target_of(torch.device("meta"))
    targets, place = [torch.zeros(4), torch.zeros(4, dtype=torch.bool)], torch.tensor([2, 0], dtype=torch.int32)
    target.put(targets, place, [torch.tensor([1.0, 2.0]), torch.tensor([True, False])])
    assert targets[0].tolist() == [2, 0, 1, 0] and targets[1].tolist() == [False, False, True, False]
    case = addition(100, 9, 2, target.copies(9), torch.float32)
    target.scatter_add([case], 100)
    assert case.sums.totals[0].any() and case.sums.touched.all()
    with pytest.raises(RuntimeError, match="for the CPU and for GPUs of NVIDIA's"):
        target.compile(None)
