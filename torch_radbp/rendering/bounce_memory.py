"""Measures the peak memory of one bounce, on a few paths.

What a bounce computes depends on the scene: on its kinds of material, its textures, what moves. So nothing is assumed: a
bounce, its adjoint and, for `TapeAdjoint`, a whole path are taken on two small numbers of lanes, and all that torch
allocates is counted. The difference between the two is what grows with the lanes; gradients of tables do not.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from torch_radbp.adjoint.attached import trace_attached
from torch_radbp.adjoint.outside import ModuleGradients, values_that_move
from torch_radbp.adjoint.scatter import Gradients, bytes_of_totals
from torch_radbp.adjoint.sweep import PathRecord, Sweep, numbered_leaves
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.step import Step
from torch_radbp.path.texture_networks import number_outside
from torch_radbp.path.wavefront import take_step
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.record import tensors_in
from torch_radbp.tensors.torch_internals import TorchDispatchMode, tree_flatten
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.module_bank import ModuleBank
from torch_radbp.threads.team import alone_in_torch

LANES = (1024, 3072)  # of the two measurements


class LinearSize(NamedTuple):
    """A number of bytes as a linear function of the number of lanes."""

    per_lane: float
    fixed: float


NOTHING = LinearSize(0.0, 0.0)


class TableBytes(NamedTuple):
    """Bytes that tables with derivatives need, for any number of lanes."""

    packed: float = 0.0  # the tables, which each call packs anew from the parameters
    totals: float = 0.0  # sums of each worker, while bounces are differentiated
    packing: float = 0.0  # peak of autograd's backward pass through packing, afterwards


class BounceMemory(NamedTuple):
    """Peak bytes of a bounce, beside its inputs."""

    bounce: LinearSize
    adjoint: LinearSize
    tape: LinearSize | None  # kept by autograd for whole paths; None if nothing is recorded
    outside: LinearSize = NOTHING  # needed by modules, for the lanes that they compute at once,
    at_once: float = 0.0  # whose number, per thread, is at most this
    held: float = 0.0  # of a lane's adjoints that wait for modules to run on them, see `outside.HELD`
    tables: TableBytes = TableBytes()


class AllocatedBytes(TorchDispatchMode):
    """Counts the bytes of tensors made within the block: `alive` now, and at the `peak`."""

    def __init__(self):
        super().__init__()
        self.alive = self.peak = 0
        self.counted = WeakIdKeyDictionary()

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        for tensor in tensors_in((args, kwargs)):
            self.counted.setdefault(tensor.untyped_storage(), True)
        made = function(*args, **kwargs)
        for tensor in tensors_in(made):
            self.add(tensor)
        return made

    def add(self, tensor: Tensor) -> None:
        """Counts a tensor's storage, if it is new, until it is freed."""
        storage = tensor.untyped_storage()
        if storage not in self.counted:
            self.counted[storage] = True
            self.alive += storage.nbytes()
            self.peak = max(self.peak, self.alive)
            weakref.finalize(storage, self.take_off, storage.nbytes())

    def take_off(self, size: int) -> None:
        self.alive -= size


def linear_size(measure: Callable[[int], float]) -> LinearSize:
    """The linear function through two measurements."""
    few, many = (measure(lanes) for lanes in LANES)
    per_lane = max(0.0, (many - few) / (LANES[1] - LANES[0]))
    return LinearSize(per_lane, max(0.0, few - per_lane * LANES[0]))


def tables_of(leaves: Sequence[Tensor], parameters: Sequence[Tensor]) -> TableBytes:
    """The bytes for gradients of `leaves`, which are attached to `parameters`."""
    if not leaves:
        return TableBytes()
    with torch.enable_grad(), AllocatedBytes() as allocated:
        gradients = [torch.zeros_like(leaf) for leaf in leaves]
        torch.autograd.grad(leaves, parameters, gradients, retain_graph=True, allow_unused=True)
    given = {parameter.untyped_storage().data_ptr() for parameter in parameters}
    packed = sum(leaf.nbytes for leaf in leaves if leaf.untyped_storage().data_ptr() not in given)
    return TableBytes(packed, bytes_of_totals(leaves), allocated.peak)


def measured(integrand: Integrand, asked: Integrand, attached: Integrand | None, start: Callable[[int], PathState],
             wanted: tuple[bool, ...]) -> BounceMemory:
    """Measures the peak memory of a bounce, forwards and backwards.

    Args:
        integrand: of the detached scene.
        asked: the same with the settings by which the backward pass differentiates it.
        attached: of the attached scene, if derivatives are recorded by autograd; else None.
        start: makes a given number of camera paths.
        wanted: for each leaf of the scene, whether the derivative by it is wanted.
    """
    numbered = numbered_leaves(integrand.scene, wanted)

    def of_bounce(lanes: int) -> float:
        state = start(lanes)
        with torch.no_grad(), AllocatedBytes() as allocated:
            take_step(integrand, state, 0)
        return allocated.peak

    def sweep_of(state: PathState, step: Step, numbered: SceneTensors) -> tuple[Gradients, Sweep]:
        record = PathRecord(lambda: state, None, {}, {0: step}, 1)
        gradients = Gradients([leaf for leaf, want in zip(tree_flatten(integrand.scene)[0], wanted) if want])
        return gradients, Sweep(asked, record, Vec3.full(state.pdf, 1.0), numbered, gradients)

    def of_adjoint(lanes: int) -> float:
        state = start(lanes)
        with torch.no_grad():
            step = take_step(integrand, state, 0)[-1]
            _, sweep = sweep_of(state, step, without_modules(numbered))
            with AllocatedBytes() as allocated:
                sweep.adjoint(state, 0)
        return allocated.peak

    def of_outside(lanes: int) -> float:
        state, peak = start(lanes), 0.0
        with torch.no_grad():
            step = take_step(integrand, state, 0)[-1]
            gradients, _ = sweep_of(state, step, numbered)
            modules = ModuleGradients(integrand.scene, numbered, gradients)
            for queue in step.queues:
                places = integrand.places(queue.event, step.arrival(state), step.order[queue.first:queue.last], 0)
                scatterer = integrand.scatterer(queue.event)
                with AllocatedBytes() as allocated:
                    if integrand.settings.moving:
                        values_that_move(integrand.scene, [(scatterer, places)])
                    ones = tuple(Vec3.full(place.at.x, 1.0) for place in places)
                    modules.hold(modules.adjoints(scatterer, places, ones), lanes)
                    modules.add_held()
                peak = max(peak, allocated.peak)
        return peak

    def of_tape(lanes: int) -> float:
        state = start(lanes)
        with torch.enable_grad(), AllocatedBytes() as allocated:
            recorded = trace_attached(attached, state)
            alive = allocated.alive
        del recorded
        return alive

    with alone_in_torch(threads=1):  # what others allocate is not counted
        outside = (linear_size(of_outside), at_once(integrand.scene), held_of(integrand)) if (
            integrand.scene.layout.reads_outside) else ()
        return BounceMemory(linear_size(of_bounce), linear_size(of_adjoint),
                            None if attached is None else linear_size(of_tape), *outside)


def without_modules(numbered: SceneTensors) -> SceneTensors:
    """A record of the scene's structure with the gradient index of each leaf, without those of modules' parameters."""
    def emptied(bank):
        return bank._replace(parameters=tuple((None,) * len(own) for own in bank.parameters)) if (
            isinstance(bank, ModuleBank)) else bank

    return numbered._replace(textures=tuple(map(emptied, numbered.textures)), lit=tuple(map(emptied, numbered.lit)))


def held_of(integrand: Integrand) -> float:
    """The greatest number of bytes per lane that network textures hold in the backward pass: rows, inputs, and adjoints."""
    layout = integrand.scene.layout
    values = max(number_outside(layout, scatterer, integrand.settings.nee) for scatterer in (None, *layout.appearances))
    return values * (torch.int32.itemsize + 2 * len(Vec3._fields) * integrand.scene.lights.choice.pmf.dtype.itemsize)


def at_once(scene: SceneTensors) -> float:
    """The greatest number of lanes that a module of the scene computes at once."""
    return max(bank.size(module, scene.device) for bank in (*scene.textures, *scene.lit) if isinstance(bank, ModuleBank)
               for module in range(len(bank.functions)))
