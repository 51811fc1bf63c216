"""The film of a camera for paths that begin at lamps: each vertex is seen somewhere, and counts in the pixels around.

Each pixel is the sum of what is deposited, by the reconstruction filter over its integral, over the number of paths.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.sink import Sink, SinkValues, Work
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.connection.camera import asked_by
from torch_radbp.film.position import FilmTensors
from torch_radbp.jit.order import chosen
from torch_radbp.jit.scatter import PAGE_BITS, Addition, Sums, copies, scatter_add
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.wavefront import BroughtToFilm
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.record import rows_between
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.tensors.vec import Vec2, Vec3, max_component, rows
from torch_radbp.threads.workers import by_number, in_turns

PIECE = 1 << 15  # lanes that are deposited at once, so that what they count in all pixels around takes little memory


@dataclass(frozen=True)
class LightFilm(Sink):
    """The window of one camera's film.

    Args:
        film: of the camera, without derivatives.
        shape: height and width of the window.
        paths: how many there are.
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
        return Vec3(*(gradient[0].flatten(1) / self.paths))

    def asked(self, integrand: Integrand, adj_sums: Vec3) -> Integrand:
        scene = asked_by(integrand.scene, adj_sums)
        return integrand._replace(scene=scene, proposal=scene, parts={})

    def adjoint(self, call: RenderCall, wavefront: Wavefront, place: Vec2 | None, adj_sums: Vec3) -> Vec3:
        one = torch.ones(wavefront.lanes, dtype=adj_sums.x.dtype, device=adj_sums.x.device)
        return Vec3(one, one, one)


class Deposits:
    """What some paths have brought to a film.

    Args:
        film, shape: as of `LightFilm`.
        stages: what runs functions of lanes.
    """

    def __init__(self, film: FilmTensors, shape: tuple[int, int], stages: Stages):
        self.film, self.stages = film, stages
        pixels, device = shape[0] * shape[1], film.size_x.device
        self.attached: Tensor | None = None  # (3, pixels), where autograd records, or in forward mode
        totals = torch.zeros(pixels, 3, copies(pixels, device), dtype=torch.float64, device=device)
        self.totals = totals.unbind(1)  # those of a pixel lie side by side
        self.sums = Sums(self.totals, torch.zeros(-(-pixels >> PAGE_BITS), dtype=torch.bool, device=device))

    def add(self, brought: BroughtToFilm) -> None:
        """Adds what vertices bring, (N,)."""
        if any_differentiated(brought) or inside_dual_level():
            self.attached = self.totals[0].new_zeros(3, len(self.totals[0])) if self.attached is None else self.attached
            value = torch.stack(tuple(brought.value)).double()
            for pixel, count in self.film.around(brought.place):
                self.attached = self.attached.index_add(1, pixel, value * count)
            return
        # Many bring nothing: what the camera does not see, or is not theirs to bring.
        brought = rows(brought, chosen(max_component(brought.value.map(torch.abs)) != 0))
        lanes, on_cpu = len(brought.place.x), brought.place.x.device.type == "cpu"
        piece = PIECE if on_cpu else max(lanes, 1)
        for first in range(0, lanes, piece):
            counts = self.stages(splats)(self.film, *rows_between(brought, first, min(first + piece, lanes)))
            scatter_add([Addition(pixel, parts, self.sums) for pixel, *parts in counts])

    def total(self) -> Tensor:
        """(3, pixels) float64, attached."""
        total = torch.stack(self.totals).sum(2)
        return total if self.attached is None else total + self.attached


@stage("film")
def splats(film: FilmTensors, value: Vec3, place: Vec2) -> tuple[tuple[Tensor, Tensor, Tensor, Tensor], ...]:
    """For each pixel around places its number, (N,) int32, and what values count there."""
    return tuple((pixel, *(value * count)) for pixel, count in film.around(place))
