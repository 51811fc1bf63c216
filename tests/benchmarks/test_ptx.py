"""PTX of every stage of every kind: NVIDIA's assembler takes it, and what is spilled is known."""

import pytest

from benchmarks.ptx import ARCHITECTURES, BENCHMARKS, counts, kernels, kernels_of_benchmark
from benchmarks.ptxas import Rejected, assemble, find
from tests.deep import deep_but
from tests.rendering.recorded import SAMPLINGS, SCENES

pytestmark = pytest.mark.skipif(find() is None, reason="no ptxas: the wheel nvidia-cuda-nvcc-cu12 is not installed")

# A thread has 255 registers. The adjoint of a bounce has to keep what its forward half computed until the backward half
# has used it, for dozens of wanted parameters at once: some hundred numbers of a plain material, and of the rough ones up to
# a thousand. In the order in which they are computed, and any other that was tried, more are alive than there are registers.
# The bounce is just beyond the limit on a principled material, and under lamps of every kind at once.
SPILLS = {"bounce_adjoint": 10_000, "bounce": 128}  # bytes that are stored, at most


def check(scene: str, sampling: str, architectures) -> set[str]:
    """Asserts that all kernels of a scene are assembled, and spill no more than is listed; returns their stages."""
    found = set()
    for kernel in {kernel.text: kernel for kernel in kernels(scene, sampling)}.values():
        found.add(kernel.stage)
        for architecture in architectures:
            used, _, fusible, *_ = counts(kernel.text, architecture)
            assert 0 < used.registers <= 255 and fusible == 0
            assert used.stores <= SPILLS.get(kernel.stage, 0), (kernel.stage, kernel.kind, used)
            assert 8 * kernel.parameters <= 32_764  # bytes that PTX has for them
    return found


@pytest.mark.deep
def test_kernels_of_a_room_with_networks_are_assembled():
    assert {"bounce", "bounce_adjoint", "places", "rows"} <= check("networks", "hybrid", ARCHITECTURES[-1:])


# Of all their kernels one spills: the adjoint of rough metal whose vertices move, with 236 bytes.
@pytest.mark.parametrize("scene", deep_but(["cornell-box", "metal-mesh-vertices"], BENCHMARKS))
def test_kernels_of_the_benchmarks_spill_hardly_anything(scene):
    pytest.importorskip("warp")
    found = kernels_of_benchmark(scene)
    assert {"bounce", "bounce_adjoint", "rows", "brightened"} <= {kernel.stage for kernel in found}
    assert all(counts(kernel.text, "sm_90").usage.stores <= 256 for kernel in found)


@pytest.mark.deep
@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize("scene", SCENES)
def test_kernels_of_every_stage_and_kind_are_assembled(scene, sampling):
    assert {"bounce", "bounce_adjoint"} <= check(scene, sampling, ARCHITECTURES)


def test_what_is_no_ptx_is_rejected():
    with pytest.raises(Rejected, match="syntax error|Parsing error"):
        assemble(".version 8.1\n.target sm_90\n.address_size 64\nnonsense", "sm_90", find())
