"""Checks of the contract between a material and the path tracer: what its methods take and return.

`Kind` says it; `CheckedKind` holds a kind to it, call by call, and `check_contract` calls each function once on a few lanes.
Errors name the plugin and the method, where Python's own would name neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from torch_radbp.interface.bsdf import Kind, LobeChoice, Values
from torch_radbp.plugin import BSDF, Texture
from torch_radbp.tensors.vec import Vec3

COSINES = (0.9, 0.4, -0.7)  # of the lanes on which functions are called; more than one, so that a Python `if` shows
HALF = 0.5  # of all values there
BRANCH = "Boolean value of Tensor"  # of torch's message about a Python `if`
ADVICE = "; every lane is another path, and all are computed at once: use torch.where or a product, no Python `if`"


class CheckedKind:
    """A wrapper around the scattering functions of a material (its `Kind`) that checks the results of every method.

    Args:
        kind: of the material.
        plugin: its name, for messages.

    Raises:
        TypeError: from each method, if that of the kind raises anything, or returns another type or dtype than it should;
            from `eval_pdf`, `sample`, ... by name.
        ValueError: if it returns tensors of another shape.
    """

    def __init__(self, kind: Kind, plugin: str):
        self.kind, self.plugin = kind, plugin

    def __getattr__(self, name: str) -> Any:
        return getattr(self.kind, name)

    def where(self, method: str) -> str:
        """The name of plugin and method, for messages."""
        return f"the bsdf {self.plugin!r}: {type(self.kind).__name__}.{method}"

    def call(self, method: str, *arguments: Any) -> Any:
        """Calls a scattering function; what it raises becomes a TypeError that names the function."""
        try:
            return getattr(self.kind, method)(*arguments)
        except torch.OutOfMemoryError:
            raise
        except Exception as error:
            advice = ADVICE if BRANCH in str(error) else ""
            if isinstance(error, IndexError):
                advice = f"; it is given as many values as `slots` says, {self.kind.slots}"
            raise TypeError(f"{self.where(method)} raised {type(error).__name__}: {error}{advice}") from error

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        results = self.call("eval_pdf", values, wi, wo, *((True,) if fixed_lobes else ()))  # asked of discrete lobes alone
        if not (isinstance(results, tuple) and len(results) == 2):
            got = f"{len(results)} results" if type(results) is tuple else f"a {type(results).__name__} alone"
            raise TypeError(f"{self.where('eval_pdf')} must return two results, the BSDF times the cosine and the density "
                            f"of `sample`, got {got}")
        self.check_vector("eval_pdf", "the first result", results[0], wi.z)
        self.check_lanes("eval_pdf", "the second result, the density,", results[1], wi.z)
        return results

    def eval(self, values: Values, wi: Vec3, wo: Vec3) -> Vec3:
        return self.check_vector("eval", "the result", self.call("eval", values, wi, wo), wi.z)

    def pdf(self, values: Values, wi: Vec3, wo: Vec3) -> Tensor:
        return self.check_lanes("pdf", "the result", self.call("pdf", values, wi, wo), wi.z)

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        return self.check_vector("sample", "the result", self.call("sample", values, wi, choice, u, v), wi.z)

    def choose(self, values: Values, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor) -> LobeChoice:
        lobe_choice = self.call("choose", values, wi, choice if self.kind.discrete else None, u, v)
        if not isinstance(lobe_choice, LobeChoice):
            raise TypeError(f"{self.where('choose')} must return a LobeChoice, got a {type(lobe_choice).__name__}")
        self.check_lanes("choose", "lobe", lobe_choice.lobe, wi.z)
        self.check_lanes("choose", "probability", lobe_choice.probability, wi.z)
        if lobe_choice.delta is not None:
            self.check_lanes("choose", "delta", lobe_choice.delta, wi.z.bool())
        if self.kind.delta and self.kind.smooth and lobe_choice.delta is None:
            raise TypeError(f"{self.where('choose')} must say in `delta` which lanes picked a delta lobe, got None: the "
                            f"kind has both delta and smooth lobes")
        return lobe_choice

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        return self.check_vector("specular", "the result", self.call("specular", values, wi, choice), wi.z)

    def spread(self, values: Values, wi: Vec3, choice: LobeChoice) -> Tensor | None:
        result = self.call("spread", values, wi, choice)
        return None if result is None else self.check_lanes("spread", "the result", result, wi.z)

    def check_vector(self, method: str, what: str, result: Any, like: Tensor) -> Vec3:
        """Returns `result` if it is a vector of the shape and dtype of `like`, else raises."""
        if not all(hasattr(result, component) for component in "xyz"):
            raise TypeError(f"{self.where(method)}: {what} must be a Vec3, got a {type(result).__name__}"
                            f"{f' of shape {tuple(result.shape)}' if isinstance(result, Tensor) else ''}")
        for component in "xyz":
            self.check_lanes(method, f"{component} of {what}", getattr(result, component), like)
        return result

    def check_lanes(self, method: str, what: str, result: Any, like: Tensor) -> Tensor:
        """Returns `result` if it is a tensor of the shape (or of shape (), if all lanes agree) and dtype of `like`; else
        raises.
        """
        if not isinstance(result, Tensor):
            raise TypeError(f"{self.where(method)}: {what} must be a tensor of one number for each lane, got a "
                            f"{type(result).__name__}")
        if result.shape not in (like.shape, ()):
            raise ValueError(f"{self.where(method)}: {what} must have shape (N,) as the directions, {tuple(like.shape)}, "
                             f"got {tuple(result.shape)}")
        if (result.dtype, result.device) != (like.dtype, like.device) and result.shape != ():
            raise TypeError(f"{self.where(method)}: {what} must be {like.dtype} on {like.device} as the directions, got "
                            f"{result.dtype} on {result.device}")
        return result


def checked_kind(bsdf: BSDF) -> CheckedKind:
    """The scattering functions of a material, wrapped in checks of their results; raises as `check_described`."""
    kind = bsdf.kind()
    check_described(bsdf, kind, bsdf.textures())
    return CheckedKind(kind, material_name(bsdf))


def check_described(bsdf: BSDF, kind: Any, textures: Any) -> None:
    """Checks that a material's `kind()` and `textures()` return a `Kind` and as many textures as that takes.

    Raises:
        TypeError: if one is of another type.
        ValueError: if the number of textures is not that of the kind's `slots`.
    """
    plugin = material_name(bsdf)
    if not isinstance(kind, Kind):
        raise TypeError(f"the bsdf {plugin!r}: kind() must return a Kind, got a {type(kind).__name__}")
    try:
        hash(kind)
    except TypeError as error:
        raise TypeError(f"the bsdf {plugin!r}: {type(kind).__name__} must be hashable, as a frozen dataclass of plain "
                        f"values is: {error}") from error
    wrong = [texture for texture in textures if not isinstance(texture, Texture)]
    if wrong:
        raise TypeError(f"the bsdf {plugin!r}: textures() must return textures, got a {type(wrong[0]).__name__}")
    if len(textures) != kind.slots:
        raise ValueError(f"the bsdf {plugin!r}: slots of {type(kind).__name__} must be the number of textures(), which is "
                         f"{len(textures)}, got {kind.slots}")


def material_name(bsdf: BSDF) -> str:
    """The name under which a material is registered, or that of its class."""
    return bsdf.type or type(bsdf).__name__


def check_contract(bsdf: BSDF, kind: Kind, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> None:
    """Calls each function of a material on a few lanes, and checks the results; once for each kind.

    Args:
        bsdf: the material.
        kind, textures: as its methods have returned them.
        dtype, device: of the scene.

    Raises: as `check_described` and the methods of `CheckedKind`.
    """
    check_described(bsdf, kind, textures)
    call_each(kind, material_name(bsdf), dtype, device)


@lru_cache(maxsize=256)
def call_each(kind: Kind, plugin: str, dtype: torch.dtype, device: torch.device) -> None:
    """Calls each scattering function of a kind on a few lanes; raises as the methods of `CheckedKind`."""
    with torch.no_grad():
        checked, z = CheckedKind(kind, plugin), torch.tensor(COSINES, dtype=dtype, device=device)
        half = torch.full_like(z, HALF)
        wi, values = Vec3((1.0 - z * z).sqrt(), torch.zeros_like(z), z), (Vec3(half, half, half),) * kind.slots
        choice = checked.choose(values, wi, half, half, half)
        checked.eval_pdf(values, wi, checked.sample(values, wi, choice, half, half))
        if kind.delta:
            checked.specular(values, wi, choice)
