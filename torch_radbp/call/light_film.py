"""The film of a camera for paths that begin at lamps: each vertex is seen somewhere, and counts in the pixels around.

Each pixel is the sum of what is deposited, by the reconstruction filter over its integral, over the number of paths.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.call.pixels import IMAGE_COPIES
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.sink import Sink, SinkValues, Work
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.connection.camera import with_pixel_adjoints
from torch_radbp.film.position import FilmTensors
from torch_radbp.jit.order import chosen
from torch_radbp.jit.patches import CHANNELS, Patches, add_patches
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.wavefront import BroughtToFilm
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.interleaved import interleaved
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.tensors.vec import Vec2, Vec3, rows
from torch_radbp.threads.workers import by_number, in_turns

SUMS = 2  # of a worker: all of before, and of a wavefront
BROUGHT, OF_PATCH = 5, 14  # numbers of what a vertex brings, and about so many of the rectangle in which it counts
PIECE = 1 << 14  # lanes that are deposited at once, so that what they count in all pixels around takes little memory


@dataclass(frozen=True)
class LightFilm(Sink[RenderCall]):
    """The window of one camera's film as the sink of paths from lamps.

    Args:
        film: the film's tensors, without derivatives.
        shape: height and width of the window.
        paths: the number of paths.
    """

    film: FilmTensors
    shape: tuple[int, int]
    paths: int
    at_vertices: ClassVar[bool] = True

    def deposits(self, call: RenderCall) -> Deposits:
        return Deposits(self.film, self.shape, call.stages)

    def deposit(self, call: RenderCall, wavefront: Wavefront, values: Sequence[Tensor],
                samples: CameraSample) -> list[Tensor]:
        raise TypeError("paths bring something to this film at each vertex")

    def gather(self, call: RenderCall, work: Work) -> SinkValues:
        def brought_by(share: Iterable[int]) -> tuple[Tensor, list]:
            total, results = 0.0, []
            for index in share:
                (sums,), result = work(call.wavefronts[index])
                total = total + sums
                results.append(result)
            return total, results

        shares = in_turns(len(call.wavefronts), call.workers, brought_by)
        image = (sum(total for total, _ in shares) / self.paths).to(self.film.size_x.dtype)
        return SinkValues(image.view(1, 3, *self.shape), None, by_number([results for _, results in shares]))

    def adj_sums(self, call: RenderCall, gradient: Tensor, filters: Tensor | None) -> Vec3:
        with_margin = torch.nn.functional.pad(gradient[0] / self.paths, (self.film.margin,) * 4)
        return interleaved(Vec3(*with_margin.flatten(1)))

    def backward_integrand(self, integrand: Integrand, adj_sums: Vec3) -> Integrand:
        scene = with_pixel_adjoints(integrand.scene, adj_sums)
        return integrand._replace(scene=scene, proposal=scene, parts={})

    def bytes_held(self, call: RenderCall) -> int:
        pixels, margin = self.shape[0] * self.shape[1], 2 * self.film.margin
        with_margin = (self.shape[0] + margin) * (self.shape[1] + margin)
        lanes, number = max(wavefront.lanes for wavefront in call.wavefronts), call.scene.dtype.itemsize
        of_worker = torch.float64.itemsize * (CHANNELS * with_margin + 3 * SUMS * pixels)
        of_worker += number * (BROUGHT * lanes * call.integrand.bounces + OF_PATCH * min(lanes, PIECE))
        return call.workers * of_worker + IMAGE_COPIES * 3 * with_margin * number

    def asked_everywhere(self, call: RenderCall, integrand: Integrand) -> Integrand:
        return self.backward_integrand(integrand, self.adj_sums(call, self.film.size_x.new_ones(1, 3, *self.shape), None))

    def adjoint(self, call: RenderCall, wavefront: Wavefront, place: Vec2 | None, adj_sums: Vec3) -> Vec3:
        one = torch.ones(wavefront.lanes, dtype=adj_sums.x.dtype, device=adj_sums.x.device)
        return Vec3(one, one, one)


class Deposits:
    """The sums of what the vertices of paths from lamps contribute to a film.

    Args:
        film, shape: as of `LightFilm`.
        stages: what runs functions of lanes.
    """

    def __init__(self, film: FilmTensors, shape: tuple[int, int], stages: Stages):
        self.film, self.shape, self.stages = film, shape, stages
        self.attached: Tensor | None = None  # (3, pixels), where autograd records, or in forward mode
        rows, columns = (pixels + 2 * film.margin for pixels in shape)
        self.totals = torch.zeros(rows, columns, CHANNELS, dtype=torch.float64, device=film.size_x.device)

    def add(self, brought: BroughtToFilm) -> None:
        """Adds the contributions of N vertices."""
        if any_differentiated(brought) or inside_dual_level():
            pixels = self.shape[0] * self.shape[1]
            self.attached = self.totals.new_zeros(3, pixels) if self.attached is None else self.attached
            value = torch.stack(tuple(brought.value)).double()
            for pixel, count in self.film.around(brought.place):
                self.attached = self.attached.index_add(1, pixel, value * count)
            return
        # Many bring nothing: what the camera does not see, or is not theirs to bring.
        lanes = chosen(self.stages(brings)(brought.value))
        for some in lanes.split(PIECE if lanes.device.type == "cpu" else max(len(lanes), 1)):
            add_patches(self.stages(patches)(self.film, brought, some), self.totals)

    def total(self) -> Tensor:
        """The sums, (3, pixels) float64, attached."""
        (rows, columns), margin = self.shape, self.film.margin
        total = self.totals[margin:margin + rows, margin:margin + columns, :3].permute(2, 0, 1).flatten(1)
        return total if self.attached is None else total + self.attached


@stage()
def brings(value: Vec3) -> Tensor:
    """(N,) bool: colours that are not 0, such as what vertices of paths bring to the film."""
    return (value.x != 0) | (value.y != 0) | (value.z != 0)


@stage("film", "brought")
def patches(film: FilmTensors, brought: BroughtToFilm, lanes: Tensor) -> Patches:
    """The pixels around film positions, and what contributions count in each.

    Args:
        film: the film with its margin, without border.
        brought: the contributions of all vertices.
        lanes: (N,) int32, the vertices to use.
    """
    value, place = rows(brought, lanes)
    first, down, across = film.patch(place)
    return Patches(first, tuple(value), tuple(down), tuple(across))
