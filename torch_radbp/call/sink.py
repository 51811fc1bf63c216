"""Where the radiance of the paths of a call goes, and from where its derivative comes back.

That of an image goes to the pixels of films (`pixels.py`). A sink of another kind is a class with this interface: it adds up
what lanes bring, and the backward pass asks it for the derivative of the loss with respect to that.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from torch import Tensor

from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.tensors.vec import Vec2, Vec3

if TYPE_CHECKING:
    from torch_radbp.call.render_call import RenderCall
    from torch_radbp.call.wavefronts import Wavefront

Work = Callable[["Wavefront"], tuple[list[Tensor], Any]]  # of each wavefront what `deposit` gives, and anything else


class SinkValues(NamedTuple):
    """What a sink has of all lanes."""

    values: Tensor  # such as images
    filters: Tensor | None  # by which sums were divided; None: by nothing
    results: list  # what else was found of each wavefront


class Sink(ABC):
    """Where radiance goes; linear in it."""

    at_vertices: ClassVar[bool] = False  # paths, from lamps, bring something at each vertex: see `deposits`

    def deposits(self, call: RenderCall) -> Any:
        """What takes in what the vertices of a wavefront bring: with `add` and `total`."""
        raise TypeError(f"to a {type(self).__name__} paths bring their radiance")

    def asked(self, integrand: Integrand, adj_sums: Any) -> Integrand:
        """The integrand as the backward pass differentiates it, which may depend on what `adjoint` reads."""
        return integrand

    def asked_everywhere(self, call: RenderCall, integrand: Integrand) -> Integrand:
        """`asked` where the derivative of the loss is 1 for all values, for predictions of memory."""
        return integrand

    @abstractmethod
    def deposit(self, call: RenderCall, wavefront: Wavefront, values: Sequence[Tensor],
                samples: CameraSample) -> list[Tensor]:
        """What the lanes of a wavefront bring, for each of its chunks.

        Args:
            values: C of (N,), of the lanes: linear RGB radiance, and the quantities of the call.
            samples: with which their paths begin.
        """

    @abstractmethod
    def gather(self, call: RenderCall, work: Work) -> SinkValues:
        """All that comes in; `work` is to be done for each wavefront of the call (`of_wavefronts`)."""

    @abstractmethod
    def adj_sums(self, call: RenderCall, gradient: Tensor, filters: Tensor | None) -> Any:
        """Derivative of the loss with respect to what `deposit` gives, which `adjoint` reads; made once.

        Args:
            gradient: derivative of the loss with respect to `SinkValues.values`.
            filters: of the forward pass, if the derivative has its samples; else None.
        """

    @abstractmethod
    def adjoint(self, call: RenderCall, wavefront: Wavefront, place: Vec2 | None, adj_sums: Any) -> Vec3:
        """Derivative of the loss with respect to what counts of L_1 of each lane, (N,): the transpose of `deposit`.

        Args:
            place: of the lanes in their pixels; None: they are of no pixels.
            adj_sums: of `adj_sums`.
        """

    def bytes_held(self, call: RenderCall) -> int:
        """The bytes of all sums, of the values and of their derivatives, at the most, for predictions of memory."""
        raise TypeError(f"the memory of a {type(self).__name__} is not predicted")

    def radiance(self, values: Tensor) -> Tensor:
        """The part of `SinkValues.values` that has a derivative by radiance."""
        return values
