"""Where the radiance of the paths of a call goes, and from where its derivative comes back.

That of an image goes to the pixels of films (`pixels.py`). A sink of another kind is a class with this interface: it adds up
what lanes bring, and the backward pass asks it for the derivative of the loss with respect to that.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from torch import Tensor

from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.tensors.vec import Vec2, Vec3

Call = TypeVar("Call")  # a `render_call.RenderCall`, which has a sink
Work = Callable[[Wavefront], tuple[list[Tensor], Any]]  # of each wavefront what `deposit` gives, and anything else


class SinkValues(NamedTuple):
    """The values that a sink has collected from all lanes, such as images."""

    values: Tensor  # such as images
    filters: Tensor | None  # by which sums were divided; None: by nothing
    results: list  # what else was found of each wavefront


class Sink(ABC, Generic[Call]):
    """The interface of what collects the radiance of paths, such as films; it is linear in the radiance."""

    at_vertices: ClassVar[bool] = False  # paths, from lamps, bring something at each vertex: see `deposits`

    def deposits(self, call: Call) -> Any:
        """An object that sums what the vertices of paths from lamps contribute, with methods `add` and `total`."""
        raise TypeError(f"to a {type(self).__name__} paths bring their radiance")

    def backward_integrand(self, integrand: Integrand, adj_sums: Any) -> Integrand:
        """The integrand that the backward pass differentiates, which may contain the derivatives `adj_sums`."""
        return integrand

    def asked_everywhere(self, call: Call, integrand: Integrand) -> Integrand:
        """The integrand that the backward pass would differentiate if the derivative of the loss were 1 everywhere, for
        predictions of memory."""
        return integrand

    @abstractmethod
    def deposit(self, call: Call, wavefront: Wavefront, values: Sequence[Tensor],
                samples: CameraSample) -> list[Tensor]:
        """The contributions of a wavefront's lanes, summed for each of its chunks.

        Args:
            values: C tensors (N,), the channels of the lanes: linear RGB radiance, and AOVs.
            samples: the first rays of the lanes.
        """

    @abstractmethod
    def gather(self, call: Call, work: Work) -> SinkValues:
        """The values of all wavefronts of the call, for each of which `work` is called (`of_wavefronts`)."""

    @abstractmethod
    def adj_sums(self, call: Call, gradient: Tensor, filters: Tensor | None) -> Any:
        """The derivative of the loss by what `deposit` returns, for use by `adjoint`; computed once.

        Args:
            gradient: derivative of the loss with respect to `SinkValues.values`.
            filters: of the forward pass, if the derivative has the same samples; else None.
        """

    @abstractmethod
    def adjoint(self, call: Call, wavefront: Wavefront, place: Vec2 | None, adj_sums: Any) -> Vec3:
        """The derivative of the loss by L_1 of each lane of a wavefront, (N,): the transpose of `deposit`.

        Args:
            place: (N,) positions of the lanes in their pixels; None: they belong to no pixels.
            adj_sums: the result of `adj_sums`.
        """

    def bytes_held(self, call: Call) -> int:
        """The greatest memory in bytes for sums, values and their derivatives, for predictions."""
        raise TypeError(f"the memory of a {type(self).__name__} is not predicted")

    def radiance(self, values: Tensor) -> Tensor:
        """The part of `SinkValues.values` that is differentiable by radiance: images without AOVs."""
        return values
