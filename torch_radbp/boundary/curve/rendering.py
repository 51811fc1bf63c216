"""The rendering that is about to start, and what moves in it, for boundary terms and warnings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.silhouette import CameraSight
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.view import View
from torch_radbp.interface.bsdf import Kind
from torch_radbp.interface.emitter import Light
from torch_radbp.interface.instances import expanded
from torch_radbp.plugin import BSDF, Plugin, Sensor, Texture
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.packing.geometry import PlacedShape
from torch_radbp.scene.packing.pack import MATERIALS, PLACED
from torch_radbp.sensor.kind import Lens
from torch_radbp.shape.surface import Surface
from torch_radbp.tensors.differentiated import asks_for_derivatives, detached
from torch_radbp.vertex.material import turning_values

MOVE_SHAPES = ("to_world", "vertex_positions", "grid")
MOVE_LIGHTS = ("to_world", "position")
MOST_OF_GROUP = 1 << 16  # triangles of instances of a group that are looked at
MOST_NAMES = 8  # in a message


@dataclass(frozen=True)
class Rendering:
    """The scene and settings of a rendering that is about to start, by which its boundary terms are chosen."""

    scene: Scene  # with the parameters of this rendering
    call: RenderCall
    looks: Sequence[tuple[View, Lens]]  # for each viewpoint of each sensor
    sampling: str  # "detached", "hybrid" or "attached"
    cache: PackCache  # of this rendering
    primary: bool  # boundary terms of edges in view are computed
    shadows: bool  # boundary terms of shadows are computed
    max_depth: int  # of paths, as the renderer has it
    light_paths: str = "camera"  # which light comes by paths that begin at lamps, as the renderer has it

    @property
    def has_area(self) -> bool:
        """True if pixels have an area that edges can sweep; False if the camera casts single rays."""
        return all(view.camera.kind.has_area for view, _ in self.looks)

    @cached_property
    def sensors(self) -> list[Sensor]:
        """The sensors of the rendering, repeated for each viewpoint that they have."""
        return [view.sensor for view, _ in self.looks]

    @cached_property
    def sights(self) -> list[CameraSight]:
        """The camera and film of each of `sensors`."""
        return [whole_sight(view, lens) for view, lens in self.looks]

    @cached_property
    def camera_movers(self) -> list[list[str]]:
        """For each of `sensors`, the names of its differentiated parameters."""
        return [self.moving(sensor) for sensor in self.sensors]

    def materials(self) -> list[tuple[BSDF, Kind]]:
        """The materials of the scene, one for each side, with their kinds."""
        return list(self.cache.made(MATERIALS).described)

    def moving(self, plugin: Plugin, attributes: Sequence[str] | None = None) -> list[str]:
        """The full names of a plugin's differentiated attributes, among all or given ones."""
        def find() -> list[str]:
            asked = [name for name in (plugin.domains() if attributes is None else attributes)
                     if self.cache.is_live(plugin, name)]
            return [f"{self.names.get(id(plugin), type(plugin).__name__)}.{name}" for name in asked]

        return find() if isinstance(plugin, Sensor) else self.known((plugin, attributes), find)

    def known(self, key: Hashable, find: Callable[[], Any]) -> Any:
        """The result of `find`, cached while the scene (without sensors) has the same attribute objects."""
        facts, key = self.cache.facts(self.scene), (Rendering, key, torch.is_grad_enabled())
        if key not in facts:
            facts[key] = find()
        return facts[key]

    def turning(self, bsdf: BSDF, kind: Kind) -> list[str]:
        """The names of the differentiated textures of a material by which sampled directions turn."""
        slots, textures = turning_values(kind, self.sampling), bsdf.textures()
        return [texture_name(self.scene, textures[slot]) for slot in slots
                if any(map(asks_for_derivatives, textures[slot].sources()))]

    @cached_property
    def names(self) -> dict[int, str]:
        """The scene's names of all its modules, by the modules' ids."""
        return self.known("names", lambda: {id(module): name for name, module in self.scene.named_modules()})

    @cached_property
    def emitters(self) -> list[Light]:
        """All emitters of the scene."""
        return self.known("emitters", lambda: self.scene.emitters)

    @cached_property
    def shapes(self) -> list[Surface]:
        """All shapes of the scene, those of groups included."""
        return self.known("shapes", lambda: self.scene.shapes)

    @cached_property
    def sizes(self) -> list[int]:
        """The number of triangles of each shape, in the order of the caster's triangles."""
        return [len(shape.faces) for shape in self.cache.made(PLACED)]

    def placed(self, number: int) -> PlacedShape:
        """The triangles of a shape, by its number; in the frame of its group if it is in one."""
        return self.cache.made(PLACED)[number]

    @cached_property
    def shape_of(self) -> Tensor:
        """The shape of each triangle of the ray caster, (T,) int64; shapes of groups occur once."""
        return torch.repeat_interleave(torch.tensor(self.sizes, device=self.call.caster.faces.device))

    @cached_property
    def seen(self) -> ShownTriangles:
        """The triangles in the world; for groups with many instances those of some instances."""
        sizes, caster, instances = self.sizes, self.call.caster, self.call.scene.triangles.casting_instances
        if instances is None:
            return ShownTriangles(caster.vertices, caster.faces, sizes)
        shown = expanded(caster.vertices, caster.faces, instances, MOST_OF_GROUP)
        shape = torch.repeat_interleave(torch.tensor(sizes, device=shown.faces.device))[shown.triangle.long()]
        order = shape.argsort(stable=True)
        return ShownTriangles(shown.vertices, shown.faces[order], shape.bincount(minlength=len(sizes)).tolist())

    @cached_property
    def moving_instances(self) -> tuple[bool, ...]:
        """For each instance, in the order of hits, whether its own pose is differentiated."""
        return tuple(bool(self.moving(instance, MOVE_SHAPES)) for instances in self.scene.groups.values()
                     for instance in instances)

    @cached_property
    def movers(self) -> list[list[str]]:
        """For each shape, the differentiated parameters that move it, those of its instances included; cached."""
        return self.known("movers", self.found_movers)

    def found_movers(self) -> list[list[str]]:
        """For each shape, the differentiated parameters that move it, found anew; `movers` caches them."""
        of_groups = {group: [name for instance in instances for name in self.moving(instance, MOVE_SHAPES)]
                     for group, instances in self.scene.groups.items()}
        return [[*self.moving(shape, MOVE_SHAPES), *(of_groups[id(instances[0].shapegroup)] if instances else ())]
                for shape, instances in zip(self.shapes, self.scene.shown_by)]

    @cached_property
    def light_movers(self) -> list[list[str]]:
        """For each element of the light table, the differentiated parameters that move it; empty for the environment."""
        on_surfaces = [self.moving(shape, MOVE_SHAPES) for shape, size in zip(self.shapes, self.sizes)
                       if shape.emitter is not None for _ in range(size)]
        return on_surfaces + [[] if emitter.kind().surround else self.moving(emitter, MOVE_LIGHTS)
                              for emitter in self.emitters if not emitter.kind().on_surface]

    def movers_at(self, *triangles: Tensor) -> set[str]:
        """The differentiated parameters that move any of given triangles, (N,) each; -1: no triangle."""
        number = torch.cat([own[own >= 0] for own in triangles]).unique().long()
        return {name for shape in self.shape_of[number].unique().tolist() for name in self.movers[shape]}

    @cached_property
    def self_crossing(self) -> list[bool]:
        """For each shape, whether it may belong to a body that intersects itself: a mesh, or an instanced group."""
        members = Counter(id(instances[0].shapegroup) for instances in self.scene.shown_by if instances)
        return [shape.may_cross_itself or bool(instances) and members[id(instances[0].shapegroup)] > 1
                for shape, instances in zip(self.shapes, self.scene.shown_by)]

    @cached_property
    def plain(self) -> tuple[bool, ...]:
        """For each shape, whether light jumps on it at borders of shadows alone, so that points near a vertex may slide."""
        plain, sizes = self.call.scene.triangles.plain, self.sizes
        if plain is None:
            return (False,) * len(sizes)

        def find() -> tuple[bool, ...]:
            first = torch.tensor([0, *accumulate(sizes)][:-1], device=plain.device).clamp_max(len(plain) - 1)
            return tuple(plain[first].tolist())

        return self.known("plain", find)

    @cached_property
    def sliders(self) -> list[list[str]]:
        """For each shape, the differentiated parameters that move only its texture coordinates."""
        return [self.moving(shape, ("vertex_texcoords",)) for shape in self.shapes]

    @cached_property
    def turners(self) -> list[list[str]]:
        """For each shape, the differentiated parameters that turn only its shading normals."""
        return [self.moving(shape, ("vertex_normals",)) for shape in self.shapes]


def rendering_of(call: RenderCall, scene: Scene, sampling: str, cache: PackCache, primary: bool, shadows: bool,
                 max_depth: int, light_paths: str) -> Rendering:
    """A call and its settings, as boundary terms and warnings read them. Args as of `Rendering`; `primary`, the terms of
    edges in view, is off if pixels have no area.

    Everything in view of the whole film counts, not only of its window, so that a warning holds for all windows.
    """
    looks = [(view, lens) for view in call.views for lens in view.camera.kind.lookouts(detached(view.camera.lens))]
    primary = primary and all(view.camera.kind.has_area for view in call.views)
    # Behind boundaries of media edges are not seen by light from lamps.
    if call.scene.layout.traces_segments and light_paths == "all":
        primary = shadows = False
    return Rendering(scene, call, looks, sampling, cache, primary, shadows, max_depth, light_paths)


def whole_sight(view: View, lens: Lens) -> CameraSight:
    """The camera of a view through a given lens, with its whole film."""
    film, whole = view.camera.film, view.sensor.film.window()
    crop_x, crop_y = (film.size_x.new_tensor(float(span.first)) for span in (whole.columns, whole.rows))
    camera = view.camera._replace(lens=lens, film=film._replace(crop_x=crop_x, crop_y=crop_y))
    return CameraSight(camera, whole.columns.size, whole.rows.size)


class ShownTriangles(NamedTuple):
    """Triangles in the world, in the order of their shapes."""

    vertices: Tensor  # (V, 3)
    faces: Tensor  # (T, 3) int32
    counts: list[int]  # of each shape


def listed(names: Iterable[str]) -> str:
    """Joins names to running text, as "`a` and `b`"; of many only the first."""
    quoted = [f"`{name}`" for name in dict.fromkeys(names)]
    more = len(quoted) - MOST_NAMES
    return " and ".join(quoted if more <= 0 else [*quoted[:MOST_NAMES], f"{more} other{'s' * (more > 1)}"])


def texture_name(scene: Scene, texture: Texture) -> str:
    """The scene's name of a texture, or of the parameter in whose place it stands."""
    owner, attribute = getattr(texture, "place", (texture, ""))
    return f"{scene.name_of(owner)}.{attribute}".rstrip(".")

