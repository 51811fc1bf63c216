"""Errors about an image or a gradient with NaN or infinity: where in the computation it came from, in words.

Rendering pays for one look at the image and one at the gradients. Only if something is wrong everything is computed once
more, bounce by bounce and with a look at each, to tell which parameter, which material, which bounce and how many paths.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import torch
from torch import Tensor

from torch_radbp.jit.recording.repetitions import Repetitions, read_together
from torch_radbp.path.bounce import bounce, ending
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import Arrival, Position
from torch_radbp.plugin import Plugin, Texture
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.least_and_greatest import least_and_greatest
from torch_radbp.tensors.stage import PlainStages
from torch_radbp.tensors.vec import rows
from torch_radbp.texture.module_function import SMOOTH
from torch_radbp.texture.neural import NeuralTexture

ADVICE = "keep the parameters within bounds, or try float64 (`scene.double()`) and smaller steps"


class NonFiniteError(FloatingPointError):
    """An image or a gradient is NaN or infinite; the message says in which bounce, material and parameter that began.

    Raised by a rendering, and by the backward pass through its image: it names the parameter, the bounce, the material and
    the number of paths. Neither image nor gradient is handed out, so that an optimiser's state stays finite.
    """


def all_finite(tensors: list[Tensor], repetitions: Repetitions | None = None) -> bool:
    """True if every value of all tensors is finite; waits for the device once.

    Raises:
        TooFewRepetitions: if a loop on the device was not repeated to its end.
    """
    found = [least_and_greatest(tensor).double() for tensor in tensors if tensor.numel()]
    return read_together([torch.isfinite(torch.cat(found)).all()] if found else [], repetitions)


def count_of_bad(tensor: Tensor) -> str:
    """The number of values that are not finite, as text for a message."""
    return f"{int((~torch.isfinite(tensor)).sum())} of {tensor.numel()} values"


class FirstNonFinite:
    """Records the first bounce, in the order of computation, whose numbers are not finite."""

    def __init__(self) -> None:
        self.depth: int | None = None
        self.lanes, self.of = 0, 0
        self.prim: Tensor | None = None  # (lanes,) what the bad lanes had hit
        self.in_light = False  # the light is not finite before any surface has reflected it

    def look(self, depth: int, bad: Tensor, prim: Tensor, light: Tensor | None = None) -> None:
        """Records a bounce whose lanes `bad`, (N,) bool, on triangles `prim`, are not finite, unless one is recorded.

        `light`: (N,) bool, whether the light that arrives from emitters is finite; None: unknown.
        """
        if self.depth is None and bool(bad.any()):
            self.depth, self.lanes, self.of, self.prim = depth, int(bad.sum()), len(bad), prim[bad]
            self.in_light = light is not None and not bool(light[bad].all())

    def place(self, tensors: SceneTensors, scene: Scene | None) -> str:
        """Describes the recorded bounce in words."""
        if self.depth is None:
            return "in no bounce alone: sums or products of finite numbers overflow"
        start = f"first at bounce {self.depth + 1}, in {self.lanes} of {self.of} paths, "
        if self.in_light and scene is not None:
            sources = " or ".join(_described(scene, emitter) for emitter in scene.emitters)
            return f"{start}in the light of {sources}, which is too bright"
        return start + most_frequent_surface(self.prim, tensors, scene)


def most_frequent_surface(prim: Tensor, tensors: SceneTensors, scene: Scene | None) -> str:
    """The material to which most of some triangles belong, in words."""
    prim = prim[prim >= 0]
    if scene is None or not len(prim):
        return "of which none hit a surface" if not len(prim) else "on some surface"
    bsdfs = list(scene.bsdfs())
    row = Counter((tensors.triangles.material[prim.long()] % len(bsdfs)).tolist()).most_common(1)[0][0]
    return f"on {_described(scene, bsdfs[row])}"


def _described(scene: Scene, plugin: Plugin) -> str:
    """A plugin by its type and its name in the scene, in words."""
    return f"the {plugin.type} `{scene.name_of(plugin)}`"


def owner_of(scene: Scene, parameter: str) -> str:
    """The plugin (textures aside) that a parameter belongs to, in words; or the user's rays."""
    path = parameter.split(".")[:-1]
    if not path:
        return "the rays"
    for length in range(len(path), 0, -1):
        plugin = scene.get_submodule(".".join(path[:length]))
        if isinstance(plugin, Plugin) and not isinstance(plugin, Texture):
            return _described(scene, plugin)
    return _described(scene, scene.get_submodule(".".join(path)))


def network_of(scene: Scene | None, parameter: str) -> str | None:
    """The name of the network texture whose module has a parameter; None: no module has it."""
    owner = parameter.partition(".module.")[0]
    return owner if scene is not None and isinstance(dict(scene.named_modules()).get(owner), NeuralTexture) else None


def plain_name(parameter: str) -> str:
    """The scene's name of a parameter, without what `torch.nn.utils.parametrize` adds to it."""
    return parameter.replace("parametrizations.", "").removesuffix(".original")


def checked_stages(finding: FirstNonFinite) -> PlainStages:
    """Stages in plain torch that record the first bounce whose terms are not finite in `finding`; for one chunk."""
    depth, counter = -1, None

    def checked(stage: Callable, terms_of: Callable) -> Callable:
        def call(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, lanes: Tensor, at: Position, *rest):
            nonlocal depth, counter
            if at.counter is not counter:  # the first queue of a bounce
                depth, counter = depth + 1, at.counter
            found = stage(scene, proposal, arrival, lanes, at, *rest)
            bad = ~torch.isfinite(torch.stack(terms_of(found))).all(0)
            light = light_is_finite(scene, proposal, arrival, lanes, at, *rest) if bool(bad.any()) else None
            finding.look(depth, bad, arrival.hit.prim[lanes], light)
            return found

        return call

    return PlainStages({bounce: checked(bounce, lambda vertex: [*vertex.Le, *vertex.Ld, *vertex.next.beta]),
                        ending: checked(ending, list)})


def light_is_finite(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, lanes: Tensor, *rest) -> Tensor:
    """(N,) bool: lanes at which emitted light arrives with finite values, before any surface reflects it."""
    terms = scene.layout.vertex.terms(scene, proposal, rows(arrival, lanes), *rest)
    sent = (*terms.Le, *(() if terms.light is None else terms.light.radiance))
    return torch.isfinite(torch.stack(sent)).all(0)


def image_error(images: Tensor, integrand: Integrand, scene: Scene | None,
                trace_again: Callable[[Integrand, FirstNonFinite], None]) -> NonFiniteError:
    """The error about an image that is not finite; paths are traced again to find out why.

    Args:
        images: (B, 3, H, W).
        integrand: detached.
        scene: gives names for the message; None: without names.
        trace_again: traces chunks until the `FirstNonFinite` has a record.
    """
    finding = FirstNonFinite()
    trace_again(integrand, finding)
    return NonFiniteError(f"the image is NaN or infinite in {count_of_bad(images)}: "
                          f"{finding.place(integrand.scene, scene)}; {ADVICE}")


def gradient_error(bad: list[tuple[Tensor, Tensor]], integrand: Integrand, scene: Scene | None,
                   parameters: dict[str, Tensor], sweep_again: Callable[[FirstNonFinite], None]) -> NonFiniteError:
    """The error about a gradient that is not finite; the backward pass is repeated to find out why.

    Args:
        bad: tensors of the scene with their gradients, which are not finite.
        integrand: detached.
        scene: gives names for the message; None: without names.
        parameters: by name, those that are differentiated, from which the tensors were computed.
        sweep_again: differentiates chunks until the `FirstNonFinite` has a record.
    """
    finding = FirstNonFinite()
    sweep_again(finding)
    names = parameters_behind(bad, parameters)
    if scene is not None and names:
        whose = ", ".join(f"`{plain_name(name)}` of {owner_of(scene, plain_name(name))}" for name in names)
    else:
        whose = "the scene"
    bad_values = sum(int((~torch.isfinite(gradient)).sum()) for _, gradient in bad)
    networks = sorted({texture for name in names for texture in [network_of(scene, plain_name(name))] if texture})
    if finding.depth is None and networks:
        place = f"in the derivative of the module of {' or '.join(map(repr, networks))} by its own parameters; {SMOOTH}"
    else:
        place = f"{finding.place(integrand.scene, scene)}; {ADVICE}"
    return NonFiniteError(f"the gradient of {whose} is NaN or infinite in {bad_values} values: {place}")


def parameters_behind(bad: list[tuple[Tensor, Tensor]], parameters: dict[str, Tensor]) -> list[str]:
    """The names of the parameters on which tensor entries with non-finite gradients depend."""
    names = []
    with torch.enable_grad():
        marked = [(leaf, (~torch.isfinite(gradient)).to(leaf.dtype)) for leaf, gradient in bad if leaf.grad_fn is not None]
        for name, parameter in parameters.items():
            if not marked or not parameter.requires_grad:
                continue
            leaves, marks = zip(*marked)
            behind, = torch.autograd.grad(leaves, [parameter], marks, retain_graph=True, allow_unused=True)
            if behind is not None and bool((behind != 0).any()):
                names.append(name)
    return names
