"""The images of a call, wavefront by wavefront."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.adjoint.record import Allowance, trace_both, trace_wavefront
from torch_radbp.adjoint.sweep import PathRecord
from torch_radbp.call.finite import FirstNonFinite, all_finite, checked_stages, image_error
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.sink import SinkValues
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.taped_bounces import Bounce, repeating
from torch_radbp.path.wavefront import bounced


def render_images(call: RenderCall, integrand: Integrand, record: bool,
                  bounce: Bounce = bounced) -> SinkValues:
    """Renders a call wavefront by wavefront: the values of its sink, and the records for the backward pass, if `record`."""
    allowance = Allowance(call.record_bytes if record else 0)

    def trace_one(wavefront: Wavefront) -> tuple[list[Tensor], PathRecord | None]:
        if record and call.together:
            return trace_both(call, integrand, wavefront)
        keeping = allowance.left > 0
        sums, path_record = trace_wavefront(call, integrand, wavefront, 0, keeping, bounce)
        return sums, path_record if keeping and allowance.covers(path_record) else None

    images = call.sink.gather(call, trace_one)
    _check_images(call, integrand, call.sink.radiance(images.values).detach())
    return images


def _check_images(call: RenderCall, integrand: Integrand, images: Tensor) -> None:
    """Raises NonFiniteError if a pixel of the images is NaN or infinite."""
    if all_finite([images], integrand.repetitions):
        return

    def trace_again(integrand: Integrand, finding: FirstNonFinite) -> None:
        for wavefront in call.wavefronts:
            if finding.depth is None:
                trace_wavefront(call, integrand.with_stages(checked_stages(finding)), wavefront, 0, record=False)

    with torch.no_grad():
        call = call.still()
        raise image_error(images, integrand.still(), call.module, trace_again)


def render_detached(call: RenderCall) -> Tensor:
    """Renders images and AOVs without derivatives."""
    call = call.still()
    with torch.no_grad():
        return call.repetitions.enough(lambda some: render_images(
            call, repeating(call.integrand, some), record=False)).values
