"""Images by parameters: ten tasks from three lamp powers to a sky of 8 x 16 texels and a network of 195 weights."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

import torch_radbp as rb

EYE = [0.0, 0.0, 4.0]
SIZE = 24  # pixels of most views, each way
REFLECTANCES = [f"{name}.reflectance.value" for name in ("white", "green", "red")]
LAMP = "light.emitter.radiance.value"


class Task(NamedTuple):
    """Images by parameters, which stand at the truth."""

    images: Callable[[int, int | None], Tensor]
    parameters: dict[str, Tensor]
    scene: rb.Scene
    start: Callable[[Tensor, torch.Generator], Tensor]  # where a search begins, of the truth
    unit: Callable[[Tensor], Tensor] = torch.abs  # what errors are relative to, of the true values that are compared
    prior: float | None = None  # standard deviation of what is known beforehand of each number, in the calibration
    outputs: Callable[[], Tensor] | None = None  # what is compared, of the parameters; None: these themselves

    @property
    def size(self) -> int:
        """The number of parameters."""
        return sum(parameter.numel() for parameter in self.parameters.values())

    def position(self) -> Tensor:
        """The values of all parameters, (n,) float64."""
        return torch.cat([parameter.detach().reshape(-1).double() for parameter in self.parameters.values()])

    def move(self, values: Tensor) -> None:
        """Assigns values to all parameters, (n,)."""
        parts = values.split([parameter.numel() for parameter in self.parameters.values()])
        with torch.no_grad():
            for parameter, part in zip(self.parameters.values(), parts, strict=True):
                parameter.copy_(part.view(parameter.shape))

    def compared(self) -> Tensor:
        """What is compared with the truth, (k,) float64."""
        return self.position() if self.outputs is None else self.outputs().detach().reshape(-1).double()


class Rigid(nn.Module):
    """Motions of a pose by u, (2, 3): radians about the world's axes, and a translation."""

    def __init__(self, base: Tensor):
        super().__init__()
        self.base = base

    def forward(self, u: Tensor) -> Tensor:
        return rb.se3(u[0], u[1]) @ self.base

    def right_inverse(self, pose: Tensor) -> Tensor:
        return pose.new_zeros(2, 3)


def rgb(*value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(value)}


def scaled(factor: float):
    return torch.diag(torch.tensor([factor, factor, factor, 1.0])).numpy()


def camera(size: int = SIZE, eye=EYE, aim=(0.0, 0.0, 0.0)) -> dict[str, Any]:
    pose = rb.look_at(eye, list(aim), [0.0, 1.0, 0.0]).numpy()
    return {"type": "perspective", "fov": 40, "to_world": pose, "film": {
        "type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}}


def lit(subject: dict[str, Any], sensors: dict[str, Any] | None = None, **objects: Any) -> rb.Scene:
    """A subject under a lamp and an even sky."""
    return rb.load_dict({"type": "scene", **(sensors or {"sensor": camera()}), "subject": subject,
                         "sky": {"type": "constant", "radiance": rgb(0.3, 0.4, 0.5)},
                         "lamp": {"type": "point", "position": [2, 3, 4], "intensity": rgb(40, 38, 35)}} | objects)


def near(share: float) -> Callable[[Tensor, torch.Generator], Tensor]:
    """A start that is off by up to a share of each value."""
    return lambda truth, generator: truth * (1 + share * (2 * torch.rand(len(truth), generator=generator,
                                                                          dtype=truth.dtype) - 1))


def rendered(scene: rb.Scene, names: list[str], depth: int = 4, share: float = 0.4, prior: float | None = None) -> Task:
    renderer = rb.Renderer(scene, max_depth=depth)
    return Task(lambda seed, spp: renderer(seed=seed, spp=spp), {name: scene.get_parameter(name) for name in names}, scene,
                near(share), prior=prior)


def cornell() -> rb.Scene:
    return rb.load(rb.asset("cornell_box/scene.xml"), resolution=SIZE)


def roughness() -> Task:
    ball = {"type": "sphere", "bsdf": {"type": "roughconductor", "alpha": 0.3, "specular_reflectance": rgb(0.8, 0.6, 0.4)}}
    return rendered(lit(ball), ["subject.bsdf.alpha.value", "subject.bsdf.specular_reflectance.value"])


def index() -> Task:
    """A ball of glass before a pattern without edges."""
    ball = {"type": "sphere", "bsdf": {"type": "dielectric", "int_ior": 1.5}}
    pattern = 0.2 + 0.6 * torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(4))
    floor = {"type": "rectangle", "to_world": rb.look_at([0.0, 0, -3], [0.0, 0, 0], [0.0, 1, 0]).numpy() @ scaled(6),
             "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": pattern.numpy(), "raw": True}}}
    return rendered(lit(ball, floor=floor), ["subject.bsdf.eta"], 6, 0.03)


def pose() -> Task:
    scene = lit({"type": "cube", "to_world": scaled(0.7), "bsdf": {"type": "diffuse", "reflectance": rgb(0.7, 0.5, 0.3)}})
    parametrize.register_parametrization(scene.subject, "to_world", Rigid(scene.subject.to_world.detach().clone()))
    renderer, motion = rb.Renderer(scene, max_depth=2), scene.subject.parametrizations.to_world.original
    with torch.no_grad():
        motion[0] += torch.tensor([0.4, 0.5, 0.1])  # corners of a cube that is seen head on are degenerate
    return Task(lambda seed, spp: renderer(seed=seed, spp=spp), {"motion": motion}, scene, lambda truth, generator:
                truth + 0.1 * (torch.rand(6, generator=generator, dtype=truth.dtype) - 0.5), torch.ones_like)


def wall_of(reflectance: dict[str, Any]) -> rb.Scene:
    return lit({"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": reflectance}},
               {"sensor": camera(SIZE, [0.0, 0.0, 2.8])})


def texture() -> Task:
    """16 x 16 texels of one channel, which fill the view."""
    texels = 0.2 + 0.6 * torch.rand(16, 16, 1, generator=torch.Generator().manual_seed(1))
    return rendered(wall_of({"type": "bitmap", "data": texels.numpy(), "raw": True}), ["subject.bsdf.reflectance.data"], 2,
                    prior=0.3)


def environment() -> Task:
    """8 x 16 texels of three channels, which a ball of metal shows to two cameras."""
    sky = 0.5 + torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(2))
    ball = {"type": "sphere", "bsdf": {"type": "roughconductor", "alpha": 0.1}}
    scene = rb.load_dict({"type": "scene", "sensor": camera(), "other": camera(SIZE, [0.0, 1.0, -4.0]), "subject": ball,
                          "sky": {"type": "envmap", "bitmap": sky.numpy()}})
    return rendered(scene, ["sky.data"], 3, prior=0.1)  # narrow: no fit may make radiance negative


def network() -> Task:
    """195 weights of colours on a wall; compared are the colours at 8 x 8 places, since weights take each other's part."""
    with torch.random.fork_rng():
        torch.manual_seed(5)
        module = nn.Sequential(nn.Linear(2, 32), nn.Tanh(), nn.Linear(32, 3), nn.Sigmoid())
    with torch.no_grad():
        module[0].weight.mul_(4)
        module[2].weight.mul_(3)
    scene = wall_of(rgb(0.5, 0.5, 0.5))
    scene.subject.bsdf.reflectance = rb.NeuralTexture(module)
    renderer, axis = rb.Renderer(scene, max_depth=2), (torch.arange(8) + 0.5) / 8
    places = torch.cartesian_prod(axis, axis)
    return Task(lambda seed, spp: renderer(seed=seed, spp=spp), dict(module.named_parameters()), scene, near(0.4),
                prior=0.1, outputs=lambda: module(places.to(module[0].weight.dtype)))


def exposure() -> Task:
    """The colour of a ball and the gains of the second and third of three views."""
    sensors = {f"view{number}": camera(SIZE, [3 * math.sin(angle), 1.0, 3 * math.cos(angle)])
               for number, angle in enumerate((0.0, 1.0, 2.0))}
    scene = lit({"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": rgb(0.7, 0.5, 0.3)}}, sensors)
    gains = rb.Exposure(3, fixed=0, white_balance=False, gains=torch.tensor([1.0, 1.6, 0.7]))
    renderer = rb.Renderer(scene, max_depth=2)
    return Task(lambda seed, spp: gains(renderer(seed=seed, spp=spp), torch.arange(3)),
                {"colour": scene.get_parameter("subject.bsdf.reflectance.value"), "log_gain": gains.log_gain}, scene,
                lambda truth, generator: near(0.4)(truth, generator) * torch.tensor([1, 1, 1, 0, 1, 1], dtype=truth.dtype),
                lambda truth: truth.abs().clamp_min(0.1))


TASKS: dict[str, Callable[[], Task]] = {
    "colours": lambda: rendered(cornell(), REFLECTANCES[1:]),
    "roughness": roughness,
    "lamp": lambda: rendered(cornell(), [LAMP]),
    "pose": pose,
    "index": index,
    "exposure": exposure,
    "Cornell box": lambda: rendered(cornell(), [*REFLECTANCES, LAMP], share=0.25),
    "network": network,
    "texture": texture,
    "environment": environment,
}
