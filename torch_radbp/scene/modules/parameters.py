"""The parameters of a scene by name, and the check that the values of each are in its domain.

Parameters change between renderings. So all are compared with those of the last one (see `scene.cache.pack_cache`), and what
has changed is checked: first the shapes, then the extremes.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from functools import cache, partial
from typing import NamedTuple

import torch
from torch import Tensor, nn

from torch_radbp.interface.volume import VolumeFunction
from torch_radbp.plugin import REGISTRY, Plugin, Texture, nearest
from torch_radbp.plugin.domain import LARGEST_COORDINATE, LEEWAY, Domain
from torch_radbp.scene.cache.inventory import reach_of, tensors_of
from torch_radbp.scene.cache.module_attributes import modules_in
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.cache.same_bits import fetched_of, numbers_on_host
from torch_radbp.scene.modules.scene import Scene, modules_of
from torch_radbp.shape.instance import Instance
from torch_radbp.shape.surface import Surface
from torch_radbp.tensors.asked_later import asked_later, presuming
from torch_radbp.tensors.differentiated import differentiated, primal
from torch_radbp.texture.bitmap import reader_of
from torch_radbp.texture.module_function import Use

DTYPES = (torch.float32, torch.float64)
NOT_FINITE = "; a smaller learning rate or bounds may keep it finite"
OUTSIDE = ("; keep it inside, with scene.clamp_() after each step, rb.optim.bounded(optimizer, scene), or a parametrisation "
           "such as rb.optim.Sigmoid")


class Held(NamedTuple):
    """A parameter or texture table of a scene, with all domains in which its values must be."""

    owner: nn.Module
    attribute: str | None  # None: the values of a texture
    domains: list[Domain]
    reach: frozenset[int]  # ids of the tensors that the value depends on, see `Inventory.reach`

    @property
    def value(self) -> Tensor:
        """The current value of the parameter, or of the texture's table."""
        return self.owner.texels() if self.attribute is None else getattr(self.owner, self.attribute)


def held_values(scene: Scene) -> dict[str, Held]:
    """Every parameter of a scene, and everything else in it that has a domain, by name.

    The result of a parametrisation has the name of the parameter that it replaces. The values of a texture must be in the
    domains of all attributes for which it is used; a texture that computes them is evaluated.
    """
    values = held_in(scene)
    for name, view in scene.named_sensors.items():
        values |= held_in(view, name)
    return values


def held_in(root: nn.Module, prefix: str = "") -> dict[str, Held]:
    """The parameters of one sensor, or of a scene without its sensors, by name: one part of `held_values`."""
    named = modules_of(root, prefix)
    plugins = [(name, module) for name, module in named if isinstance(module, Plugin)]
    names = {id(plugin): name for name, plugin in plugins}
    note_uses(plugins)
    values: dict[str, Held] = {}
    found = [(f"{prefix}.{attribute}", plugin, attribute, domain, getattr(plugin, attribute, None))
             for prefix, plugin in plugins for attribute, domain in plugin.domains().items()]
    for name, plugin, attribute, domain, value in found:
        if isinstance(value, Tensor):
            values[name] = Held(plugin, attribute, [domain], reach_of_attribute(plugin, value))
    ids = {id(value) for *_, value in found if isinstance(value, Tensor)}
    for _, _, _, domain, value in found:
        if isinstance(value, VolumeFunction):
            hold_entries(values, names, value, domain)
        elif isinstance(value, Texture):
            hold_values(values, names, value, domain)
    for prefix, module in named:
        for attribute, value in module._parameters.items():
            if value is not None and id(value) not in ids and value.numel():
                ids.add(id(value))
                name = f"{prefix}.{attribute}".removeprefix(".")
                values[name] = Held(module, attribute, [Domain()], frozenset({id(value)}))
    return values


def reach_of_attribute(plugin: Plugin, value: Tensor) -> frozenset[int]:
    """The ids of all that a plugin's attribute depends on: its tensor alone, unless a parametrisation computes it."""
    held = any(value is tensor for _, tensor in tensors_of(plugin))
    return frozenset({id(value)}) if held else reach_of([plugin])


def hold_entries(values: dict[str, Held], names: dict[int, str], volume: VolumeFunction, domain: Domain) -> None:
    """Adds a domain for the entries of a volume to `values`; arguments as of `hold_values`."""
    for name in volume.entries():
        entry = getattr(volume, name)
        if isinstance(entry, Texture):
            hold_values(values, names, entry, domain)
        else:
            values[f"{names[id(volume)]}.{name}"].domains.append(domain)


def hold_values(values: dict[str, Held], names: dict[int, str], texture: Texture, domain: Domain) -> None:
    """Adds a domain for the values of a texture to `values`, unless the texture checks them when it computes them.

    Args:
        values: filled in.
        names: of the plugins by their ids.
        texture: of an attribute with this domain.
        domain: the domain of the attribute.
    """
    for part in texture.parts():
        hold_values(values, names, part, domain)
    if texture.parts() or not texture.tabulated or reader_of(texture).attributes:
        return
    prefix = names[id(texture)]
    if texture.entries is None:
        values.setdefault(prefix, Held(texture, None, [], reach_of([texture]))).domains.append(domain)
        return
    parameter = f"{prefix}.{texture.entries}"
    if parameter not in values:
        raise AttributeError(f"parameter '{parameter}' is missing, got {getattr(texture, texture.entries, None)!r}; "
                             f"give it a tensor, or load the scene again")
    values[parameter].domains.append(domain)


def note_uses(plugins: list[tuple[str, Plugin]]) -> None:
    """Tells textures that compute their values the names and domains by which these are checked."""
    if all(plugin.tabulated for _, plugin in plugins if isinstance(plugin, Texture)):
        return
    names, uses = {id(plugin): name for name, plugin in plugins}, {}
    for _, plugin in plugins:
        for attribute, domain in plugin.domains().items():
            texture = getattr(plugin, attribute, None)
            if isinstance(texture, Texture) and not texture.tabulated:
                uses.setdefault(id(texture), (texture, []))[1].append(domain)
    for texture, domains in uses.values():
        use = Use(names[id(texture)], tuple(dict.fromkeys(domains)))
        if texture.use != use:  # the same object tells that nothing has changed
            texture.use = use


def check_parameters(scene: Scene, cache: PackCache, seen: Collection[str], leeway: float = LEEWAY) -> None:
    """Checks that a scene's parameters are valid. Values computed by modules are checked where they are computed.

    Args:
        scene: as it is now.
        cache: what is known from the last rendering.
        seen: the names of the sensors that are rendered; the others are not looked at.
        leeway: as of `Domain.check_range`.

    Raises:
        ValueError: naming the first that has a wrong shape, is not finite, is out of range, or is not a valid pose.
        TypeError: if dtypes or devices are mixed, or the dtype is not supported.
    """
    with torch.no_grad():
        views, changed = scene.named_sensors, {}
        for root, name in [*((views[name], name) for name in dict.fromkeys(seen)), (scene, "")]:
            held = cache.structure(held_in, root, name)
            unchanged = cache.is_as_it_was(root)
            changed |= {name: each for name, each in held.items() if not (unchanged and each.reach.isdisjoint(cache.moved))}
        values = {name: held.owner.texels() if held.attribute is None else cache.read(held.owner, held.attribute)
                  for name, held in changed.items()}
        check_types(scene, changed, values)
        for name, held in changed.items():
            for domain in held.domains:
                domain.check_shape(f"parameter {name!r}", values[name])
        checks = {}
        for name, held in changed.items():
            value = primal(values[name]) if differentiated(values[name]) else cache.frozen(name, values[name])
            checks[name] = name, value, tuple(dict.fromkeys(held.domains)), leeway
        # A device is asked once for what is to be checked of all.
        away = [name for name, check in checks.items() if not check[1].is_cpu and not cache.knows(check_values, *check)]
        fetched = {name: cache.numbers[id(values[name])] for name in away if id(values[name]) in cache.numbers}
        others = [name for name in away if name not in fetched]
        if presuming():
            check_later([checks.pop(name) for name in others if differentiated(values[name])])
            others = [name for name in others if name in checks]
        fetched |= zip(others, numbers_on_host([checks[name][1] for name in others]))
        for name, check in checks.items():
            cache(check_values, *check, instead=partial(check_values, *check, fetched.get(name)))


def check_later(checks: Sequence[tuple[str, Tensor, tuple[Domain, ...], float]]) -> None:
    """Checks values, given as arguments of `check_values`, once their device has been waited for anyway."""
    if not checks:
        return
    parts = [fetched_of(check[1]).double() for check in checks]

    def told(numbers: list[float]) -> None:
        for check, part in zip(checks, parts):
            check_values(*check, numbers[:part.numel()])
            numbers = numbers[part.numel():]

    asked_later(torch.cat(parts), told)


def check_values(name: str, value: Tensor, domains: tuple[Domain, ...], leeway: float,
                 numbers: list[float] | None = None) -> None:
    """Raises ValueError unless the values of a parameter, detached, are in all of its domains.

    Warns of reflectances above 1.

    Args:
        name, domains: of the parameter.
        value, leeway: its value, and as for `Domain.check_range`.
        numbers: of `value`, from `numbers_on_host`; None: they are fetched.
    """
    if numbers is None:
        least, greatest = torch.stack(value.aminmax()).double().tolist()
    else:
        least, greatest = (math.nan, math.nan) if any(map(math.isnan, numbers)) else (min(numbers), max(numbers))
    finite = abs(least) < torch.inf and abs(greatest) < torch.inf
    highest = min([domain.high for domain in domains], default=torch.inf)  # what all allow, of which the leeway is a share
    for domain in domains:
        open_above = domain.low > -torch.inf and domain.high > highest
        within = domain._replace(high=highest, high_is_in=True) if open_above else domain
        within.check_range(f"parameter {name!r}", value, least, greatest, leeway, OUTSIDE if finite else NOT_FINITE)
        domain.warn(f"parameter {name!r}", greatest)
        if domain.is_pose:
            rows = value.tolist() if numbers is None else [numbers[first:first + 4] for first in range(0, 16, 4)]
            domain.check_pose(f"parameter {name!r}: {name.rpartition('.')[2]}", rows)


def check_names(renderer: nn.Module, cache: PackCache) -> None:
    """Raises AttributeError naming a tensor that was passed under a name that nothing reads.

    `torch.func.functional_call` takes any name: a misspelt one would change nothing.

    Args:
        renderer: has a scene.
        cache: what is known from the last rendering.
    """
    scene = renderer.scene
    modules = modules_in(renderer, without={scene})
    strays = [name for prefix, module in modules for name in strays_of(prefix, module, renderer)]
    strays += cache.structure(strays_in, scene)
    strays += [name for prefix, view in scene.named_sensors.items() for name in strays_in(view, prefix)]
    if strays:
        raise AttributeError(f"there is no parameter {strays[0]!r}; "
                             f"{nearest(strays[0], dict(renderer.named_parameters()))}")


def strays_in(root: nn.Module, prefix: str = "") -> list[str]:
    """The names of tensors that nothing reads, in one sensor or in a scene without its sensors."""
    without = set(root.named_sensors.values()) if isinstance(root, Scene) else ()
    named = modules_in(root, f"scene.{prefix}".removesuffix("."), without)
    return [name for prefix, module in named for name in strays_of(prefix, module)]


def strays_of(prefix: str, module: nn.Module, renderer: nn.Module | None = None) -> list[str]:
    """The names of tensors that nothing reads in one module, if that is a plugin, a scene or the renderer; else none."""
    attributes = vars(module)
    if not any(map(is_tensor, set(map(type, attributes.values())))):
        return []
    if type(module) not in {Scene, *registered()} and module is not renderer:
        return []
    return [f"{prefix}.{name}".removeprefix(".") for name, value in attributes.items() if isinstance(value, Tensor)]


@cache
def is_tensor(kind: type) -> bool:
    """True if instances of a class are tensors."""
    return issubclass(kind, Tensor)


def registered() -> set[type[Plugin]]:
    """The classes of all registered plugins."""
    return {plugin for plugins in REGISTRY.values() for plugin in plugins.values()}


def check_types(scene: Scene, held: dict[str, Held], values: dict[str, Tensor]) -> None:
    """Raises TypeError unless all parameters are float32, or all float64, on one device."""
    first, reference = next(iter(scene.named_parameters()))
    for name, value in values.items():
        if any(domain.is_index for domain in held[name].domains):
            continue
        if value.dtype not in DTYPES:
            raise TypeError(f"parameter {name!r} is {value.dtype}; a scene is rendered in torch.float32 or torch.float64: "
                            f"convert it with scene.float() or scene.double()")
        if value.layout != torch.strided:
            raise TypeError(f"parameter {name!r} must be a dense tensor, got {value.layout}: convert it with .to_dense()")
        if (value.dtype, value.device) != (reference.dtype, reference.device):
            raise TypeError(f"parameter {name!r} is {value.dtype} on {value.device}, but {first!r} is {reference.dtype} on "
                            f"{reference.device}; a scene has one dtype and one device: convert it with .to()")
    if reference.is_meta:
        raise TypeError(f"parameter {first!r} is on the device meta, which holds no numbers: load the scene again")


def check_extent(scene: Scene, shapes: list[Surface], largest: list[float]) -> None:
    """Raises ValueError naming the first shape that is too large for float32.

    Args:
        scene: gives the names.
        shapes: of the scene.
        largest: of each shape the largest coordinate.
    """
    for shape, coordinate in zip(shapes, largest):
        if not coordinate <= LARGEST_COORDINATE:
            raise ValueError(f"the shape {scene.name_of(shape)!r} has vertices up to {coordinate:.3g} from the origin along "
                             f"an axis, and would vanish: areas overflow in float32 beyond {LARGEST_COORDINATE:g}; scale "
                             f"the whole scene down")


def check_places(scene: Scene, groups: list[list[Instance]], boxes: Tensor) -> None:
    """Raises ValueError naming the first instance that shows its group too far away for float32.

    Args:
        scene: gives the names.
        groups: the instances of each group.
        boxes: (I, 8, 3) around all of them, in this order.
    """
    largest = boxes.abs().amax((1, 2))
    too_far = ~(largest <= LARGEST_COORDINATE)

    def told(numbers: list[float]) -> None:
        if not numbers[0]:
            return
        first = int(too_far.nonzero()[0])
        instance = [instance for instances in groups for instance in instances][first]
        raise ValueError(f"the instance {scene.name_of(instance)!r} shows its group up to {float(largest[first]):.3g} "
                         f"from the origin along an axis, where it would vanish: areas overflow in float32 beyond "
                         f"{LARGEST_COORDINATE:g}; scale the whole scene down")

    asked_later(too_far.any().reshape(1), told)


def largest_vertex_coordinate(vertices: Tensor, numbers: Sequence[float] | None = None) -> float:
    """The largest magnitude of a coordinate of vertices, (V, 3), detached; NaN if any is. `numbers`: their extremes, if
    known."""
    numbers = torch.stack(vertices.aminmax()).tolist() if numbers is None else numbers
    return math.nan if any(map(math.isnan, numbers)) else max(map(abs, numbers))
