"""The scene parameters that a recipe recovers: finding them by name, initial values, bounds."""

from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.formats.image import read_image
from torch_radbp.plugin import nearest
from torch_radbp.plugin.domain import Domain
from torch_radbp.scene.parameters import held_values
from torch_radbp.texture.bitmap import Bitmap
from torch_radbp.texture.neural import NeuralTexture
from torch_radbp.training import recipe
from torch_radbp.training.recipe_values import Value
from torch_radbp.training.recovery.network import OnBitmap, Texels, WaveNetwork
from torch_radbp.training.recovery.rigid import PoseError, Rigid, components, moved


class Sigmoid(nn.Module):
    """Maps an unconstrained tensor into the open interval (lower, upper)."""

    def __init__(self, lower: float, upper: float):
        super().__init__()
        self.lower, self.upper = lower, upper

    def forward(self, raw: Tensor) -> Tensor:
        return self.lower + (self.upper - self.lower) * torch.sigmoid(raw)

    def right_inverse(self, value: Tensor) -> Tensor:
        # A value on a bound has an infinite logit and no gradient; start a thousandth inside.
        return torch.logit((value - self.lower) / (self.upper - self.lower), eps=1e-3)


class Exponential(nn.Module):
    """Maps an unconstrained tensor to positive values."""

    def forward(self, raw: Tensor) -> Tensor:
        return raw.exp()

    def right_inverse(self, value: Tensor) -> Tensor:
        return value.log()


@dataclass
class RecoveredParameter:
    """One tensor of the scene that the optimiser changes.

    Attributes:
        name: as in `scene.named_parameters()`.
        module: the plugin that holds it.
        attribute: its name there.
        spec: the recipe's table.
        before: its initial value, detached.
        truth: its true value where one is known; only reports look at it.
    """

    name: str
    module: nn.Module
    attribute: str
    spec: recipe.Parameter
    before: Tensor
    truth: Tensor | None
    stand_in: nn.Module | None = None  # what the scene has instead of the plugin: a network

    @property
    def value(self) -> Tensor:
        """The current value as the renderer sees it, detached."""
        with torch.no_grad():
            return getattr(self.module, self.attribute).detach().clone()

    @property
    def raw(self) -> nn.Parameter:
        """The leaf that the optimiser changes."""
        if parametrize.is_parametrized(self.module, self.attribute):
            return self.module.parametrizations[self.attribute].original
        return getattr(self.module, self.attribute)

    @property
    def is_small(self) -> bool:
        """True for a colour, a number or a matrix, which is shown entry by entry, unlike a picture or a mesh."""
        return self.before.numel() <= 16

    @property
    def is_picture(self) -> bool:
        """True for a bitmap, (H, W, 1 or 3)."""
        return not self.is_small and self.before.dim() == 3 and self.before.shape[-1] in (1, 3)

    @property
    def is_pose(self) -> bool:
        """True for a (4, 4) matrix that is recovered as a rotation and a translation."""
        return self.spec.parametrisation == "rigid"

    def motion(self, pose: Tensor) -> dict[str, float]:
        """The motion from the initial pose to another by component, rotations in degrees."""
        return components(self.before, pose)

    def pose_error(self, pose: Tensor) -> PoseError:
        """Angle and distance between a pose and the true one."""
        return PoseError.between(pose, self.truth)

    @property
    def distance_column(self) -> str:
        """The column of metrics.csv with the RMS difference from the truth."""
        return f"{self.name}:rmse"

    def columns(self, value: Tensor) -> dict[str, float]:
        """Returns columns of metrics.csv at a value: every entry of a small parameter, the mean of a large one, the error.

        Of a pose, the motion from the initial one: rotation vector in degrees and translation.
        """
        if self.is_pose:
            columns = {f"{self.name}:{key}": entry for key, entry in self.motion(value).items()}
        elif value.dim() == 0:
            columns = {self.name: value.item()}
        elif self.is_small:
            columns = {f"{self.name}[{index}]": entry for index, entry in enumerate(value.flatten().tolist())}
        else:
            columns = {f"{self.name}:mean": value.mean().item()}
        if self.truth is not None:
            columns[self.distance_column] = (value - self.truth).square().mean().sqrt().item()
        return columns

    @torch.no_grad()
    def project_(self) -> None:
        """Puts the value back between its bounds, where no parametrisation does."""
        if self.spec.bounds is not None and self.spec.parametrisation == "clamp":
            self.raw.clamp_(*self.spec.bounds)

    def settle(self, scene: nn.Module) -> None:
        """Ends the parametrisation: the scene holds the plain value again."""
        if self.stand_in is not None:
            replace(scene, self.stand_in, self.module)
        if parametrize.is_parametrized(self.module, self.attribute):
            parametrize.remove_parametrizations(self.module, self.attribute)
        self.raw.requires_grad_(False)


def choose_parameters(scene: nn.Module, specs: list[recipe.Parameter]) -> list[RecoveredParameter]:
    """Finds the recipe's parameters in the scene and sets them to their initial values.

    Nothing is changed unless everything is right.

    Raises:
        ValueError: a name that does not exist (with the nearest), a wrong shape, a value that is not finite, out of
            bounds, or none that the parameter can have, such as a pose that is no affine transform.
    """
    known, held = dict(scene.named_parameters()), held_values(scene)
    chosen: dict[str, RecoveredParameter] = {}
    for spec in specs:
        names = [name for name in known if fnmatchcase(name, spec.name)]
        if not names:
            raise ValueError(f"parameter {spec.name!r} does not exist in the scene; {nearest(spec.name, known)}")
        for name in names:
            if name in chosen:
                raise ValueError(f"parameter {name!r} is named twice, by {chosen[name].spec.name!r} and {spec.name!r}")
            chosen[name] = _choose(scene, name, known[name], spec, held[name].domains)
    for parameter in chosen.values():
        _start(scene, parameter)
    return list(chosen.values())


def _choose(scene: nn.Module, name: str, held: Tensor, spec: recipe.Parameter, domains: list[Domain]) -> RecoveredParameter:
    path, _, attribute = name.rpartition(".")
    module = scene.get_submodule(path)
    if spec.parametrisation == "network" and not (isinstance(module, Bitmap) and attribute == "data"):
        raise ValueError(f'parametrisation = "network" is for the data of bitmaps, and parameter {name!r} is the '
                         f"{attribute} of a {type(module).__name__}; name a bitmap's data, or take another parametrisation")
    before = _initial(held, spec, name)
    if spec.truth is None or spec.truth == "scene":
        truth = None if spec.truth is None else held.detach().clone()
    else:
        truth = _tensor_like(held, spec.truth, name, "truth")
    if spec.bounds is not None:
        lower, upper = spec.bounds
        outside = (before < lower) | (before > upper)
        if outside.any():
            raise ValueError(
                f"parameter {name!r}: initial values must be within bounds [{lower:g}, {upper:g}], "
                f"got {before[outside].flatten()[0].item():g}"
            )
    if spec.parametrisation == "log" and not (before > 0).all():
        raise ValueError(f'parameter {name!r}: parametrisation = "log" needs positive initial values')
    if spec.parametrisation == "rigid":
        _check_poses(name, before, truth)
    for role, value in (("initial", before), ("truth", truth)):
        for domain in domains if value is not None else ():
            domain.check(f"parameter {name!r}: {role}", value)
    return RecoveredParameter(name, module, attribute, spec, before, truth)


def _initial(held: Tensor, spec: recipe.Parameter, name: str) -> Tensor:
    """Returns the value that a recipe starts from."""
    if spec.parametrisation == "rigid" and held.shape != (4, 4):
        raise ValueError(f'parameter {name!r}: parametrisation = "rigid" is for matrices of shape (4, 4), this one has '
                         f"{tuple(held.shape)}; leave it out or name a to_world")
    if spec.parametrisation == "network":
        texels = make_texels(spec, held)
        return texels(texels.right_inverse(held))
    if spec.initial is None:
        return held.detach().clone()
    if isinstance(spec.initial, recipe.Offset):
        rotation, translation = torch.tensor([spec.initial.rotation, spec.initial.translation]).to(held)
        return moved(held.detach(), torch.deg2rad(rotation), translation)
    return _tensor_like(held, spec.initial, name, "initial")


def _check_poses(name: str, before: Tensor, truth: Tensor | None) -> None:
    """Raises ValueError unless the matrices are affine, and differ by a rigid motion."""
    for role, matrix in (("initial", before), ("truth", truth)):
        if matrix is not None and not torch.equal(matrix[3], matrix.new_tensor([0.0, 0.0, 0.0, 1.0])):
            raise ValueError(f"parameter {name!r}: the last row of {role} must be 0 0 0 1, got {matrix[3].tolist()}")
    if truth is None:
        return
    turn = (before[:3, :3].double() @ torch.linalg.inv(truth[:3, :3].double()))
    if (turn @ turn.T - torch.eye(3).to(turn)).abs().max() > 1e-4 or torch.linalg.det(turn) < 0:
        raise ValueError(f'parameter {name!r}: parametrisation = "rigid" rotates and moves, but initial and truth differ '
                         "in scale, shear or handedness too; use another parametrisation or a matching initial value")


def _tensor_like(held: Tensor, value: Value, name: str, role: str) -> Tensor:
    """Returns a recipe's value as a tensor of the parameter's shape, dtype and device."""
    if isinstance(value, Path):
        tensor = read_image(value)
        source = f"the image {value} of shape"
    else:
        try:
            tensor = torch.tensor(value, dtype=held.dtype)
        except ValueError:
            raise ValueError(f"parameter {name!r}: {role} must be one number or have shape {tuple(held.shape)}; "
                             "the rows given differ in length") from None
        source = "shape"
    tensor = tensor.to(device=held.device, dtype=held.dtype)
    if tensor.dim() == 0:
        tensor = tensor.expand(held.shape)
    if tensor.shape != held.shape:
        raise ValueError(
            f"parameter {name!r}: {role} must be one number or have shape {tuple(held.shape)}, "
            f"got {source} {tuple(tensor.shape)}"
        )
    if not tensor.isfinite().all():
        raise ValueError(f"parameter {name!r}: {role} must be finite, got NaN or infinity")
    return tensor.clone()


def _start(scene: nn.Module, parameter: RecoveredParameter) -> None:
    spec = parameter.spec
    leaf = parameter.raw
    with torch.no_grad():
        leaf.copy_(parameter.before)
    leaf.requires_grad_()
    if spec.parametrisation == "sigmoid":
        parametrize.register_parametrization(parameter.module, parameter.attribute, Sigmoid(*spec.bounds))
    elif spec.parametrisation == "log":
        parametrize.register_parametrization(parameter.module, parameter.attribute, Exponential())
    elif spec.parametrisation == "rigid":
        parametrize.register_parametrization(parameter.module, parameter.attribute, Rigid(parameter.before))
    elif spec.parametrisation == "network":
        texels = make_texels(spec, leaf)
        parametrize.register_parametrization(parameter.module, parameter.attribute, texels)
        parameter.stand_in = NeuralTexture(OnBitmap(texels.network, parameter.raw, parameter.module))
        replace(scene, parameter.module, parameter.stand_in)


def make_texels(spec: recipe.Parameter, held: Tensor) -> Texels:
    """Returns the map from the weights of a recipe's network to the texels of a bitmap like `held`."""
    return Texels(WaveNetwork(spec.network or recipe.Network(), spec.bounds, held.shape[2]), held.shape).to(held)


def replace(scene: nn.Module, old: nn.Module, new: nn.Module) -> None:
    """Puts a module wherever another one stands in a scene."""
    for holder in list(scene.modules()):
        for name, child in list(holder.named_children()):
            if child is old:
                setattr(holder, name, new)
