"""The part of a scene's tables that lanes of one appearance read.

Functions of a bounce get no more than this, so that one that is compiled serves all scenes with that appearance, whatever
else they contain.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

from torch_radbp.interface.texture import Reader
from torch_radbp.scene.tables.appearance import Appearance
from torch_radbp.scene.tables.light_choice import TreeChoice
from torch_radbp.scene.tables.placement import for_lanes
from torch_radbp.scene.tables.scene_tensors import Layout, SceneTensors
from torch_radbp.tensors.record import leaves_of


def part_of(scene: SceneTensors, scatterer: Appearance | None, vertex: Hashable = None) -> SceneTensors:
    """The part of a scene that is read where `scatterer` scatters light; None: where nothing does.

    Args:
        scene: the whole of it.
        scatterer: the appearance of the surface.
        vertex: the kind of path vertex that lanes have there, noted in the part's layout.
    """
    layout = replace(layout_of_part(scene.layout, scatterer), vertex=vertex)
    return _reduced(scene, scene.layout, scatterer)._replace(layout=layout)


def leaves_of_part(belonging: SceneTensors, layout: Layout, scatterer: Appearance | None) -> list:
    """For each tensor in a part of the scene its entry, such as a gradient, in a record of the whole scene.

    Args:
        belonging: a record of the scene's structure with these entries in place of its tensors.
        layout: of the scene.
        scatterer: the appearance of the part.
    """
    return leaves_of(_reduced(belonging, layout, scatterer))


def _reduced(scene: SceneTensors, layout: Layout, scatterer: Appearance | None) -> SceneTensors:
    """A scene without the tables that lanes on surfaces of an appearance do not read."""
    triangles = scene.triangles._replace(balls=None, numbers=None, instances=for_lanes(scene.triangles.instances))
    looks = looks_of_part(layout, scatterer)
    slots = scene.materials.slots[:max((len(look.readers) for look in looks), default=0)]
    if not (layout.radiance_bitmaps or any(look.needs_uv for look in looks)):
        triangles = triangles._replace(vertices=triangles.vertices._replace(uv=None))
    wanted = attributes_of_part(layout, scatterer)
    triangles = triangles._replace(
        vertices=triangles.vertices._replace(
            attributes=_chosen(layout.vertex_attributes, triangles.vertices.attributes, wanted)),
        attributes=_chosen(layout.face_attributes, triangles.attributes, wanted))
    if not any(look.kind.oriented for look in looks):
        triangles = triangles._replace(along=None)
    lights = scene.lights
    if isinstance(lights.choice, TreeChoice):  # the choice is made before the functions of the bounce run
        lights = lights._replace(choice=TreeChoice(lights.choice.pmf, *(None for _ in TreeChoice._fields[1:])))
    return scene._replace(
        lit=(), lights=lights, triangles=triangles,
        materials=scene.materials._replace(slots=slots),
        textures=tuple(() if reader.outside else scene.textures[layout.readers.index(reader)]
                       for reader in readers_of(looks)))


def layout_of_part(layout: Layout, scatterer: Appearance | None) -> Layout:
    """The static layout of the part of a scene that one appearance reads: the features that it needs."""
    return replace(layout, bending=False, bends_ideally=False, appearances=(), scatterer=scatterer,
                   readers=readers_of(looks_of_part(layout, scatterer)), attributes=attributes_of_part(layout, scatterer),
                   still=())


def looks_of_part(layout: Layout, scatterer: Appearance | None) -> tuple[Appearance, ...]:
    """The appearances whose materials a part of the scene reads: that of its vertices, and those of panes that rays pass."""
    return *(() if scatterer is None else (scatterer,)), *(look for *_, look in layout.panes)


def readers_of(looks: tuple[Appearance, ...]) -> tuple[Reader, ...]:
    """The texture readers of some appearances, each once."""
    return tuple(dict.fromkeys(reader for look in looks for reader in look.readers))


def attributes_of_part(layout: Layout, scatterer: Appearance | None) -> tuple[str, ...]:
    """The names of mesh attributes that a part of the scene reads, in the scene's order."""
    readers = (layout.radiance, *readers_of(looks_of_part(layout, scatterer)))
    return tuple(name for name in layout.attributes if any(name in reader.attributes for reader in readers))


def _chosen(names: tuple[str, ...], columns: tuple, wanted: tuple[str, ...]) -> tuple:
    """Selects the columns whose names are wanted, in their order."""
    return tuple(column for name, column in zip(names, columns) if name in wanted)
