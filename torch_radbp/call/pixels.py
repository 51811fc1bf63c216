"""Splats the lanes of a call to its pixels, and gathers the lanes' adjoints from the pixels' adjoints."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import torch
from torch import Tensor

from torch_radbp.call.chunks import Chunk
from torch_radbp.call.render_call import RenderCall, of_wavefronts
from torch_radbp.call.sink import Sink, SinkValues, Work
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.film.develop import Development, Grid, across, row_sums
from torch_radbp.film.splat import Block, deposited, gathered_by, gathered_from_pixels, offset_sums, sums_in_pairs
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.tensors.record import joined, rows_between
from torch_radbp.tensors.vec import Vec2, Vec3, rows

IMAGE_COPIES = 5  # the sums of its rows, the image, its gradient, that by sums of the filter, and what the loss makes


class Films(Sink[RenderCall]):
    """The films of a call's views as the sink of camera paths: a pixel is the filter-weighted mean of samples around it.

    `SinkValues.values` are images (B, C, H, W), and `SinkValues.filters`, (B, H, W), the sums of the filter over samples.
    """

    def deposit(self, call: RenderCall, wavefront: Wavefront, values: Sequence[Tensor],
                samples: CameraSample) -> list[Tensor]:
        return sums_of_wavefront(call, wavefront, values, samples.place)

    def gather(self, call: RenderCall, work: Work) -> SinkValues:
        developments, results = [Development(view.grid) for view in call.views], []
        for _, members in groupby(call.wavefronts, lambda wavefront: wavefront.group):
            wavefronts = list(members)
            found = of_wavefronts(call, wavefronts, work)
            results += [result for _, result in found]
            sums = [pair for wavefront, (own, _) in zip(wavefronts, found) for pair in zip(wavefront.chunks, own)]
            for (sensor, band), parts in groupby(sums, lambda part: (part[0].sensor, part[0].band)):
                developments[sensor].add(put_together(call.views[sensor].grid, band, list(parts)))
        pixels, filters = zip(*(development.image() for development in developments))
        # Stacked in their final shape: what is no view may be changed in place, also where gradients are wanted.
        return SinkValues(torch.stack(pixels), torch.stack(filters), results)

    def adj_sums(self, call: RenderCall, gradient: Tensor, filters: Tensor | None) -> list[Vec3]:
        """For each view the derivative of the loss by the pixels' sums, to which samples add."""
        filters = filters_of(call, 1) if filters is None else filters
        return [Vec3(*view.grid.quotient(own, sums).flatten(1))
                for view, own, sums in zip(call.views, self.radiance(gradient), filters)]

    def adjoint(self, call: RenderCall, wavefront: Wavefront, place: Vec2 | None, adj_sums: list[Vec3]) -> Vec3:
        return joined([adjoint_of_chunk(call, chunk, rows_between(place, first, last), adj_sums[chunk.sensor])
                       for chunk, first, last in wavefront.parts()])

    def bytes_held(self, call: RenderCall) -> int:
        return IMAGE_COPIES * 3 * sum(view.grid.columns * view.grid.rows for view in call.views) * call.scene.dtype.itemsize

    def radiance(self, values: Tensor) -> Tensor:
        return values[:, :3]


def sums_of_wavefront(call: RenderCall, wavefront: Wavefront, values: Sequence[Tensor], place: Vec2) -> list[Tensor]:
    """Splats the values of a wavefront's lanes: for each chunk the filter-weighted sums of its pixels.

    Args:
        values: C tensors (N,), the channels of the lanes.
        place: (N,) positions of the lanes in their pixels.
    """
    return [deposit_of_chunk(call, chunk, [value[first:last] for value in values], rows_between(place, first, last))
            for chunk, first, last in wavefront.parts()]


def deposit_of_chunk(call: RenderCall, chunk: Chunk, values: Sequence[Tensor], place: Vec2) -> Tensor:
    """The filter-weighted sums of the values of one chunk's lanes; args as for `sums_of_wavefront`."""
    grid, block, stage = call.views[chunk.sensor].grid, Block(place, chunk.samples, call.spp), call.stages(deposited)
    if chunk.samples == call.spp:
        return row_sums(stage, grid, tuple(values), block)
    return offset_sums(stage, grid.kernel, tuple(values), block)  # moved once all samples of the row are there


def put_together(grid: Grid, band: range, parts: list[tuple[Chunk, Tensor]]) -> Tensor:
    """Joins the filter-weighted sums of a band's chunks to (R, 1 + C, n, columns) for the n rows of the band."""
    total = None
    for part, own in groupby(parts, lambda part: part[0].rows):
        found = [sums for _, sums in own]
        one = found[0] if len(found) == 1 else across(grid, sums_in_pairs(torch.stack(found, 3), 3))
        if total is None:
            if part.count == len(band):
                return one
            total = one.new_empty(*one.shape[:2], len(band), grid.columns)
        total[:, :, part.first - band.start::part.apart] = one
    return total


def film_places(call: RenderCall, wavefront: Wavefront, which: int) -> Vec2:
    """The lanes' positions in their pixels, (N,) in [0, 1); `which`: 0 for the image, 1 for its derivative."""
    return joined([call.source.places(chunk, which, call.stages) for chunk in wavefront.chunks])


def filters_of(call: RenderCall, which: int) -> Tensor:
    """The sums of the filter over samples, (B, H, W), of the image (`which` 0) or of its derivative (1)."""
    if all(view.grid.kernel.flat for view in call.views):
        view = call.views[0]
        return torch.full((len(call.views), view.height, view.width), float(call.spp), dtype=call.scene.dtype,
                          device=call.scene.device)

    def work(wavefront: Wavefront) -> tuple[list[Tensor], None]:
        return sums_of_wavefront(call, wavefront, (), film_places(call, wavefront, which)), None

    return Films().gather(call, work).filters


def adjoint_of_chunk(call: RenderCall, chunk: Chunk, place: Vec2, pixels: Vec3) -> Vec3:
    """The derivative of the loss by L_1 of one chunk's lanes, (N,), from those by the pixels of its view."""
    grid = call.views[chunk.sensor].grid
    width = grid.columns + 2 * grid.kernel.reach
    entry = chunk.rows.numbers(call.scene.device, width)
    if grid.kernel.flat:
        # Read once for all samples of a pixel; of a single one `flatten` alone would repeat the same place in memory.
        return rows(pixels, entry).map(lambda each: each[:, None].expand(-1, chunk.samples).flatten().contiguous())
    block = Block(place, chunk.samples, call.spp)
    return Vec3(*gathered_by(call.stages(gathered_from_pixels), grid.kernel, tuple(pixels), block, entry, width, 1))


def weighted(L: Vec3, weight: Tensor | None) -> Vec3:
    """Radiance, or its adjoint, times camera weights (N,), if there are any."""
    return L if weight is None else L * weight
