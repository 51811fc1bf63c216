"""A source and a sink are a class each: rays from a list, and sums over the cells of a grid, in this file alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import pytest
import torch
from torch import Tensor
from torch.autograd import forward_ad

import torch_radbp as rb
from tests.gradients import EXACT, cotangent, relative_error
from tests.scenes import diffuse, furnace, load, overhead, rectangle, rgb
from torch_radbp.call.render_call import of_wavefronts
from torch_radbp.call.sink import Sink, SinkValues
from torch_radbp.call.source import PathSource
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.rendering.transport import transport
from torch_radbp.sampling.sampler import film_lane_key, film_order
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Ray, Vec3

LANES, SIDE = 64, 2
SAMPLINGS = ("detached", "hybrid", "attached")


class RayTable(NamedTuple):
    o: Vec3
    d: Vec3


@dataclass(frozen=True)
class RayList(PathSource):
    """One path along each ray of a list."""

    table: RayTable
    keys: tuple
    which: tuple[int, int] = (0, 1)

    @property
    def tensors(self):
        return self.table

    def with_tensors(self, tensors):
        return replace(self, table=tensors)

    def of_derivative(self):
        return replace(self, which=(1, 1))

    def samples(self, chunk, which, stages, cones):
        lane = torch.arange(chunk.first, chunk.first + chunk.lanes, dtype=torch.int32)
        key = film_lane_key(film_order(LANES, 1, lane.device), lane, torch.zeros_like(lane), self.keys[self.which[which]])
        return CameraSample(Ray(*lookup(self.table, lane)), key, None, None, None)


@dataclass(frozen=True)
class Grid(Sink):
    """(3, SIDE, SIDE, SIDE) sums of radiance over the cells in which rays begin."""

    cell: Tensor  # (lanes,) int64

    def deposit(self, call, wavefront, values, samples):
        return [torch.stack([torch.zeros(SIDE**3, dtype=value.dtype).index_add(
            0, self.cell[chunk.first:chunk.first + chunk.lanes], value[first:last]) for value in values])
            for chunk, first, last in wavefront.parts()]

    def gather(self, call, work):
        done = of_wavefronts(call, call.wavefronts, work)
        sums = sum(part for parts, _ in done for part in parts)
        return SinkValues(sums.view(-1, SIDE, SIDE, SIDE), None, [result for _, result in done])

    def adj_sums(self, call, gradient, filters):
        return Vec3(*gradient.flatten(1))

    def adjoint(self, call, wavefront, place, adj_sums):
        lanes = torch.cat([self.cell[chunk.first:chunk.first + chunk.lanes] for chunk in wavefront.chunks])
        return adj_sums.map(lambda channel: channel[lanes])


def rays(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Origins in the cube from -1/2 to 1/2, (N, 3), directions of unit length, and the cells of the origins."""
    generator = torch.Generator().manual_seed(seed)
    o = torch.rand(LANES, 3, generator=generator, dtype=torch.float64) - 0.5
    d = torch.randn(LANES, 3, generator=generator, dtype=torch.float64)
    place = ((o + 0.5) * SIDE).long()
    return o, d / d.norm(dim=1, keepdim=True), (place[:, 0] * SIDE + place[:, 1]) * SIDE + place[:, 2]


def grid_of(scene, o, d, cell, seed: int = 3, **settings) -> Tensor:
    renderer = rb.Renderer(scene, **settings)
    return transport(renderer, lambda keys: RayList(RayTable(Vec3.of(o), Vec3.of(d)), keys), Grid(cell), LANES, seed)


def lit_floor():
    """A floor far below, under a lamp without extent: what its points send back is a smooth function of the rays."""
    return load(torch.float64, camera=overhead(2), floor=rectangle((0, 0, -2), 50.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                bulb={"type": "point", "position": [0.3, 0.2, 3.0], "intensity": rgb(20, 30, 40)})


@pytest.mark.parametrize("chunk", [None, 10])
@pytest.mark.parametrize("compile", [False, True])
def test_cells_have_what_the_rays_that_begin_in_them_bring(compile, chunk):
    """In a furnace every ray brings the same."""
    o, d, cell = rays()
    scene = furnace()
    settings = {"max_depth": 6, "rr_depth": 100, "nee": False, "compile": compile, "chunk": chunk}
    found = grid_of(scene, o, d, cell, **settings)
    one = rb.Renderer(scene, spp=1, **settings).radiance(o, d, seed=3).detach()
    assert (one > 0).all() and one.std(0).max() < 1e-6 * one.mean()
    counts = torch.bincount(cell, minlength=SIDE**3).view(SIDE, SIDE, SIDE)
    torch.testing.assert_close(found, one[0][:, None, None, None] * counts, rtol=1e-6, atol=0)


@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize("compile", [False, True])
def test_every_strategy_gives_the_gradient_of_the_tape(compile, sampling):
    """Of the rays, and of what they meet."""
    def results(adjoint, compile):
        scene, (o, d, cell) = lit_floor(), rays()
        wanted = [o.requires_grad_(), d.requires_grad_(), *(scene.get_parameter(name).requires_grad_() for name in (
            "floor.bsdf.reflectance.value", "bulb.position"))]
        found = grid_of(scene, o, d, cell, max_depth=3, adjoint=adjoint, compile=compile, sampling=sampling)
        return found.detach(), torch.autograd.grad(found, wanted, cotangent(found.detach()))

    image, expected = results(rb.TapeAdjoint(), False)
    assert all(torch.isfinite(gradient).all() and gradient.abs().max() > 0 for gradient in expected)
    for adjoint in EXACT[:-1]:
        found, gradients = results(adjoint, compile)
        assert relative_error(found, image) < 1e-12
        for gradient, wanted in zip(gradients, expected):
            assert relative_error(gradient, wanted) < 1e-10, adjoint


@pytest.mark.parametrize("compile", [False, True])
def test_derivatives_by_the_rays_are_those_of_differences(compile):
    """Backwards and forwards."""
    o, d, cell = rays()
    settings = {"max_depth": 2, "compile": compile}
    direction, step = cotangent(o, 1), 1e-5
    after, before = (grid_of(lit_floor(), o + sign * step * direction, d, cell, **settings) for sign in (1, -1))
    difference = (after - before) / (2 * step)
    assert difference.abs().max() > 0.01
    wanted = o.clone().requires_grad_()
    found = grid_of(lit_floor(), wanted, d, cell, **settings)
    w = cotangent(difference)
    gradient, = torch.autograd.grad(found, [wanted], w)
    assert float((gradient * direction).sum()) == pytest.approx(float((difference * w).sum()), rel=1e-6)
    with forward_ad.dual_level(), torch.no_grad():
        dual = grid_of(lit_floor(), forward_ad.make_dual(o, direction), d, cell, **settings)
        tangent = forward_ad.unpack_dual(dual).tangent
    assert relative_error(tangent, difference) < 1e-6


def test_a_moving_shape_is_warned_of():
    scene, (o, d, cell) = lit_floor(), rays()
    scene.get_parameter("floor.to_world").requires_grad_()
    with pytest.warns(rb.SilhouetteWarning, match="no area"):
        grid_of(scene, o, d, cell, max_depth=2)
