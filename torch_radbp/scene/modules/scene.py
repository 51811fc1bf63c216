"""`Scene`: the modules that a user sees, names and differentiates."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn

from torch_radbp.formats.html_table import html_table
from torch_radbp.integrator.path import Path
from torch_radbp.plugin import BSDF, REGISTRY, Emitter, Integrator, Medium, Plugin, SceneError, Sensor, nearest, with_article
from torch_radbp.scene.cache.module_attributes import ModuleTree, modules_in
from torch_radbp.shape.instance import Instance
from torch_radbp.shape.surface import Surface

if TYPE_CHECKING:
    import trimesh


class Scene(ModuleTree):
    """Shapes, materials, emitters and sensors, each a submodule under its name in the scene description.

    Parameter names follow Mitsuba's `mi.traverse`: a material of its own is named by its id (`white.reflectance.value`),
    one that is written inside its shape by the shape (`wall.bsdf.reflectance.data`).
    All parameters have `requires_grad=False` until the user picks, but for an `nn.Parameter` that `load_dict` was given.

    Args:
        children: plugins by name: shapes, bsdfs, textures, emitters, sensors. Materials and textures that several shapes
            share are registered once.
        integrator: defaults for the renderer.

    Raises:
        SceneError: if a name cannot be used, or the scene has no emitter or no sensor.
    """

    def __init__(self, children: dict[str, Plugin], integrator: Integrator | None = None):
        super().__init__()
        self.integrator_defaults = [Path() if integrator is None else integrator]
        for name, child in children.items():
            self._add(name, child)
        named = {id(child) for child in self._modules.values()}
        for child in list(self._modules.values()):
            self._name_once(child, named)
        if not self.sensors:
            raise SceneError("the scene has no sensor: add <sensor type=\"perspective\">")
        if not self.emitters and all(medium.kind().emission is None for medium in self.media):
            raise SceneError("the scene has no emitter, so that every image is black: add an emitter of type "
                             f"{', '.join(sorted(REGISTRY['emitter']))}")
        self._check_places()
        media = self.media
        for name, child in self._modules.items():
            if isinstance(child, Medium) and child not in media:
                raise SceneError(f"`{name}` is a medium in which no sensor stands, and that no shape has: write it as the "
                                 "medium of the sensors, or as the interior or exterior of a shape")
        surrounds = [emitter.type for emitter in self.emitters if emitter.kind().surround]
        if len(surrounds) > 1:
            raise SceneError(f"the scene has more than one emitter that surrounds it ({', '.join(surrounds)}): add up "
                             "their radiances in one")
        self.integrator.check([] if media else self.bsdfs())  # with media, passing straight is no bounce
        for plugin in self.modules():
            if isinstance(plugin, Plugin):
                plugin.in_scene = True

    converter: ClassVar[Callable[[Scene], trimesh.Scene]]  # set by `torch_radbp.io.trimesh_out`
    clamping: ClassVar[Callable[[Scene, str | Iterable[str] | None], None]]  # set by `torch_radbp.scene.modules.bounds`

    if TYPE_CHECKING:  # objects of the scene are known by their names only when it is loaded
        def __getattr__(self, name: str) -> Any: ...

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, Plugin):
            self._replace(name, value)
        super().__setattr__(name, value)

    def _replace(self, name: str, plugin: Plugin) -> None:
        """Replaces the object called `name` wherever the scene refers to it.

        Raises:
            AttributeError: if there is no such object, and the plugin would have no effect by itself.
            TypeError: if it is of another category.
        """
        old = self._modules.get(name)
        if old is None and plugin.category in ("shape", "emitter", "sensor"):
            return
        if old is None:
            raise AttributeError(f"the scene has no object {name!r}, and {with_article(plugin.category)} that no shape has "
                                 f"would change nothing: assign it where it is to be used; {nearest(name, self._modules)}")
        if plugin.category != old.category:
            raise TypeError(f"{name} of the scene must be {with_article(old.category)}, got {with_article(plugin.category)}")
        for owner in self.modules():
            for attribute, shared in owner.shared.items() if isinstance(owner, Plugin) else ():
                if shared is old:
                    owner.shared[attribute] = plugin

    def _check_places(self) -> None:
        """Raises SceneError unless every emitter that needs a surface is on one."""
        carriers: dict[int, Surface] = {}
        for shape in self.shapes:
            if shape.emitter is None:
                continue
            first = carriers.setdefault(id(shape.emitter), shape)
            if first is not shape:
                raise SceneError(f"`{self.name_of(first)}` and `{self.name_of(shape)}` have one emitter, "
                                 f"`{self.name_of(shape.emitter)}`: give each shape its own")
        for name, child in self._modules.items():
            if isinstance(child, Emitter) and child.kind().on_surface and id(child) not in carriers:
                raise SceneError(f"`{name}` is an emitter of type {child.type}, which belongs inside a shape: write it as "
                                 f"the emitter of one")

    def _add(self, name: str, child: Plugin) -> None:
        name = name.replace(".", "_")
        if not name:
            raise SceneError("an object of the scene has an empty name")
        if name in self._modules:
            raise SceneError(f"two objects of the scene have the id {name!r}")
        if hasattr(self, name):
            name += "_"
        self._modules[name] = child

    def _name_once(self, parent: Plugin, named: set[int]) -> None:
        """Registers a child that several parents share only with the parent under which it was named first."""
        for name, child in list(parent._modules.items()):
            if not isinstance(child, Plugin):
                continue
            if id(child) in named:
                parent.share(name)
            else:
                named.add(id(child))
                self._name_once(child, named)

    @property
    def integrator(self) -> Integrator:
        """The integrator, whose settings are the renderer's defaults."""
        return self.integrator_defaults[0]

    @property
    def shapes(self) -> list[Surface]:
        """All surfaces: those of the scene, then those of the groups that instances show."""
        in_scene = [child for child in self._modules.values() if isinstance(child, Surface)]
        return in_scene + [shape for group in self.groups.values() for shape in group[0].shapegroup.shapes.values()]

    @property
    def groups(self) -> dict[int, list[Instance]]:
        """The instances of each group, by the group's id."""
        instances: dict[int, list[Instance]] = {}
        for child in self._modules.values():
            if isinstance(child, Instance):
                instances.setdefault(id(child.shapegroup), []).append(child)
        return instances

    @property
    def shown_by(self) -> list[list[Instance] | None]:
        """For each of `shapes`, the instances that show it; None for shapes of the scene itself."""
        shown = [group for group in self.groups.values() for _ in group[0].shapegroup.shapes]
        return [None] * (len(self.shapes) - len(shown)) + shown

    @property
    def sensors(self) -> list[Sensor]:
        """All sensors, in the order of `named_sensors`."""
        return list(self.named_sensors.values())

    @property
    def named_sensors(self) -> dict[str, Sensor]:
        """All sensors by name; each sensor of a batch has its own."""
        return {f"{name}{part}": view for name, child in self._modules.items() if isinstance(child, Sensor)
                for part, view in child.views().items()}

    def separate_roots(self) -> list[Sensor]:
        """The sensors, whose attributes are compared separately: a rendering looks only at those that it shows."""
        return self.sensors

    def shared_with_roots(self) -> list[Medium]:
        """The medium in which the sensors stand, which belongs to the scene as well."""
        return [] if self.around is None else [self.around]

    @property
    def emitters(self) -> list[Emitter]:
        """All emitters: those of the scene, then those of its shapes."""
        in_scene = [child for child in self._modules.values() if isinstance(child, Emitter) and not child.kind().on_surface]
        return in_scene + [shape.emitter for shape in self.shapes if shape.emitter is not None]

    @property
    def around(self) -> Medium | None:
        """The medium in which the sensors stand; None: empty space.

        Raises:
            SceneError: if they stand in different media.
        """
        media = {name: sensor.medium for name, sensor in self.named_sensors.items()}
        one, *others = media.values() or (None,)
        if any(other is not one for other in others):
            each = ", ".join(f"`{name}` in {medium.type if medium else 'none'}" for name, medium in media.items())
            raise SceneError(f"sensors stand in different media: {each}; give all the same object, by a reference to it")
        return one

    @property
    def media(self) -> list[Medium]:
        """All participating media: that of the sensors, then those that surfaces bound."""
        media = [self.around, *(medium for shape in self.shapes for medium in (shape.interior, shape.exterior))]
        return list(dict.fromkeys(medium for medium in media if medium is not None))

    @property
    def dtype(self) -> torch.dtype:
        """The dtype of all parameters: float32 or float64."""
        return self.first_parameter.dtype

    @property
    def device(self) -> torch.device:
        """The device of all parameters, on which images are made."""
        return self.first_parameter.device

    @property
    def first_parameter(self) -> Tensor:
        """The first parameter, faster than by `next(self.parameters())`."""
        return next(value for module in self.modules() for value in module._parameters.values() if value is not None)

    def half(self) -> Scene:
        """Raises TypeError: a scene is rendered in float32 or float64."""
        raise half_precision(torch.float16)

    def bfloat16(self) -> Scene:
        """Raises TypeError: a scene is rendered in float32 or float64."""
        raise half_precision(torch.bfloat16)

    def get_parameter(self, target: str) -> Tensor:
        """The parameter called `target`.

        Raises:
            AttributeError: if there is none; the message lists the nearest names.
            TypeError: if `target` is no name.
        """
        if not isinstance(target, str):
            raise TypeError(f"the name of a parameter must be a string, got {target!r}")
        try:
            return super().get_parameter(target)
        except AttributeError as error:
            names = dict(self.named_parameters())
            raise AttributeError(f"the scene has no parameter {target!r}; {nearest(target, names)}") from error

    def clamp_(self, names: str | Iterable[str] | None = None) -> Scene:
        """Brings parameters into their ranges, in place; for loops, after each step of an optimizer.

        Renderings raise ValueError for a value that is out of its range, such as a reflectance that an optimizer has moved
        below 0. Reflectances end at 1 here, though a rendering takes larger ones; where all parameters are clamped, those
        that require no gradient may stay larger. Ends that are not in a range, such as 0 and 180 degrees of a field of view,
        are kept away from by a thousandth. What is parametrised is assigned to, so that its parametrisation takes the value
        over. NaN and infinite values stay, for the next rendering to tell; poses have no range.
        `rb.optim.bounded(optimizer, scene)` does this after each step, of what the optimizer holds.

        Args:
            names: of some parameters, as `get_parameter` has them, or of one; None: all.

        Returns:
            The scene.

        Raises:
            AttributeError: if there is no such parameter; the message lists the nearest names.
            RuntimeError: if a value out of its range is that of a parametrisation without `right_inverse`.
        """
        self.clamping(self, names)
        return self

    def name_of(self, plugin: nn.Module) -> str:
        """The full name of a submodule, or its type if it is not part of the scene."""
        return name_in(self, plugin)

    def to_trimesh(self) -> trimesh.Scene:
        """The scene as a `trimesh.Scene` with current values: a mesh for each shape, under the name of the shape.

        Meshes are as of `Surface.to_trimesh`, in world space; instances are nodes that show the meshes of their group. The
        first perspective sensor is its camera. Emitters that are no surfaces, other sensors and what materials of trimesh
        have no place for are named in one `SceneWarning`.
        """
        return self.converter(self)

    def _repr_html_(self) -> str:
        names = {id(module): name for name, module in self.named_modules()}

        def named(plugin: Plugin) -> str:
            return names.get(id(plugin), plugin.type)

        shapes = [(named(shape), shape.type, f"{named(shape.bsdf)} ({shape.bsdf.type})") for shape in self.shapes]
        films = [(name, sensor.type, f"{sensor.film.crop_width} x {sensor.film.crop_height}")
                 for name, sensor in self.named_sensors.items()]
        parameters = [(name, " x ".join(map(str, value.shape)) or "number", f"{float(value.detach().mean()):.4g}",
                       "yes" if value.requires_grad else "") for name, value in self.named_parameters()]
        kind = f"{self.dtype} on {self.device}".removeprefix("torch.")
        return (html_table(f"Shapes: {len(shapes)}", ("name", "type", "material"), shapes)
                + html_table("Media", ("name", "type"), [(named(medium), medium.type) for medium in self.media])
                + html_table("Emitters", ("name", "type"), [(named(emitter), emitter.type) for emitter in self.emitters])
                + html_table("Sensors", ("name", "type", "pixels"), films)
                + html_table(f"Parameters: {kind}", ("name", "shape", "mean", "requires_grad"), parameters))

    def bsdfs(self) -> Iterator[BSDF]:
        """The materials of the shapes, each once, in order of first use."""
        seen: dict[int, BSDF] = {}
        for shape in self.shapes:
            seen.setdefault(id(shape.bsdf), shape.bsdf)
        return iter(seen.values())


def name_in(root: nn.Module, plugin: nn.Module) -> str:
    """The full name of a module inside another, or its type if it is not part of that."""
    # The objects of the scene first: it may have thousands, and their names be asked for one by one.
    named = itertools.chain(root._modules.items(), root.named_modules())
    return next((name for name, module in named if module is plugin), type(plugin).__name__)


def half_precision(dtype: torch.dtype) -> TypeError:
    """The error about a half-precision dtype."""
    return TypeError(f"a scene is rendered in torch.float32 or torch.float64, not in {dtype}, which rounds "
                     f"positions to 3 digits; convert the image instead")


def modules_of(root: nn.Module, prefix: str = "") -> list[tuple[str, nn.Module]]:
    """The modules of one sensor, or of a scene without its sensors but with their medium, as `modules_in` lists them."""
    if not isinstance(root, Scene):
        return modules_in(root, prefix)
    named = modules_in(root, prefix, set(root.named_sensors.values()))
    met = {module for _, module in named}
    return named + [each for medium in root.shared_with_roots() if medium not in met
                    for each in modules_in(medium, root.name_of(medium))]
