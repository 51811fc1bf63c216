"""The parameters of a rendering that require a gradient."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from torch_radbp.plugin import Sensor
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.modules.scene import Scene, modules_of


def wanted_parameters(scene: Scene, seen: Sequence[Sensor], cache: PackCache,
                      beside: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The parameters that require a gradient, by name: of the scene, of its rendered sensors, and of `beside`.

    Raises:
        RuntimeError: if gradients are recorded, and one of these was made in inference mode.
    """
    roots = [*((name, sensor) for name, sensor in scene.named_sensors.items() if sensor in seen), ("", scene)]
    parameters = dict(pair for name, root in roots for pair in cache.structure(differentiable_in, root, name))
    parameters |= {name: value for name, value in beside.items() if value.requires_grad}
    if torch.is_grad_enabled():
        check_recordable(parameters)
    return parameters


def differentiable_in(root: nn.Module, prefix: str = "") -> list[tuple[str, Tensor]]:
    """The parameters that require a gradient, each once, of one sensor or of a scene without its sensors."""
    by_id: dict[int, tuple[str, Tensor]] = {}
    for name, module in modules_of(root, prefix):
        for attribute, value in module._parameters.items():
            if value is not None and value.requires_grad:
                by_id.setdefault(id(value), (f"{name}.{attribute}".removeprefix("."), value))
    return list(by_id.values())


def check_recordable(parameters: dict[str, Tensor]) -> None:
    """Raises RuntimeError naming the first parameter that requires a gradient but was made in inference mode.

    torch records nothing that is done with such a tensor, so that images would have no gradient.
    """
    for name, parameter in parameters.items():
        if parameter.is_inference():
            raise RuntimeError(f"the parameter {name!r} requires a gradient, but was made under torch.inference_mode(), and "
                               f"torch records nothing of such tensors: load the scene, and copy or convert it, outside of "
                               f"inference_mode(); what is loaded outside may be rendered inside")
