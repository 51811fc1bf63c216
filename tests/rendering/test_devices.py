"""No stage holds a tensor of the wrong device: the stages are traced for arguments on CUDA, and stay there.

The arguments lie on `meta`, without values, and say that they are on CUDA. torch's own fake tensors do not do: a torch
without CUDA makes them, but its autograd refuses them ("Cannot access accelerator device when none is available"). These
are of `meta` for autograd and of CUDA for whoever asks: a stage cannot tell the difference.
"""

from __future__ import annotations

from importlib import import_module

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

import torch_radbp as rb
from benchmarks.ptx import Listing
from tests.rendering.recorded import SAMPLINGS, SCENES, build, calls_of, stage_named
from torch_radbp.jit.compiled import Compiled
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.nvidia.nvptx import ptx
from torch_radbp.jit.stages import CompiledStage, CompiledStages
from torch_radbp.tensors.record import leaves_of, with_leaves

CUDA = torch.device("cuda", 0)
ANSWERS = {Tensor.is_cuda.__get__: lambda tensor: tensor.is_meta, Tensor.is_meta.__get__: lambda tensor: False,
           Tensor.device.__get__: lambda tensor: CUDA if tensor.is_meta else tensor.device,
           Tensor.data_ptr: lambda tensor: getattr(tensor, "address", id(tensor))}


def names_cuda(argument) -> bool:
    """True for CUDA as the functions of torch take it."""
    return isinstance(argument, (torch.device, str)) and str(argument).startswith("cuda")


class SaysCuda(TorchFunctionMode):
    """Tensors on `meta` say that they are on CUDA, and what is to be made on CUDA is made there."""

    def __torch_function__(self, function, types, args=(), kwargs=None):
        if function in ANSWERS:
            return ANSWERS[function](*args)
        here = {"device": "meta"} if names_cuda((kwargs or {}).get("device")) else {}
        return function(*["meta" if names_cuda(argument) else argument for argument in args], **(kwargs or {}) | here)


class Elsewhere(TorchDispatchMode):
    """Fails where an operation of torch reads or makes a tensor of the host."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        result = function(*args, **kwargs or {})
        for tensor in leaves_of((args, list((kwargs or {}).values()), result)):
            if isinstance(tensor, Tensor) and not tensor.is_meta:
                raise AssertionError(f"{function}: a tensor on {tensor.device} where all are on CUDA")
        return result


def trace_on_cuda(stage, arguments: tuple) -> set[torch.device]:
    """The devices of what a stage returns for arguments that are moved to CUDA, without their values."""
    moved = [torch.empty_like(leaf, device="meta") if isinstance(leaf, Tensor) else leaf for leaf in leaves_of(arguments)]
    with torch.no_grad(), SaysCuda(), Elsewhere():
        return {leaf.device for leaf in leaves_of(stage(*with_leaves(arguments, moved))) if isinstance(leaf, Tensor)}


OF_MANY_LAMPS, OF_TWO_SIDES = {"pick_light", "emitter_met", "chance_of_light"}, {"side_met"}
OF_JUMPS = {"slopes", "swept", "adjoint_of_motion", "scaled_slopes"}
OF_SEGMENTS = {"segment_weight", "segment_place"}
OF_CROSSINGS = {"segment_bounds", "segment_found", "segment_passed", "sheets_seen"}
OF_SHADOWS = {"descended", "edge_found", "edge_tried", "edge_passed", "direct_light", "scattered", "border_course",
              "cut_course", "light_eyes", "light_lobes", "light_samples", "picked_vertex", "meets", "film_sample",
              *OF_CROSSINGS}
OF_CONTACTS = {"light_line"}  # of bodies that touch
OF_MIRRORS = {"goes_on", "ideal_vertex", "no_direction", "scattered_ideally", "parted", "unparted", "drawn_by_steps",
              "side_between", "walked", "way_to_light"}
OF_FEW_EDGES = {"edge_tried"}  # few beside the samples
OF_EDGES = {"boxes_around", "contour_length", "contour_place", "crosses", "edge_bounds", "edge_place", "edge_weight",
            "in_sight", "merged_bounds", "paths_beside", "ray_along_edge", "rays_beside"}
OF_WAYS = {"emission_begun", "emission_on_segment", "hides_all", "is_tracked_in", "let_through", "next_segment",
           "next_shadow_segment", "no_crossing", "on_boundary", "shadow_ahead", "shadow_begun", "surface_ahead",
           "tracking_begun", "tracking_on", "way_begun"}  # through media
OF_MEDIA = {"direct_light_in_medium", "free_flight", "leaving_towards", "scattered_by_medium", *OF_WAYS}  # that scatter
OF_LAMPS = {"brings", "affects_loss", "is_connected", "patches", "sample_lamps", "shining"}  # which begin at no network
WITHOUT_ASKED = {"fog": {"affects_loss"}, "smoke": {"affects_loss", "is_connected"},
                 "networks": {"affects_loss"}}  # of all vertices
# Stages that a scene does without.
NOT_IN = {"materials": {"places", "way_to_light", *OF_MANY_LAMPS, *OF_FEW_EDGES},
          "lamps": {"places", *OF_TWO_SIDES, *OF_JUMPS, *OF_MIRRORS, *OF_FEW_EDGES},
          "shapes": {"places", *OF_MANY_LAMPS, *OF_TWO_SIDES, *OF_MIRRORS, *OF_FEW_EDGES},
          "textures": {"places", *OF_MANY_LAMPS, *OF_TWO_SIDES, *OF_FEW_EDGES},
          "fog": {"places", "corner_rows", "ray_along_edge", *OF_MANY_LAMPS, *OF_TWO_SIDES, *OF_SHADOWS, *OF_SEGMENTS,
                  *OF_MIRRORS},
          "smoke": {"places", "corner_rows", *OF_MANY_LAMPS, *OF_TWO_SIDES, *OF_JUMPS, *OF_SHADOWS, *OF_SEGMENTS,
                    *OF_MIRRORS, *OF_FEW_EDGES, *OF_EDGES},
          "networks": {"ending", "shines", "sheets_seen", *OF_MANY_LAMPS, *OF_TWO_SIDES, *OF_MIRRORS, *OF_FEW_EDGES},
          "shining networks": {"shines", "cut_course", "scattered", *OF_MANY_LAMPS, *OF_TWO_SIDES, *OF_SEGMENTS,
                               *OF_CROSSINGS, *OF_MIRRORS, *OF_FEW_EDGES}}


ALL = [pytest.param(name, sampling, 1, marks=pytest.mark.deep, id=f"{name}-{sampling}, all")
       for name in SCENES for sampling in SAMPLINGS]


def some(every: int):
    """The quick row: each so many calls of a stage."""
    return pytest.param("networks", "hybrid", every, id="networks-hybrid")


@pytest.mark.parametrize("name, sampling, every", [some(4), *ALL])
def test_every_stage_of_every_appearance_stays_on_its_device(name, sampling, every):
    calls, scene = calls_of(name, sampling), build(name)
    without = NOT_IN.get(name, {"places", *OF_MANY_LAMPS, *OF_TWO_SIDES}) | (OF_SHADOWS if sampling == "attached" else set())
    without |= WITHOUT_ASKED.get(name, set()) | OF_CONTACTS | OF_MEDIA | (OF_LAMPS if name == "shining networks" else set())
    assert {stage for stage, cases in calls.items() if not cases} <= without
    scatterers = {arguments[0].layout.scatterer for arguments in calls["bounce"].values()}
    looks = rb.scene.packing.pack.pack(scene).layout.appearances
    assert scatterers - {None} == {look for look in looks if not look.kind.invisible}  # which paths pass
    for name, cases in calls.items():
        for arguments in [*cases.values()][::every]:
            assert trace_on_cuda(stage_named(name), arguments) <= {CUDA}


def load(compiled: Compiled) -> None:
    """Loads the kernel of a function; waits for the helper that does so."""
    if compiled.loop is not None:
        compiled.loop.result().kernel.kernel  # noqa: B018 (a property that waits)


def kernels_on_cuda(stage: CompiledStage, arguments: tuple, monkeypatch) -> list[str]:
    """The kernels that a compiled stage is for arguments that are moved to CUDA, without their values."""
    listing, asked = Listing(), set()
    monkeypatch.setattr(import_module("torch_radbp.jit.run"), "target_of", lambda device: asked.add(device) or Gpu(listing))
    moved: dict[int, Tensor] = {}
    for leaf in leaves_of(arguments):
        if isinstance(leaf, Tensor) and id(leaf) not in moved:
            moved[id(leaf)] = torch.empty_like(leaf, device="meta")
            moved[id(leaf)].address = leaf.data_ptr()  # tables that share their memory are one
    with torch.no_grad(), SaysCuda():
        load(stage.fused.prepared(with_leaves(arguments, [moved.get(id(leaf), leaf) for leaf in leaves_of(arguments)]))[0])
    assert asked == {CUDA}
    return listing.texts


@pytest.mark.parametrize("name, sampling, every", [some(8), *ALL])
def test_every_stage_of_every_appearance_is_ptx_on_cuda(name, sampling, every, monkeypatch):
    """The same kernels as for these arguments on the processor, by a GPU's target; and some where tables lie in rows."""
    stages = CompiledStages()
    for stage, cases in calls_of(name, sampling).items():
        for arguments in [*cases.values()][::every]:
            apart = with_leaves(arguments, [leaf.contiguous() if isinstance(leaf, Tensor) else leaf
                                            for leaf in leaves_of(arguments)])  # as tensors without contents lie
            texts, here, in_rows = kernels_on_cuda(stages(stage_named(stage)), apart, monkeypatch), Listing(), Listing()
            load(CompiledStages(Gpu(here))(stage_named(stage)).fused.prepared(apart)[0])
            if any(isinstance(leaf, Tensor) and not leaf.is_contiguous() for leaf in leaves_of(arguments)):
                load(CompiledStages(Gpu(in_rows))(stage_named(stage)).fused.prepared(arguments)[0])
            assert texts == here.texts and (texts or stage == "material_value")  # some colours are arguments as they are
            assert all(".visible .entry lanes(" in ptx(text, "sm_90") and "store" in text
                       for text in {*texts, *in_rows.texts})


CONSTANT = torch.tensor(0.5)
BAD = {
    "a number": lambda x: x * torch.tensor(0.5),
    "lanes": lambda x: torch.zeros(len(x)) + 1,
    "a constant of the module": lambda x: x * CONSTANT,
    "a copy": lambda x: x.cpu(),
    "a copy on CUDA only": lambda x: x.cpu() if x.is_cuda else x,
    "lanes on CUDA only": lambda x: torch.zeros(len(x)) if x.device.type == "cuda" else x,
}
GOOD = {
    "an operation": lambda x: x.sin(),
    "lanes": lambda x: torch.arange(len(x), device=x.device) + torch.zeros(len(x), device="cuda") + x.new_zeros(len(x)),
    "a copy": lambda x: x.to(x.device) + x.to("cuda:0", torch.float64),
    "a derivative": lambda x: derivative(x.clone().requires_grad_()),
}


def derivative(x: Tensor) -> Tensor:
    with torch.enable_grad():
        return torch.autograd.grad(x.square(), x, torch.ones_like(x))[0]


@pytest.mark.parametrize("stage", BAD.values(), ids=BAD)
def test_a_stage_that_makes_or_reads_a_tensor_of_the_host_is_found(stage):
    with pytest.raises((AssertionError, NotImplementedError)):
        trace_on_cuda(stage, (torch.ones(8),))


@pytest.mark.parametrize("stage", GOOD.values(), ids=GOOD)
def test_a_stage_that_stays_on_its_device_passes(stage):
    assert trace_on_cuda(stage, (torch.ones(8),)) == {CUDA}
