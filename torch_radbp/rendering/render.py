"""`render`: the renderer as a function."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

from torch import Tensor
from typing_extensions import Unpack

from torch_radbp.public_call import passing_on, public_call
from torch_radbp.rendering.renderer import Renderer
from torch_radbp.rendering.settings import RendererSettings, SensorChoice
from torch_radbp.rendering.shots import WindowChoice
from torch_radbp.scene.modules.scene import Scene


@overload
def render(scene: Scene, *, spp: int | None = None, seed: int | None = None, sensors: SensorChoice = None,
           seed_grad: int | None = None, aovs: None = None, window: WindowChoice = None,
           **settings: Unpack[RendererSettings]) -> Tensor: ...


@overload
def render(scene: Scene, *, spp: int | None = None, seed: int | None = None, sensors: SensorChoice = None,
           seed_grad: int | None = None, aovs: Sequence[str], window: WindowChoice = None,
           **settings: Unpack[RendererSettings]) -> tuple[Tensor, dict[str, Tensor]]: ...


@overload
def render(scene: Scene, *, spp: int | None = None, seed: int | None = None, sensors: SensorChoice = None,
           seed_grad: int | None = None, aovs: Sequence[str] | None, window: WindowChoice = None,
           **settings: Unpack[RendererSettings]) -> Tensor | tuple[Tensor, dict[str, Tensor]]: ...


@public_call
@passing_on(RendererSettings.__annotations__, Renderer.__init__)
def render(scene: Scene, *, spp: int | None = None, seed: int | None = None, sensors: SensorChoice = None,
           seed_grad: int | None = None, aovs: Sequence[str] | None = None, window: WindowChoice = None,
           **settings: Unpack[RendererSettings]) -> Tensor | tuple[Tensor, dict[str, Tensor]]:
    """Renders a scene once, as `Renderer(scene, spp, **settings)(seed, sensors, ...)` does; see `Renderer`.

    A loop is faster with one renderer: it keeps what has not changed since its last call.

    Args:
        scene: what is rendered; attached to its parameters.
        seed, sensors, seed_grad, aovs, window: of the call, as in `Renderer.forward`.
        spp, **settings: of the renderer: `max_depth`, `adjoint`, `sampling`, ...

    Returns:
        (B, 3, H, W) linear RGB radiance; if `aovs` are asked for, that and the images of these quantities by name.
    """
    return Renderer(scene, spp, **settings)(seed=seed, sensors=sensors, seed_grad=seed_grad, aovs=aovs, window=window)
